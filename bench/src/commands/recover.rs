//! `bench recover FILE.mcap.part [--out FILE.mcap]`

use super::record::Said;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use recordings::{McapReader, Recovered, recover};
use std::path::{Path, PathBuf};

/// Places of damage that are listed.
const PLACES_LISTED: usize = 10;

/// Rescue a truncated or damaged recording: every complete chunk comes back, in a new file
///
/// The damaged file stays as it is. The new one's certificate says what is missing; nothing is invented.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The damaged recording, .mcap.part or .mcap
    file: PathBuf,
    /// Recording to write [default: FILE.mcap for FILE.mcap.part, FILE-recovered.mcap for FILE.mcap]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Where the file no longer says what its run is
    #[command(flatten)]
    said: Said,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let source = &args.file;
    let named_as_closed = source.extension().is_some_and(|extension| extension == "mcap");
    if named_as_closed
        && args.out.is_none()
        && let Some(certificate) = whole(source)
    {
        progress.result(&format!("{}: is sound, {certificate}; nothing to recover", source.display()));
        return Ok(());
    }
    let target = args.out.clone().unwrap_or_else(|| default_target(source));
    let name = target.file_stem().unwrap_or_default().to_string_lossy();
    let recovered =
        recover(source, &target, &args.said.metadata(&name)).map_err(|error| Failure::of(Kind::Input, &error))?;
    report(source, &recovered).iter().for_each(|line| progress.result(line));
    if !recovered.run_known {
        progress.say(
            "what the recording said about its run is lost: protocol, role and plane are those of the command line; see \
             `bench recover --help`",
        );
    }
    Ok(())
}

/// What a recording that can be read to its end says about itself.
fn whole(path: &Path) -> Option<String> {
    let mut reader = McapReader::open(path).ok()?;
    let sound = reader.by_ref().all(|item| item.is_ok());
    reader.certificate().filter(|_| sound).map(ToString::to_string)
}

fn default_target(source: &Path) -> PathBuf {
    let stem = source.file_stem().unwrap_or_default();
    if source.extension().is_some_and(|extension| extension == "part") {
        return source.with_file_name(stem);
    }
    source.with_file_name(format!("{}-recovered.mcap", stem.to_string_lossy()))
}

fn report(source: &Path, recovered: &Recovered) -> Vec<String> {
    let Recovered { path, certificate, span_s, events, amplifier_reports, left_out, damage, ended, .. } = recovered;
    let span =
        span_s.map_or(String::new(), |(first_s, last_s)| format!(", from {first_s:.3} s to {last_s:.3} s of the run"));
    let mut lines = vec![
        format!(
            "{}: {} samples{span}, {events} events, {amplifier_reports} reports of the amplifier",
            source.display(),
            certificate.received
        ),
        match damage.first() {
            Some(first) => format!("damage begins at byte {}", first.bytes.start),
            None if *ended => "no damage was found".to_owned(),
            None => "no damage within; the file was not closed".to_owned(),
        },
    ];
    lines.extend(damage.iter().take(PLACES_LISTED).map(|place| format!("  {place} hold nothing sound")));
    if damage.len() > PLACES_LISTED {
        lines.push(format!("  and {} places more", damage.len() - PLACES_LISTED));
    }
    if *left_out > 0 {
        lines.push(format!("{left_out} samples were left out: they do not follow those before them"));
    }
    lines.push(format!("certificate: {certificate}"));
    lines.push(format!("recording: {}", path.display()));
    lines
}
