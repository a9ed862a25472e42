//! An MCAP recording to samples, as a stream: memory holds one chunk at a time. All checksums of the file are checked.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use mcap::records::{Channel, Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use rt_core::{LossCertificate, Sample};

use crate::alignment::Alignment;
use crate::error::Place;
use crate::run_metadata::{AmplifierReport, Event, RunMetadata};
use crate::succession::{Misfit, Succession};
use crate::wire::{self, BadField};
use crate::{CampaignError, Plane, Protocol, Recording};

/// No record or chunk of ours comes near this; a damaged length field must not ask for more memory.
const LONGEST_RECORD: usize = 64 * 1024 * 1024;

const REMEDY: &str =
    "nothing of the file is used: copy it again, record the run again, or rescue what is sound with `bench recover`";

/// What a recording holds, in the order in which it was written.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// A tick.
    Sample(Sample),
    /// Something that happened besides.
    Event(Event),
    /// What the motor amplifier told of itself.
    Amplifier(AmplifierReport),
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
    samples: Succession,
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
            match found.map_err(|broken| broken.explain(path, 0, 0))? {
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
            samples: Succession::default(),
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
        self.samples.count()
    }

    /// The tick at which a sample would follow, for places in messages.
    fn next_tick(&self) -> u64 {
        self.samples.last().map_or(0, |last| last.tick + 1)
    }

    fn advance(&mut self) -> Result<Option<Item>, CampaignError> {
        loop {
            let topics = &self.topics;
            let found = self.records.next(|record| Found::of(record, topics));
            match found.map_err(|broken| broken.explain(&self.path, self.samples(), self.next_tick()))? {
                Some(Found::Message(Ok(Item::Sample(sample)))) => {
                    self.check(&sample)?;
                    self.samples.push(&sample);
                    return Ok(Some(Item::Sample(sample)));
                }
                Some(Found::Message(Ok(other))) => return Ok(Some(other)),
                Some(Found::Message(Err(got))) => {
                    let at = Place::file(&self.path).tick(self.next_tick());
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
        let Some(Misfit { column, expected, got }) = self.samples.misfit(sample) else { return Ok(()) };
        Err(CampaignError::content(Place::file(&self.path).tick(sample.tick).column(column), expected, got, REMEDY))
    }

    fn check_end(&self) -> Result<(), CampaignError> {
        let at = Place::file(&self.path);
        let Some(certificate) = &self.certificate else {
            let expected = "a loss certificate at the end of the recording";
            let got = format!("{} samples without one: the recording was not closed", self.samples());
            return Err(CampaignError::content(at, expected, got, REMEDY));
        };
        if !self.samples.agrees_with(certificate) {
            let expected = format!("the samples that its certificate says ({certificate})");
            let got = self.samples.certificate(certificate.expected).to_string();
            return Err(CampaignError::content(at, expected, got, REMEDY));
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
    let (mut recording, mut alignment) = (Recording::default(), Alignment::default());
    for item in &mut reader {
        if let Item::Sample(sample) = item? {
            recording.push_sample(&sample);
            alignment.push(&sample);
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
    alignment.apply(&mut recording);
    recording.check_whole(protocol, Place::file(path))?;
    Ok(recording)
}

/// A topic that is read.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Topic {
    Sample,
    Event,
    Amplifier,
}

impl Topic {
    /// `None`: one that is ignored.
    pub(crate) fn of(channel: &Channel) -> Option<Topic> {
        match channel.topic.as_str() {
            _ if channel.message_encoding != wire::ENCODING => None,
            wire::SAMPLE_TOPIC => Some(Topic::Sample),
            wire::EVENT_TOPIC => Some(Topic::Event),
            wire::AMPLIFIER_TOPIC => Some(Topic::Amplifier),
            _ => None,
        }
    }
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
                Some(Topic::Amplifier) => Found::Message(wire::decode_amplifier(&data).map(Item::Amplifier)),
                None => Found::Other,
            },
            Record::Channel(channel) => match Topic::of(&channel) {
                Some(topic) => Found::Channel { id: channel.id, topic },
                None => Found::Other,
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
                    let used = matches!(opcode, op::HEADER | op::CHANNEL | op::MESSAGE | op::METADATA);
                    // What is not used is not parsed, either: the fewer lengths of a damaged file are believed, the better.
                    let record = if used {
                        parse_record(opcode, data)
                    } else {
                        Ok(Record::Unknown { opcode, data: data.into() })
                    };
                    return record.map(|record| Some(take(record))).map_err(Broken::Content);
                }
            }
        }
    }
}

impl Broken {
    /// `samples` came before; `tick`: where the next one would stand.
    fn explain(self, path: &Path, samples: u64, tick: u64) -> CampaignError {
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
        CampaignError::content(Place::file(path).tick(tick), expected, got, REMEDY)
    }
}

fn bad_field(path: &Path, bad: BadField) -> CampaignError {
    let remedy = "use the version of the program that wrote the file, or record the run again";
    CampaignError::content(Place::file(path).column(bad.key), bad.expected, bad.got, remedy)
}
