//! `bench profile list|show|schema|check`

mod check;
mod list;
mod outlook;
mod schema;
mod show;
mod words;

use crate::failure::Failure;
use crate::progress::Progress;
use clap::Subcommand;

/// List, show and check profiles; dry-run them on a model before anything moves
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    List(list::Args),
    Show(show::Args),
    Schema(schema::Args),
    Check(check::Args),
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    match &args.command {
        Command::List(args) => list::run(args, progress),
        Command::Show(args) => show::run(args, progress),
        Command::Schema(args) => schema::run(args, progress),
        Command::Check(args) => check::run(args, progress),
    }
}
