//! `bench import RUN.csv --protocol P --role R --plane P --out RUN.mcap`, `bench import CAMPAIGN --out FOLDER`

use crate::exchange::import::{Imported, import_campaign, import_run};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use recordings::{Plane, Protocol, Role, RunMetadata};
use std::path::PathBuf;

/// Import CSV with the contract's columns: a run, or a campaign folder
///
/// Any rate will do. What CSV does not say (ages, lateness, stage times, the active step) is 0 and noted in the recording.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Run (.csv, .csv.gz), or campaign folder
    source: PathBuf,
    /// Recording to write (.mcap); of a campaign: folder
    #[arg(long)]
    out: PathBuf,
    /// Protocol of the run; a campaign says it itself, as role and plane
    #[arg(long)]
    protocol: Option<Protocol>,
    /// What the run is for
    #[arg(long)]
    role: Option<Role>,
    /// Plane in which the lever moves
    #[arg(long)]
    plane: Option<Plane>,
    /// Name of the run [default: that of the recording]
    #[arg(long)]
    name: Option<String>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let wrote = |imported: &Imported| {
        progress.result(&format!("written: {}, {}", imported.path.display(), imported.certificate));
    };
    let Args { source, out, protocol, role, plane, name } = args;
    let usage = |expected: &str, got: &str| {
        Failure::new(Kind::Input, format!("{}: expected {expected}, got {got}", source.display()))
    };
    if source.is_dir() {
        if protocol.is_some() || role.is_some() || plane.is_some() || name.is_some() {
            let expected = "protocol, role, plane and name of each run from campaign.toml";
            return Err(usage(expected, "options that say them; leave these out"));
        }
        let campaign = import_campaign(source, out, wrote)?;
        progress.result(&format!("campaign: {}, {} runs", out.display(), campaign.runs.len()));
        return Ok(());
    }
    let (Some(protocol), Some(role), Some(plane)) = (protocol, role, plane) else {
        let missing = [("--protocol", protocol.is_none()), ("--role", role.is_none()), ("--plane", plane.is_none())];
        let missing: Vec<_> = missing.iter().filter(|(_, missing)| *missing).map(|(option, _)| *option).collect();
        let expected = "what the run is, which a CSV file does not say (--protocol, --role, --plane)";
        return Err(usage(expected, &format!("a command without {}", missing.join(", "))));
    };
    let name = name.clone().unwrap_or_else(|| out.file_stem().unwrap_or_default().to_string_lossy().into_owned());
    wrote(&import_run(source, &RunMetadata::new(name, *protocol, *role, *plane), out)?);
    Ok(())
}
