//! The commands, one file each.

mod blind;
mod campaign;
mod check;
mod compare;
mod confirm;
mod demo;
mod diagnose;
mod diagnose_plant;
mod doctor;
mod emulate;
mod export;
mod foxglove;
mod identify;
mod import;
mod info;
mod latency;
mod ls;
mod monitor;
mod profile;
mod record;
mod recover;
mod replay;
pub mod results;
pub(crate) mod run;
mod serve;
mod service;
mod simulate;
mod stop;
mod time;

use crate::failure::Failure;
use crate::progress::Progress;
use clap::{Parser, Subcommand};

/// Test bench for a hydraulic actuator with rotary elastic chambers: runs experiments, identifies the model, names what it
/// lacks.
#[derive(Debug, Parser)]
#[command(name = "bench", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Args),
    Campaign(campaign::Args),
    Check(check::Args),
    Profile(profile::Args),
    Serve(serve::Args),
    Service(service::Args),
    Stop(stop::Args),
    Confirm(confirm::Args),
    Record(record::Args),
    Recover(recover::Args),
    Replay(replay::Args),
    Demo(demo::Args),
    Identify(identify::Args),
    Diagnose(diagnose::Args),
    Blind(blind::Args),
    Simulate(simulate::Args),
    Compare(compare::Args),
    Latency(latency::Args),
    Doctor(doctor::Args),
    Emulate(emulate::Args),
    Monitor(monitor::Args),
    Foxglove(foxglove::Args),
    Ls(ls::Args),
    Info(info::Args),
    Export(export::Args),
    Import(import::Args),
}

/// Runs what the command line asks for.
pub fn run(cli: &Cli, progress: &Progress) -> Result<(), Failure> {
    match &cli.command {
        Command::Run(args) => run::run(args, progress),
        Command::Campaign(args) => campaign::run(args, progress),
        Command::Check(args) => check::run(args, progress),
        Command::Profile(args) => profile::run(args, progress),
        Command::Serve(args) => serve::run(args, progress),
        Command::Service(args) => service::run(args, progress),
        Command::Stop(args) => stop::run(args, progress),
        Command::Confirm(args) => confirm::run(args, progress),
        Command::Record(args) => record::run(args, progress),
        Command::Recover(args) => recover::run(args, progress),
        Command::Replay(args) => replay::run(args, progress),
        Command::Demo(args) => demo::run(args, progress),
        Command::Identify(args) => identify::run(args, progress),
        Command::Diagnose(args) => diagnose::run(args, progress),
        Command::Blind(args) => blind::run(args, progress),
        Command::Simulate(args) => simulate::run(args, progress),
        Command::Compare(args) => compare::run(args, progress),
        Command::Latency(args) => latency::run(args, progress),
        Command::Doctor(args) => doctor::run(args, progress),
        Command::Emulate(args) => emulate::run(args, progress),
        Command::Monitor(args) => monitor::run(args, progress),
        Command::Foxglove(args) => foxglove::run(args, progress),
        Command::Ls(args) => ls::run(args, progress),
        Command::Info(args) => info::run(args, progress),
        Command::Export(args) => export::run(args, progress),
        Command::Import(args) => import::run(args, progress),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
