//! `bench export`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use std::path::PathBuf;

/// Not available yet
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recording or campaign folder
    path: Option<PathBuf>,
}

pub(super) fn run(args: &Args, _progress: &Progress) -> Result<(), Failure> {
    Err(Failure::new(Kind::Input, format!("{:?}: this command is not there yet", args.path)))
}
