//! Samples to an MCAP recording. Owned by the logger's thread: nothing here is meant for the loop.

use std::io::Write;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, McapResult, WriteOptions, Writer};
use rt_core::{LossCertificate, SAMPLE_VERSION, Sample};

use crate::ending::{self, LooseMessage};
use crate::error::{CampaignError, CutShort, Place};
use crate::part_file::{Existing, PartFile};
use crate::run_metadata::{AmplifierReport, Event, RunMetadata, Severity};
use crate::succession::{Mark, Misfit, Succession};
use crate::wire;

/// Unpacked size at which a chunk is closed: small enough that packing one stalls the logger for some 2 ms only, large
/// enough that zstd finds what repeats.
const CHUNK_BYTES: u64 = 128 * 1024;
/// Scheduled time that a chunk spans at most, ns. A logger that is killed loses the chunk that is open.
const CHUNK_NS: u64 = 500_000_000;
/// Level of zstd. Levels below zero pack less and are unpacked faster: this one costs a tenth more room than level 1 and takes half as
/// long to read.
const PACKING: i32 = -3;
/// Bytes of a message record besides the message.
const MESSAGE_OVERHEAD: u64 = 31;

/// What the header says wrote the file. No version: the bytes depend on the samples alone.
const LIBRARY: &str = "rec-bench";

/// Writes one run. The file is `NAME.mcap.part` until [`McapWriter::finish`]; one that is dropped before keeps that
/// name, and its complete chunks. A chunk is handed to the system as soon as it is complete, every 500 ms of samples.
///
/// Where the system refuses to write on (a full disk), the file is taken back to its last complete chunk and closed
/// there: see [`CutShort`].
pub struct McapWriter {
    /// `None`: the recording was cut short.
    writer: Option<Writer<NoSeek<PartFile>>>,
    cut: Option<CutShort>,
    existing: Existing,
    part: PathBuf,
    message: Vec<u8>,
    /// Everything that was appended.
    all: Succession,
    /// What of it stands in chunks that the system has taken.
    sound: Mark,
    chunk: Option<OpenChunk>,
}

#[derive(Clone, Copy)]
struct OpenChunk {
    bytes: u64,
    /// Scheduled time of its first sample; `None`: it has none yet.
    begin_ns: Option<u64>,
}

impl McapWriter {
    /// Starts `path` (which ends in `.mcap`) as `path.part`. The same metadata and samples give the same bytes.
    ///
    /// # Errors
    /// The extension is another, a recording or an unfinished part of this name exists (a measurement is never
    /// overwritten), or the system refuses.
    pub fn create(path: &Path, run: &RunMetadata) -> Result<McapWriter, CampaignError> {
        McapWriter::create_as(path, run, Existing::Keep)
    }

    pub(crate) fn create_as(path: &Path, run: &RunMetadata, existing: Existing) -> Result<McapWriter, CampaignError> {
        if path.extension().is_none_or(|extension| extension != "mcap") {
            let got = format!("{:?}", path.file_name().unwrap_or_default());
            return Err(CampaignError::content(Place::file(path), "a file name that ends in .mcap", got, "name it so"));
        }
        let file = PartFile::create(path, existing)?;
        let part = file.part().to_owned();
        let failed = |error| CampaignError::write(&part, io_error(error));
        let mut writer = WriteOptions::new()
            .profile(LIBRARY)
            .library(LIBRARY)
            .compression(Some(Compression::Zstd))
            .compression_level(PACKING.cast_unsigned())
            .compression_threads(0) // in this thread: packed bytes must not depend on the number of cores
            .chunk_size(Some(2 * CHUNK_BYTES)) // this writer closes them itself, before that
            .disable_seeking(true) // chunks reach the file whole, so that a crash leaves complete ones
            .create(NoSeek::new(file))
            .map_err(failed)?;
        match begin(&mut writer, run) {
            Ok(()) => Ok(McapWriter {
                writer: Some(writer),
                cut: None,
                existing,
                part,
                message: Vec::with_capacity(256),
                all: Succession::default(),
                sound: Mark::default(),
                chunk: None,
            }),
            Err(error) => {
                writer.into_inner().into_inner().discard();
                Err(failed(error))
            }
        }
    }

    /// Appends a sample. A sample whose number is left out is noted as a gap; ticks that the loop passed over are
    /// none.
    ///
    /// # Errors
    /// The sample is of another version or run than the first, does not follow the one before in tick, time and number
    /// of skipped ticks, or carries what a reader would refuse: no finite voltage or an infinite value. The system's
    /// refusal, which cuts the recording short: from then on every call says so.
    pub fn write(&mut self, sample: &Sample) -> Result<(), CampaignError> {
        self.check(sample)?;
        let mut message = std::mem::take(&mut self.message);
        wire::encode_sample(sample, &mut message);
        let written = self.append(wire::SAMPLE_CHANNEL, sample.tick, sample.scheduled_ns, &message);
        self.message = message;
        written?;
        self.all.push(sample);
        Ok(())
    }

    /// Appends an event. Events may stand anywhere between the samples.
    ///
    /// # Errors
    /// The system's refusal, as for [`write`](Self::write).
    pub fn write_event(&mut self, event: &Event) -> Result<(), CampaignError> {
        self.append(wire::EVENT_CHANNEL, event.tick, event.scheduled_ns, &wire::encode_event(event))
    }

    /// Appends a report of the motor amplifier. Reports may stand anywhere between the samples.
    ///
    /// # Errors
    /// The system's refusal, as for [`write`](Self::write).
    pub fn write_amplifier(&mut self, report: &AmplifierReport) -> Result<(), CampaignError> {
        self.append(wire::AMPLIFIER_CHANNEL, report.tick, report.arrived_ns, &wire::encode_amplifier(report))
    }

    /// What this recording can certify of a run that has `expected` samples (numbers 0 to `expected` - 1).
    pub fn certificate(&self, expected: u64) -> LossCertificate {
        self.all.certificate(expected)
    }

    /// Whether the recording was cut short, and where.
    pub fn cut_short(&self) -> Option<&CutShort> {
        self.cut.as_ref()
    }

    /// Writes the certificate, closes the file, waits until it is on the disk and gives it its name. A run with losses
    /// is closed like any other; its certificate says so.
    ///
    /// # Errors
    /// The certificate contradicts what was written (nothing false is signed; the file keeps its `.part`). The system
    /// refuses: what it has taken is closed with a certificate of its own. Where every sample was taken and only the
    /// index found no room, that is no error.
    pub fn finish(mut self, certificate: &LossCertificate) -> Result<PathBuf, CampaignError> {
        self.writable()?;
        if !self.all.agrees_with(certificate) {
            let own = self.all.certificate(certificate.expected);
            let expected = format!("a certificate that agrees with what was written (run {}: {own})", own.run);
            let got = format!("run {}: {certificate}", certificate.run);
            return Err(CampaignError::content(self.place(), expected, got, "write every sample that is counted"));
        }
        self.close_chunk()?;
        let writer = self.open_writer();
        let closed = writer
            .write_metadata(&record(wire::LOSS_RECORD, wire::loss_fields(certificate)))
            .and_then(|()| writer.finish().map(drop));
        let mut file = self.take_file();
        match closed.map_err(io_error).and_then(|()| file.flush_unsound()) {
            Ok(()) => file.commit(),
            Err(source) => {
                let error = self.keep_chunks(file, source, Some(certificate));
                let whole = self.cut.take().filter(|cut| cut.closed && cut.certificate == *certificate);
                whole.map_or(Err(error), |cut| Ok(cut.file))
            }
        }
    }

    fn append(&mut self, channel_id: u16, tick: u64, time_ns: u64, message: &[u8]) -> Result<(), CampaignError> {
        self.writable()?;
        // By the samples' times alone: an event may tell of an earlier time, a report's time is what somebody says it is.
        let sample_ns = (channel_id == wire::SAMPLE_CHANNEL).then_some(time_ns);
        let late = |chunk: &OpenChunk| Some(sample_ns?.saturating_sub(chunk.begin_ns?) >= CHUNK_NS);
        let full = |chunk: &OpenChunk| chunk.bytes >= CHUNK_BYTES || late(chunk).unwrap_or(false);
        if self.chunk.as_ref().is_some_and(full) {
            self.close_chunk()?;
        }
        // Scheduled time, not the clock's: the same run gives the same file.
        let sequence = tick as u32; // the format has 32 bits here; the message has the whole number
        let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        match self.open_writer().write_to_known_channel(&header, message) {
            Ok(()) => {
                let chunk = self.chunk.get_or_insert(OpenChunk { bytes: 0, begin_ns: None });
                chunk.begin_ns = chunk.begin_ns.or(sample_ns);
                chunk.bytes += message.len() as u64 + MESSAGE_OVERHEAD;
                Ok(())
            }
            Err(error) => Err(self.cut_short_by(error)),
        }
    }

    /// Closes the chunk and hands it to the system, so that it outlives this process.
    fn close_chunk(&mut self) -> Result<(), CampaignError> {
        self.chunk = None;
        match self.open_writer().flush() {
            Ok(()) => {
                self.sound = self.all.mark();
                Ok(())
            }
            Err(error) => Err(self.cut_short_by(error)),
        }
    }

    fn open_writer(&mut self) -> &mut Writer<NoSeek<PartFile>> {
        self.writer.as_mut().expect("callers ask `writable` first")
    }

    /// The refusal that cut the recording short, again, for whoever goes on writing.
    fn writable(&self) -> Result<(), CampaignError> {
        self.cut.clone().map_or(Ok(()), |cut| Err(cut.into()))
    }

    fn take_file(&mut self) -> PartFile {
        let writer = self.writer.take().expect("callers ask `writable` first");
        writer.into_inner().into_inner()
    }

    fn cut_short_by(&mut self, error: McapError) -> CampaignError {
        let file = self.take_file();
        self.keep_chunks(file, io_error(error), None)
    }

    /// The system refused: keeps the complete chunks and tries to close the file after them. `claimed`: the certificate
    /// that was to be written, which holds if every sample is in those chunks.
    fn keep_chunks(
        &mut self,
        mut file: PartFile,
        source: std::io::Error,
        claimed: Option<&LossCertificate>,
    ) -> CampaignError {
        let appended = self.all.count();
        self.all.back_to(self.sound);
        let last = self.all.last().copied();
        let whole = claimed.filter(|_| self.all.count() == appended);
        let certificate = whole.cloned().unwrap_or_else(|| self.all.own_certificate());
        let mut cut = CutShort {
            file: self.part.clone(),
            system: source.to_string(),
            certificate: certificate.clone(),
            end_s: last.map_or(0.0, |last| last.time_s()),
            closed: false,
        };
        if self.existing == Existing::Rescue {
            // It can be made again from what it was made from.
            self.cut = Some(cut);
            return CampaignError::write(&self.part, source);
        }
        let event = Event {
            tick: last.map_or(0, |last| last.tick),
            scheduled_ns: last.map_or(0, |last| last.scheduled_ns),
            severity: Severity::Error,
            source: "logger".to_owned(),
            text: format!("the recording was cut short here: {source}"),
        };
        let event = whole.is_none().then_some(&event);
        if file.cut_back().and_then(|()| self.end(&mut file, event, &certificate)).is_err() {
            // No room even for that. The complete chunks stay, for `bench recover`.
            let _ = file.cut_back();
        } else if let Ok(path) = file.commit() {
            cut.file = path;
            cut.closed = true;
        }
        self.cut = Some(cut.clone());
        cut.into()
    }

    fn end(&self, file: &mut PartFile, event: Option<&Event>, certificate: &LossCertificate) -> std::io::Result<()> {
        if let Some(event) = event {
            let message = LooseMessage {
                channel: wire::EVENT_CHANNEL,
                sequence: event.tick as u32,
                time_ns: event.scheduled_ns,
                data: &wire::encode_event(event),
            };
            file.write_all(&ending::message(&message))?;
        }
        file.write_all(&ending::metadata(wire::LOSS_RECORD, &wire::loss_fields(certificate)))?;
        file.write_all(&ending::end(file.crc32()))?;
        // Not `flush`: should this fail, the file is to be taken back to before it.
        file.flush_unsound()
    }

    fn place(&self) -> Place {
        Place::file(&self.part)
    }

    fn check(&self, sample: &Sample) -> Result<(), CampaignError> {
        let misfit = if sample.version == SAMPLE_VERSION {
            self.all.misfit(sample)
        } else {
            let (expected, got) = (SAMPLE_VERSION.to_string(), sample.version.to_string());
            Some(Misfit { column: "version", expected, got })
        };
        let Some(Misfit { column, expected, got }) = misfit else { return Ok(()) };
        let at = self.place().tick(sample.tick).column(column);
        Err(CampaignError::content(at, expected, got, "correct what publishes the samples"))
    }
}

/// What stands before the first message. It is handed to the system at once, in a chunk of its own: whatever is damaged
/// later, a reader knows what the file is.
fn begin(writer: &mut Writer<NoSeek<PartFile>>, run: &RunMetadata) -> McapResult<()> {
    writer.write_metadata(&record(wire::RUN_RECORD, wire::run_fields(run)))?;
    for (id, schema, topic) in [
        (wire::SAMPLE_CHANNEL, wire::SAMPLE_SCHEMA, wire::SAMPLE_TOPIC),
        (wire::EVENT_CHANNEL, wire::EVENT_SCHEMA, wire::EVENT_TOPIC),
        (wire::AMPLIFIER_CHANNEL, wire::AMPLIFIER_SCHEMA, wire::AMPLIFIER_TOPIC),
    ] {
        let schema = writer.add_schema(schema, wire::ENCODING, wire::SCHEMA)?;
        writer.add_channel_with_id(id, schema, topic, wire::ENCODING, &Default::default())?;
    }
    writer.flush()
}

fn record(name: &str, metadata: std::collections::BTreeMap<String, String>) -> Metadata {
    Metadata { name: name.to_owned(), metadata }
}

fn io_error(error: McapError) -> std::io::Error {
    match error {
        McapError::Io(source) => source,
        other => std::io::Error::other(other),
    }
}
