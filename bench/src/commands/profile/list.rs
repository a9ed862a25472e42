//! `bench profile list [--json]`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;

/// List the built-in profiles: the experiments of a campaign, and examples to start from
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, _progress: &Progress) -> Result<(), Failure> {
    let _ = args.json;
    Err(Failure::new(Kind::Internal, "not there yet"))
}
