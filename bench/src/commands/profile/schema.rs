//! `bench profile schema`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;

/// Print the JSON schema of profiles, for editors
#[derive(Debug, clap::Args)]
pub struct Args {}

pub(super) fn run(_args: &Args, _progress: &Progress) -> Result<(), Failure> {
    Err(Failure::new(Kind::Internal, "not there yet"))
}
