//! An MCAP recording to samples, as a stream: memory holds one chunk at a time. All checksums of the file are checked.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use mcap::records::{Metadata, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use rt_core::{LossCertificate, Sample};

use crate::error::Place;
use crate::mcap_writer::unfit_value;
use crate::run_metadata::{Event, RunMetadata};
use crate::wire::{self, BadField};
use crate::{CampaignError, Plane, Protocol, Recording};

/// No record or chunk of ours comes near this; a damaged length field must not ask for more memory.
const LONGEST_RECORD: usize = 64 * 1024 * 1024;

const REMEDY: &str = "nothing of the file is used: copy it again or record the run again";

/// What a recording holds, in the order in which it was written.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// A tick.
    Sample(Sample),
    /// Something that happened besides.
    Event(Event),
}

/// Reads an MCAP recording from start to end. Samples come in order of tick and time.
///
/// What comes before an error is sound, in a truncated file too: a caller that wants to rescue it may, but
/// [`Recording::read`] refuses the file. Only a stream that ended without an error was read whole.
pub struct McapReader {
    path: PathBuf,
    records: Records,
    run: RunMetadata,
    topics: HashMap<u16, Topic>,
    last: Option<Sample>,
    samples: u64,
    certificate: Option<LossCertificate>,
    done: bool,
}

impl McapReader {
    /// Opens a recording and reads what it says about its run.
    ///
    /// # Errors
    /// The system's refusal; not an MCAP file; no metadata of this format before the first message.
    pub fn open(path: &Path) -> Result<McapReader, CampaignError> {
        let file = File::open(path).map_err(|source| CampaignError::read(path, source))?;
        let mut records = Records::new(file);
        let run = loop {
            let found = records.next(|record| match record {
                Record::Metadata(metadata) if metadata.name == wire::RUN_RECORD => Some(Ok(metadata)),
                Record::Header(_) => None,
                _ => Some(Err(())),
            });
            match found.map_err(|broken| broken.explain(path, 0))? {
                Some(Some(Ok(metadata))) => break metadata,
                Some(None) => {}
                Some(Some(Err(()))) | None => {
                    let expected = format!("the metadata record \"{}\" before anything else", wire::RUN_RECORD);
                    let got = "an MCAP file without it";
                    let remedy = "only recordings of this project's format are read; export others to CSV";
                    return Err(CampaignError::content(Place::file(path), expected, got, remedy));
                }
            }
        };
        let run = wire::run_of(&run.metadata).map_err(|bad| bad_field(path, bad))?;
        Ok(McapReader {
            path: path.to_owned(),
            records,
            run,
            topics: HashMap::new(),
            last: None,
            samples: 0,
            certificate: None,
            done: false,
        })
    }

    /// What the recording says about its run.
    pub fn run(&self) -> &RunMetadata {
        &self.run
    }

    /// The loss certificate; `None` until the stream has ended without an error.
    pub fn certificate(&self) -> Option<&LossCertificate> {
        self.certificate.as_ref().filter(|_| self.done)
    }

    /// Samples read so far.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    fn advance(&mut self) -> Result<Option<Item>, CampaignError> {
        loop {
            let topics = &self.topics;
            let found = self.records.next(|record| Found::of(record, topics));
            match found.map_err(|broken| broken.explain(&self.path, self.samples))? {
                Some(Found::Message(Ok(Item::Sample(sample)))) => {
                    self.check(&sample)?;
                    self.last = Some(sample);
                    self.samples += 1;
                    return Ok(Some(Item::Sample(sample)));
                }
                Some(Found::Message(Ok(event))) => return Ok(Some(event)),
                Some(Found::Message(Err(got))) => {
                    let tick = self.last.map_or(0, |last| last.tick + 1);
                    let at = Place::file(&self.path).tick(tick);
                    let remedy = "use the version of the program that wrote the file";
                    return Err(CampaignError::content(at, "a message of this format", got, remedy));
                }
                Some(Found::Channel { id, topic }) => {
                    self.topics.insert(id, topic);
                }
                Some(Found::Loss(metadata)) => {
                    let certificate = wire::loss_of(&metadata.metadata).map_err(|bad| bad_field(&self.path, bad))?;
                    self.certificate = Some(certificate);
                }
                Some(Found::Other) => {}
                None => return self.check_end().map(|()| None),
            }
        }
    }

    fn check(&self, sample: &Sample) -> Result<(), CampaignError> {
        let fault = |column: &str, expected: String, got: String| {
            let at = Place::file(&self.path).tick(sample.tick).column(column);
            Err(CampaignError::content(at, expected, got, REMEDY))
        };
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
        match unfit_value(sample) {
            Some((column, expected, got)) => fault(column, expected.to_owned(), got.to_string()),
            None => Ok(()),
        }
    }

    fn check_end(&self) -> Result<(), CampaignError> {
        let at = Place::file(&self.path);
        let Some(certificate) = &self.certificate else {
            let expected = "a loss certificate at the end of the recording";
            let got = format!("{} samples without one: the recording was not closed", self.samples);
            return Err(CampaignError::content(at, expected, got, REMEDY));
        };
        if certificate.received != self.samples {
            let expected = format!("as many samples as its certificate says ({certificate})");
            return Err(CampaignError::content(at, expected, self.samples.to_string(), REMEDY));
        }
        Ok(())
    }
}

impl Iterator for McapReader {
    type Item = Result<Item, CampaignError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let item = self.advance();
        if !matches!(item, Ok(Some(_))) {
            self.done = true;
        }
        if item.is_err() {
            self.certificate = None;
        }
        item.transpose()
    }
}

/// Reads a whole recording into columns and checks it against the contract. `plane`: what the campaign says, if known.
pub(crate) fn read_recording(
    path: &Path,
    protocol: Protocol,
    plane: Option<Plane>,
) -> Result<Recording, CampaignError> {
    let mut reader = McapReader::open(path)?;
    let disagrees = |key: &str, campaign: &str, recording: &str| {
        let at = Place::file(path).column(key);
        let remedy = "correct campaign.toml, or use the recording that belongs there";
        Err(CampaignError::content(at, format!("{campaign:?} as in the campaign"), format!("{recording:?}"), remedy))
    };
    if reader.run().protocol != protocol {
        return disagrees("protocol", protocol.as_str(), reader.run().protocol.as_str());
    }
    if let Some(plane) = plane
        && reader.run().plane != plane
    {
        return disagrees("plane", plane.as_str(), reader.run().plane.as_str());
    }
    let mut recording = Recording::default();
    for item in &mut reader {
        if let Item::Sample(sample) = item? {
            recording.push_sample(&sample);
        }
    }
    if let Some(certificate) = reader.certificate()
        && !certificate.is_lossless()
    {
        let at = match certificate.gaps.first() {
            Some((first, _)) => Place::file(path).tick(*first),
            None => Place::file(path),
        };
        let remedy = "the command in a gap is unknown, so the run can't be simulated: record it again";
        return Err(CampaignError::content(at, "a recording without loss", certificate.to_string(), remedy));
    }
    recording.check_whole(protocol, Place::file(path))?;
    Ok(recording)
}

#[derive(Clone, Copy, PartialEq)]
enum Topic {
    Sample,
    Event,
}

/// What matters of a record here.
enum Found {
    Channel { id: u16, topic: Topic },
    Message(Result<Item, String>),
    Loss(Metadata),
    Other,
}

impl Found {
    fn of(record: Record<'_>, topics: &HashMap<u16, Topic>) -> Found {
        match record {
            Record::Message { header, data } => match topics.get(&header.channel_id) {
                Some(Topic::Sample) => Found::Message(wire::decode_sample(&data).map(Item::Sample)),
                Some(Topic::Event) => Found::Message(wire::decode_event(&data).map(Item::Event)),
                None => Found::Other,
            },
            Record::Channel(channel) if channel.message_encoding == wire::ENCODING => match channel.topic.as_str() {
                wire::SAMPLE_TOPIC => Found::Channel { id: channel.id, topic: Topic::Sample },
                wire::EVENT_TOPIC => Found::Channel { id: channel.id, topic: Topic::Event },
                _ => Found::Other,
            },
            Record::Metadata(metadata) if metadata.name == wire::LOSS_RECORD => Found::Loss(metadata),
            _ => Found::Other,
        }
    }
}

/// The file's records, one at a time, those inside chunks included.
struct Records {
    file: BufReader<File>,
    reader: LinearReader,
}

/// Why there is no next record.
enum Broken {
    System(io::Error),
    Content(McapError),
}

impl Records {
    fn new(file: File) -> Self {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(LONGEST_RECORD);
        Self { file: BufReader::with_capacity(256 * 1024, file), reader: LinearReader::new_with_options(options) }
    }

    /// Hands the next record to `take`; `None` at the end of a complete file.
    fn next<T>(&mut self, take: impl FnOnce(Record<'_>) -> T) -> Result<Option<T>, Broken> {
        loop {
            match self.reader.next_event() {
                None => return Ok(None),
                Some(Err(error)) => return Err(Broken::Content(error)),
                Some(Ok(LinearReadEvent::ReadRequest(bytes))) => {
                    let read = self.file.read(self.reader.insert(bytes)).map_err(Broken::System)?;
                    self.reader.notify_read(read);
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    return parse_record(opcode, data).map(|record| Some(take(record))).map_err(Broken::Content);
                }
            }
        }
    }
}

impl Broken {
    fn explain(self, path: &Path, samples: u64) -> CampaignError {
        let (expected, got) = match self {
            Broken::System(source) => return CampaignError::read(path, source),
            Broken::Content(McapError::UnexpectedEof) => {
                ("a complete MCAP recording", format!("one that is cut short after {samples} complete samples"))
            }
            Broken::Content(McapError::BadMagic) if samples == 0 => {
                ("an MCAP recording", "a file that does not start as one".to_owned())
            }
            Broken::Content(error) => {
                ("a sound MCAP recording", format!("one that is damaged after {samples} sound samples ({error})"))
            }
        };
        CampaignError::content(Place::file(path).tick(samples), expected, got, REMEDY)
    }
}

fn bad_field(path: &Path, bad: BadField) -> CampaignError {
    let remedy = "use the version of the program that wrote the file, or record the run again";
    CampaignError::content(Place::file(path).column(bad.key), bad.expected, bad.got, remedy)
}
