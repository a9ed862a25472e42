//! Compiles `proto/` to Rust types and to the descriptor set that every recording carries as its schema.

use std::error::Error;
use std::path::PathBuf;
use std::{env, fs};

use prost::Message;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=proto");
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR for build scripts")?);

    let descriptors = protox::compile(["proto/rec_bench.proto"], ["proto"])?;
    let mut schema = descriptors.clone();
    for file in &mut schema.file {
        // Comments and source positions are of no use to a reader and would change the bytes of every recording.
        file.source_code_info = None;
    }
    fs::write(out.join("rec_bench.fds"), schema.encode_to_vec())?;
    prost_build::Config::new().out_dir(&out).compile_fds(descriptors)?;
    Ok(())
}
