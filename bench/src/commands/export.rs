//! `bench export RUN.mcap|CAMPAIGN --out OUT`

use crate::exchange::content::Content;
use crate::exchange::export::{export_campaign, export_run};
use crate::exchange::format::Format;
use crate::exchange::source::Source;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use recordings::{CAMPAIGN_FILE, McapReader};
use std::path::{Path, PathBuf};

/// Export a recording or a campaign folder to CSV, ASAM MDF4 or Parquet
///
/// Without an option: the contract's columns, each value at the time at which it was measured; an .mf4 file also holds the events and
/// the amplifier's reports. A campaign as CSV is a campaign again. Nothing is ever overwritten.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recording (.mcap) or campaign folder
    source: PathBuf,
    /// File to write: .csv, .csv.gz, .mf4 or .parquet; of a campaign: folder
    #[arg(long)]
    out: PathBuf,
    /// Format [default: by the extension of --out; of a campaign: csv]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Every field of every sample as the loop published it; of a recording with losses, too
    #[arg(long, conflicts_with_all = ["events", "amplifier"])]
    raw: bool,
    /// The events instead of the samples (CSV, Parquet)
    #[arg(long, conflicts_with = "amplifier")]
    events: bool,
    /// The amplifier's reports instead of the samples (CSV, Parquet)
    #[arg(long)]
    amplifier: bool,
}

impl Args {
    fn content(&self) -> Content {
        match self {
            Args { raw: true, .. } => Content::Raw,
            Args { events: true, .. } => Content::Events,
            Args { amplifier: true, .. } => Content::Amplifier,
            _ => Content::Rows,
        }
    }
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let content = args.content();
    if args.source.is_dir() {
        let format = args.format.unwrap_or(Format::Csv);
        let wrote = |file: &Path| progress.result(&format!("written: {}", file.display()));
        export_campaign(&args.source, content, format, &args.out, wrote)?;
        return Ok(());
    }
    if args.source.file_name().is_some_and(|name| name == CAMPAIGN_FILE) {
        let message = format!(
            "{}: expected a recording or a campaign folder, got the folder's list; name the folder",
            args.source.display()
        );
        return Err(Failure::new(Kind::Input, message));
    }
    let format = Format::of_file(&args.out, args.format)?;
    let source = Source::open(&args.source)?;
    let written = export_run(&source, content, format, &args.out)?;
    if content != Content::Rows {
        warn_of_loss(&args.source, progress);
    }
    progress.result(&format!("written: {}", written.display()));
    Ok(())
}

/// What is exported as it is may have gaps.
fn warn_of_loss(source: &Path, progress: &Progress) {
    let Ok(mut reader) = McapReader::open(source) else { return };
    reader.by_ref().for_each(drop);
    if let Some(certificate) = reader.certificate().filter(|certificate| !certificate.is_lossless()) {
        progress.say(&format!(
            "warning: {}: {certificate}; what is missing is missing in the export too",
            source.display()
        ));
    }
}
