//! `bench profile schema`

use crate::failure::Failure;
use crate::progress::Progress;
use profiles::SCHEMA;

/// Print the JSON schema of profiles, for editors
///
/// Beside your profiles as profile.schema.json; the line `#:schema ./profile.schema.json` at the top of each names it.
#[derive(Debug, clap::Args)]
pub struct Args {}

pub(super) fn run(_args: &Args, progress: &Progress) -> Result<(), Failure> {
    progress.result(SCHEMA.trim_end());
    Ok(())
}
