//! `bench identify DIR [--out OUT]`

use super::open_campaign;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
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
    let (_campaign, _runs) = open_campaign(&args.dir, progress)?;
    let _out = args.out.clone().unwrap_or_else(|| args.dir.join("analysis"));
    Err(Failure::new(Kind::Internal, "identification is not connected yet"))
}
