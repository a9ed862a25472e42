//! Samples to an MCAP recording. Owned by the logger's thread: nothing here is meant for the loop.

use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};
use rt_core::{LossCertificate, SAMPLE_VERSION, Sample};

use crate::CampaignError;
use crate::error::Place;
use crate::part_file::{Existing, PartFile, part_path};
use crate::run_metadata::{Event, RunMetadata};
use crate::wire;

/// Unpacked size at which a chunk is closed: small enough that packing one stalls the logger for some 2 ms only, large
/// enough that zstd finds what repeats.
const CHUNK_BYTES: u64 = 128 * 1024;

/// What the header says wrote the file. No version: the bytes depend on the samples alone.
const LIBRARY: &str = "rec-bench";

/// Writes one run. The file is `NAME.mcap.part` until [`McapWriter::finish`]; one that is dropped before keeps that
/// name, and its complete chunks.
pub struct McapWriter {
    writer: Writer<NoSeek<PartFile>>,
    target: PathBuf,
    sample_channel: u16,
    event_channel: u16,
    message: Vec<u8>,
    last: Option<Sample>,
    recorded: u64,
    gaps: Vec<(u64, u64)>,
}

impl McapWriter {
    /// Starts `path` (which ends in `.mcap`) as `path.part`. The same metadata and samples give the same bytes.
    ///
    /// # Errors
    /// The extension is another, a recording or an unfinished part of this name exists (a measurement is never
    /// overwritten), or the system refuses.
    pub fn create(path: &Path, run: &RunMetadata) -> Result<McapWriter, CampaignError> {
        if path.extension().is_none_or(|extension| extension != "mcap") {
            let got = format!("{:?}", path.file_name().unwrap_or_default());
            return Err(CampaignError::content(Place::file(path), "a file name that ends in .mcap", got, "name it so"));
        }
        let file = PartFile::create(path, Existing::Keep)?;
        let target = file.target().to_owned();
        let failed = |error| write_error(&target, error);
        let mut writer = WriteOptions::new()
            .profile(LIBRARY)
            .library(LIBRARY)
            .compression(Some(Compression::Zstd))
            .compression_threads(0) // in this thread: packed bytes must not depend on the number of cores
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true) // chunks reach the file whole, so that a crash leaves complete ones
            .create(NoSeek::new(file))
            .map_err(failed)?;
        writer.write_metadata(&record(wire::RUN_RECORD, wire::run_fields(run))).map_err(failed)?;
        let mut channel = |schema, topic| {
            let schema = writer.add_schema(schema, wire::ENCODING, wire::SCHEMA)?;
            writer.add_channel(schema, topic, wire::ENCODING, &Default::default())
        };
        let sample_channel = channel(wire::SAMPLE_SCHEMA, wire::SAMPLE_TOPIC).map_err(failed)?;
        let event_channel = channel(wire::EVENT_SCHEMA, wire::EVENT_TOPIC).map_err(failed)?;
        Ok(McapWriter {
            writer,
            target,
            sample_channel,
            event_channel,
            message: Vec::with_capacity(256),
            last: None,
            recorded: 0,
            gaps: Vec::new(),
        })
    }

    /// Appends a sample. A sample whose number is left out is noted as a gap; ticks that the loop passed over are
    /// none.
    ///
    /// # Errors
    /// The sample is of another version or run than the first, does not follow the one before in tick and time, or
    /// carries what a reader would refuse: no finite voltage or an infinite value. The system's refusal.
    pub fn write(&mut self, sample: &Sample) -> Result<(), CampaignError> {
        self.check(sample)?;
        let expected = self.last.map_or(0, |last| last.sequence() + 1);
        if sample.sequence() > expected {
            self.gaps.push((expected, sample.sequence() - 1));
        }
        let mut message = std::mem::take(&mut self.message);
        wire::encode_sample(sample, &mut message);
        let written = self.append(self.sample_channel, sample.tick, sample.scheduled_ns, &message);
        self.message = message;
        written?;
        self.last = Some(*sample);
        self.recorded += 1;
        Ok(())
    }

    /// Appends an event. Events may stand anywhere between the samples.
    pub fn write_event(&mut self, event: &Event) -> Result<(), CampaignError> {
        self.append(self.event_channel, event.tick, event.scheduled_ns, &wire::encode_event(event))
    }

    /// What this recording can certify of a run that has `expected` samples (numbers 0 to `expected` - 1).
    pub fn certificate(&self, expected: u64) -> LossCertificate {
        let (run, seen) = self.last.map_or((0, 0), |last| (last.run, last.sequence() + 1));
        let mut gaps = self.gaps.clone();
        if expected > seen {
            gaps.push((seen, expected - 1));
        }
        LossCertificate { run, expected, received: self.recorded, gaps, end_seen: true }
    }

    /// Writes the certificate, closes the file, waits until it is on the disk and gives it its name. A run with losses
    /// is closed like any other; its certificate says so.
    ///
    /// # Errors
    /// The certificate contradicts what was written (nothing false is signed), or the system refuses; the file then
    /// keeps its `.part`.
    pub fn finish(mut self, certificate: &LossCertificate) -> Result<PathBuf, CampaignError> {
        let own = self.certificate(certificate.expected);
        let same_run = self.last.is_none() || own.run == certificate.run;
        let seen = self.last.map_or(0, |last| last.sequence() + 1);
        if !same_run
            || certificate.expected < seen
            || own.received != certificate.received
            || own.gaps != certificate.gaps
        {
            let expected = format!("a certificate that agrees with what was written (run {}: {own})", own.run);
            let got = format!("run {}: {certificate}", certificate.run);
            return Err(CampaignError::content(self.place(), expected, got, "write every sample that is counted"));
        }
        let failed = |error| write_error(&self.target, error);
        self.writer.write_metadata(&record(wire::LOSS_RECORD, wire::loss_fields(certificate))).map_err(failed)?;
        self.writer.finish().map_err(failed)?;
        self.writer.into_inner().into_inner().commit()
    }

    fn append(&mut self, channel_id: u16, tick: u64, time_ns: u64, message: &[u8]) -> Result<(), CampaignError> {
        // Scheduled time, not the clock's: the same run gives the same file.
        let sequence = tick as u32; // the format has 32 bits here; the message has the whole number
        let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, message).map_err(|error| write_error(&self.target, error))
    }

    fn place(&self) -> Place {
        Place::file(&part_path(&self.target))
    }

    fn check(&self, sample: &Sample) -> Result<(), CampaignError> {
        let fault = |column: &str, expected: String, got: String| {
            let at = self.place().tick(sample.tick).column(column);
            Err(CampaignError::content(at, expected, got, "correct what publishes the samples"))
        };
        if sample.version != SAMPLE_VERSION {
            return fault("version", SAMPLE_VERSION.to_string(), sample.version.to_string());
        }
        if let Some(last) = &self.last {
            if sample.run != last.run {
                return fault("run", format!("samples of run {}", last.run), sample.run.to_string());
            }
            if sample.tick <= last.tick {
                return fault("tick", format!("a tick after {}", last.tick), sample.tick.to_string());
            }
            if sample.scheduled_ns <= last.scheduled_ns {
                let expected = format!("a time after {} ns", last.scheduled_ns);
                return fault("scheduled_ns", expected, format!("{} ns", sample.scheduled_ns));
            }
        }
        if let Some((column, expected, got)) = unfit_value(sample) {
            return fault(column, expected.to_owned(), got.to_string());
        }
        Ok(())
    }
}

/// A value that a recording can't hold: its column, what is expected, what came.
pub(crate) fn unfit_value(sample: &Sample) -> Option<(&'static str, &'static str, f64)> {
    if !sample.voltage_v.is_finite() {
        return Some(("voltage_v", "a finite number", sample.voltage_v));
    }
    let measured = [
        ("angle_deg", sample.angle_deg),
        ("pressure1_bar", sample.pressure1_bar),
        ("pressure2_bar", sample.pressure2_bar),
        ("torque_nm", sample.torque_nm),
        ("volume_ml", sample.volume_ml),
    ];
    let (column, value) = measured.into_iter().find(|(_, value)| value.is_infinite())?;
    Some((column, "a finite number, or NaN for a missing value", value))
}

fn record(name: &str, metadata: std::collections::BTreeMap<String, String>) -> Metadata {
    Metadata { name: name.to_owned(), metadata }
}

fn write_error(target: &Path, error: McapError) -> CampaignError {
    let source = match error {
        McapError::Io(source) => source,
        other => std::io::Error::other(other),
    };
    CampaignError::write(&part_path(target), source)
}
