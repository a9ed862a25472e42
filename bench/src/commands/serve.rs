//! `bench serve [RIG.toml] [--control]`

use crate::failure::Failure;
use crate::progress::Progress;
use crate::serve::{Settings, serve};
use std::ffi::OsString;
use std::net::SocketAddr;
use std::path::PathBuf;

/// The service: a queue of runs, live data for browsers, commands with a token
///
/// Read-only on the loopback unless told otherwise. Each run is a process of its own that ends orderly when the service does.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Rig file [default: the emulated rig]
    rig: Option<PathBuf>,
    /// Folder of profiles (*.toml) that can be queued beside the built-in ones
    #[arg(long, value_name = "DIR")]
    profiles: Option<PathBuf>,
    /// Folder of recordings
    #[arg(long, value_name = "DIR", default_value = super::run::RECORDINGS)]
    data: PathBuf,
    /// Address and port; port 0: any free one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Other machines may reach it; there is no encryption
    #[arg(long)]
    allow_remote: bool,
    /// A further name by which browsers may call the service
    #[arg(long, value_name = "NAME")]
    host: Vec<String>,
    /// Name under which runs are published
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
    /// Take commands, from who has the token
    #[arg(long)]
    control: bool,
    /// File with the token, which only its owner may read [default: a new one is drawn]
    #[arg(long, value_name = "FILE", requires = "control")]
    token_file: Option<PathBuf>,
    /// Runs end with exit code 2 when the system refuses anything that real time needs
    #[arg(long)]
    require_rt: bool,
    /// Priority of the runs' loop, SCHED_FIFO
    #[arg(long, default_value_t = 80, value_parser = clap::value_parser!(u8).range(2..=98))]
    priority: u8,
    /// Processors for the runs' loop and its publication, such as 3 or 2,3
    #[arg(long, value_delimiter = ',')]
    cpu: Vec<usize>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let mut run_options: Vec<OsString> = vec!["--priority".into(), args.priority.to_string().into()];
    if args.require_rt {
        run_options.push("--require-rt".into());
    }
    if !args.cpu.is_empty() {
        let list: Vec<String> = args.cpu.iter().map(ToString::to_string).collect();
        run_options.extend(["--cpu".into(), list.join(",").into()]);
    }
    let settings = Settings {
        rig: args.rig.clone(),
        profiles: args.profiles.clone(),
        data: args.data.clone(),
        listen: args.listen,
        allow_remote: args.allow_remote,
        hosts: args.host.clone(),
        instance: args.instance.clone(),
        control: args.control,
        token_file: args.token_file.clone(),
        run_options,
    };
    serve(settings, progress)
}
