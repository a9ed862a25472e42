//! `bench profile check PROFILE... [--rig RIG] [--model MODEL] [--json]`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use std::path::PathBuf;

/// Check profiles: what they would do, how long it takes, and what a dry run on the model predicts
///
/// Nothing moves. Exit code 2: a profile is wrong or does not fit the rig; 3: the supervisor would trip.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Profiles: files, or names of built-in ones
    #[arg(required = true)]
    profiles: Vec<String>,
    /// Rig file [default: the emulated rig]
    #[arg(long)]
    rig: Option<PathBuf>,
    /// Model to predict with, `model.toml` [default: the rig file's]
    #[arg(long)]
    model: Option<PathBuf>,
    /// Seed of the profile's random steps
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, _progress: &Progress) -> Result<(), Failure> {
    let Args { profiles, rig, model, seed, json } = args;
    let _ = (profiles, rig, model, seed, json);
    Err(Failure::new(Kind::Internal, "not there yet"))
}
