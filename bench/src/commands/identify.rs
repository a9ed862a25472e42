//! `bench identify DIR [--out OUT]`

use super::results::analyse_folder;
use crate::failure::Failure;
use crate::progress::Progress;
use identify::analysis::Depth;
use std::path::PathBuf;

/// Identify the model from a campaign folder: model.toml and report.html
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign folder with campaign.toml
    dir: PathBuf,
    /// Where the results go [default: DIR/analysis]
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    analyse_folder(&args.dir, args.out.as_deref(), Depth::Identification, progress).map(drop)
}
