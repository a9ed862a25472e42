//! The commands, one file each.

mod demo;
mod diagnose;
mod identify;
mod simulate;

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use clap::{Parser, Subcommand};
use recordings::{Campaign, Recording};
use std::path::Path;

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
    Demo(demo::Args),
    Identify(identify::Args),
    Diagnose(diagnose::Args),
    Simulate(simulate::Args),
}

/// Runs what the command line asks for.
pub fn run(cli: &Cli, progress: &Progress) -> Result<(), Failure> {
    match &cli.command {
        Command::Demo(args) => demo::run(args, progress),
        Command::Identify(args) => identify::run(args, progress),
        Command::Diagnose(args) => diagnose::run(args, progress),
        Command::Simulate(args) => simulate::run(args, progress),
    }
}

/// Opens a campaign and reads all its runs, in its order: bad input is found before anything is computed.
fn open_campaign(dir: &Path, progress: &Progress) -> Result<(Campaign, Vec<Recording>), Failure> {
    let input = |error: recordings::CampaignError| Failure::of(Kind::Input, &error);
    let campaign = Campaign::open(dir).map_err(input)?;
    let step = progress.step("reading", campaign.runs.len() as u64);
    let mut runs = Vec::with_capacity(campaign.runs.len());
    for entry in &campaign.runs {
        runs.push(campaign.read(entry).map_err(input)?);
        step.at(runs.len() as u64);
    }
    let rows: usize = runs.iter().map(Recording::len).sum();
    step.done(&format!("{} runs, {rows} rows", runs.len()));
    Ok((campaign, runs))
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
