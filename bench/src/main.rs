//! The command line.

use bench::commands::{help, run};
use bench::failure::{Failure, Kind};
use bench::progress::Progress;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let cli = help::parse(); // ends with 2 on bad usage, with 0 on --help and --version
    let progress = Progress::for_stderr();
    let writer = progress.clone();
    tracing_subscriber::fmt()
        // A link says itself what it meets.
        .with_env_filter(EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn,zenoh=error")))
        .with_writer(move || writer.clone())
        .init();

    // A panic is a defect: its message stands on stderr already, the exit code must still be the documented one.
    let outcome = catch_unwind(AssertUnwindSafe(|| run(&cli, &progress)))
        .unwrap_or_else(|_| Err(Failure::new(Kind::Internal, "internal error, see above; please report it")));
    // A failure of the command itself comes first.
    match outcome.and_then(|()| progress.taken()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            progress.say(&format!("error: {failure}"));
            ExitCode::from(failure.exit_code())
        }
    }
}
