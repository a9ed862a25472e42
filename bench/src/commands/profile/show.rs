//! `bench profile show NAME`

use crate::failure::Failure;
use crate::progress::Progress;

/// Print a profile: the text to start an own one from
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Profile: the name of a built-in one, or a file
    profile: String,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let script = crate::commands::run::profile(&args.profile)?;
    progress.result(script.text.trim_end());
    Ok(())
}
