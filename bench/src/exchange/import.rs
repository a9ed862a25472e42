//! The contract's CSV to recordings. A CSV run says less than a recording: what it does not say is 0 (stage times, ages, the active step)
//! and noted.

use super::export::{make_parent, renamed};
use super::output::{refuse_existing, unwritten};
use crate::failure::{Failure, Kind};
use recordings::{CAMPAIGN_FILE, Campaign, CampaignError, CsvRows, McapWriter, Recording, RunEntry, RunMetadata};
use rt_core::{Input, LossCertificate, Sample, flags};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Name of the note that says where a recording came from.
pub const IMPORTED_NOTE: &str = "imported";

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imported {
    /// The recording.
    pub path: PathBuf,
    /// N of N.
    pub certificate: LossCertificate,
}

/// Makes a recording of a CSV run. The sample's number is the row's (`tick`, too: what rate the rows have is not known before);
/// `scheduled_ns` is the row's time, to the nanosecond.
///
/// # Errors
/// The CSV is not the contract's; a time before 0 or two in the same nanosecond; a segment that a sample can't hold; the target exists;
/// the system refuses (2). Nothing is left behind.
pub fn import_run(source: &Path, run: &RunMetadata, target: &Path) -> Result<Imported, Failure> {
    // The whole file is checked before anything is written: what is wrong in its last line must leave no half recording.
    let failed = |e: CampaignError| Failure::of(Kind::Input, &e);
    let mut rows = Converter::new(source);
    for block in CsvRows::open(source, run.protocol).map_err(failed)? {
        rows.convert(&block.map_err(failed)?, |_| Ok(()))?;
    }
    let last = rows.row - 1;

    let mut noted = run.clone();
    let name = source.file_name().unwrap_or_default().to_string_lossy();
    let note = format!("from {name}; a tick is a row, what CSV does not say (ages, lateness, stage times, step) is 0");
    noted.notes.insert(IMPORTED_NOTE.to_owned(), note);
    let mut writer = McapWriter::create(target, &noted).map_err(failed)?;
    let mut rows = Converter::new(source);
    for block in CsvRows::open(source, run.protocol).map_err(failed)? {
        rows.convert(&block.map_err(failed)?, |mut sample| {
            if sample.tick == last {
                sample.flags |= flags::LAST;
            }
            writer.write(&sample).map_err(failed)
        })?;
    }
    let certificate = writer.certificate(rows.row);
    let path = writer.finish(&certificate).map_err(failed)?;
    Ok(Imported { path, certificate })
}

/// Makes a campaign of recordings of the campaign in `dir`: CSV runs are imported, recordings are copied as they are.
///
/// # Errors
/// No campaign; the target holds one already; as [`import_run`] (2). Runs that were written before the error stay.
pub fn import_campaign(dir: &Path, target: &Path, mut each: impl FnMut(&Imported)) -> Result<Campaign, Failure> {
    let campaign = Campaign::open(dir).map_err(|e| Failure::of(Kind::Input, &e))?;
    let runs = renamed(&campaign, "mcap")?;
    refuse_existing(&target.join(CAMPAIGN_FILE))?;
    for (from, to) in campaign.runs.iter().zip(&runs) {
        let (source, file) = (dir.join(&from.file), target.join(&to.file));
        make_parent(&file)?;
        if from.file == to.file {
            copy(&source, &file)?;
        } else {
            each(&import_run(&source, &metadata(to), &file)?);
        }
    }
    let imported = Campaign { dir: target.to_owned(), name: campaign.name, rig: campaign.rig, runs };
    imported.write_toml().map_err(|e| Failure::of(Kind::Input, &e))?;
    Ok(imported)
}

fn metadata(entry: &RunEntry) -> RunMetadata {
    let name = Path::new(&entry.file).file_stem().unwrap_or_default().to_string_lossy();
    RunMetadata::new(name, entry.protocol, entry.role, entry.plane)
}

fn copy(source: &Path, target: &Path) -> Result<(), Failure> {
    let mut output = super::output::Output::create(target)?;
    let copied = File::open(source).and_then(|mut from| io::copy(&mut from, &mut output));
    copied.map_err(|e| unwritten(target, &e))?;
    output.commit().map(drop)
}

/// Rows to samples.
struct Converter<'s> {
    source: &'s Path,
    /// Number of the next row.
    row: u64,
    last_ns: Option<u64>,
}

impl<'s> Converter<'s> {
    fn new(source: &'s Path) -> Self {
        Converter { source, row: 0, last_ns: None }
    }

    fn convert(
        &mut self,
        rows: &Recording,
        mut take: impl FnMut(Sample) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        for row in 0..rows.len() {
            take(self.sample(rows, row)?)?;
        }
        Ok(())
    }

    fn sample(&mut self, rows: &Recording, row: usize) -> Result<Sample, Failure> {
        /// Up to here (104 days) a number of nanoseconds is exact as an f64.
        const LONGEST_S: f64 = 9_007_199.0;
        let fault = |column: &str, expected: String, got: String, remedy: &str| {
            let place = format!("{}, row {}, {column}", self.source.display(), self.row + 1);
            Failure::new(Kind::Input, format!("{place}: expected {expected}, got {got}; {remedy}"))
        };
        let time_s = rows.time_s[row];
        if !(0.0..=LONGEST_S).contains(&time_s) {
            let expected = format!("a time since the run's start, 0 to {LONGEST_S} s");
            return Err(fault("time_s", expected, format!("{time_s} s"), "let the run begin at 0"));
        }
        let scheduled_ns = (time_s * 1e9).round() as u64;
        if let Some(last_ns) = self.last_ns
            && scheduled_ns <= last_ns
        {
            let expected = format!("a time at least 1 ns after the row before ({last_ns} ns)");
            return Err(fault("time_s", expected, format!("{time_s} s"), "a recording's times are whole nanoseconds"));
        }
        let segment = u32::try_from(rows.segment[row]).map_err(|_| {
            let expected = format!("0 to {}", u32::MAX);
            fault("segment", expected, rows.segment[row].to_string(), "count the set points from 0")
        })?;
        let mut sample = Sample {
            tick: self.row,
            scheduled_ns,
            voltage_v: rows.voltage_v[row],
            angle_deg: rows.angle_deg[row],
            pressure1_bar: rows.pressure1_bar[row],
            pressure2_bar: rows.pressure2_bar[row],
            torque_nm: rows.torque_nm[row],
            volume_ml: rows.volume_ml[row],
            segment,
            ..Sample::BLANK
        };
        for (open, bit) in [(rows.brake_open[row], flags::BRAKE_OPEN), (rows.bypass_open[row], flags::BYPASS_OPEN)] {
            sample.flags |= if open { bit } else { 0 };
        }
        let measured = sample.measurement();
        let there = Input::ALL.into_iter().filter(|input| measured.value(*input).is_finite());
        sample.quality = there.map(Input::bit).fold(0, std::ops::BitOr::bitor);
        self.row += 1;
        self.last_ns = Some(scheduled_ns);
        Ok(sample)
    }
}
