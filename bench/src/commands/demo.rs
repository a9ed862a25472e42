//! `bench demo [--seed N] [--out DIR]`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use std::path::PathBuf;

/// Run the paper's experiments on the emulated rig with an undeclared effect, identify the model, name the effect
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Draws the rig, its undeclared effect and its sensors' noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Campaign folder to make [default: a new one under recordings/data]
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &Args, _progress: &Progress) -> Result<(), Failure> {
    let _dir = args.out.clone().unwrap_or_else(|| free_folder(args.seed));
    Err(Failure::new(Kind::Internal, "the emulated rig is not connected yet"))
}

/// A folder that is not there yet: each demo leaves its own.
fn free_folder(seed: u64) -> PathBuf {
    let name = |n: u32| {
        let again = if n > 1 { format!("-{n}") } else { String::new() };
        PathBuf::from(format!("recordings/data/demo-seed{seed}{again}"))
    };
    (1..).map(name).find(|dir| !dir.exists()).expect("there are more names than folders")
}
