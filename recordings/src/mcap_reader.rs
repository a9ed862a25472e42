//! An MCAP recording to samples, as a stream: memory holds one chunk at a time. All checksums of the file are checked.

use std::fs::File;
use std::path::{Path, PathBuf};

use mcap::records::{Channel, Record, op};
use mcap::{McapError, parse_record};
use rt_core::{LossCertificate, Sample};

use crate::chunk::{Chunk, Inner};
use crate::error::Place;
use crate::mcap_records::{Broken, REMEDY, Records};
use crate::run_metadata::{AmplifierReport, Event, RunMetadata};
use crate::succession::{Misfit, Succession};
use crate::wire::{self, BadField};
use crate::{CampaignError, Plane, Protocol, Recording, Rows};

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
    topics: Topics,
    chunk: Chunk,
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
            let found = records.next(|opcode, data| match opcode {
                op::HEADER => Ok(None),
                op::METADATA => parse_record(opcode, data).map(|record| match record {
                    Record::Metadata(metadata) if metadata.name == wire::RUN_RECORD => Some(Some(metadata)),
                    _ => Some(None),
                }),
                _ => Ok(Some(None)),
            });
            let found = match found {
                Ok(Some(found)) => found.map_err(Broken::Content),
                Ok(None) => Ok(Some(None)),
                Err(broken) => Err(broken),
            };
            match found.map_err(|broken| broken.explain(path, 0, 0))? {
                Some(Some(metadata)) => break metadata,
                None => {}
                Some(None) => {
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
            topics: Topics::default(),
            chunk: Chunk::default(),
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

    /// Goes on to the next item. Where it is a sample it is left in `sample`: whoever reads millions of them copies each but once.
    #[inline]
    pub(crate) fn advance(&mut self, sample: &mut Sample) -> Result<Step, CampaignError> {
        let step = self.step(sample);
        match &step {
            Ok(Step::Sample | Step::Other(_)) => {}
            Ok(Step::End) => self.done = true,
            Err(_) => {
                self.done = true;
                self.certificate = None;
            }
        }
        step
    }

    #[inline]
    fn step(&mut self, sample: &mut Sample) -> Result<Step, CampaignError> {
        if self.done {
            return Ok(Step::End);
        }
        loop {
            // Inside a chunk first: that is where the messages are.
            let record = match self.chunk.next_record() {
                Ok(Some(record)) => record,
                Ok(None) => match self.outside(sample)? {
                    Some(step) => return Ok(step),
                    None => continue,
                },
                Err(error) => return Err(self.explain(Broken::Content(error))),
            };
            match record {
                Inner::Message { channel, window, length } => match self.topics.of(channel) {
                    Some(Topic::Sample) => {
                        if let Err(got) = wire::decode_sample_in(window, length, sample) {
                            return Err(self.not_of_this_format(got));
                        }
                        return self.follows(sample).map(|()| Step::Sample);
                    }
                    Some(topic) => {
                        let item = topic.decode(Inner::message(window, length));
                        return item.map(Step::Other).map_err(|got| self.not_of_this_format(got));
                    }
                    None => {}
                },
                Inner::Other(op::CHANNEL, data) => match parse_record(op::CHANNEL, data) {
                    Ok(Record::Channel(channel)) => drop(self.topics.learn(&channel)),
                    Ok(_) => {}
                    Err(error) => return Err(self.explain(Broken::Content(error))),
                },
                Inner::Other(..) => {}
            }
        }
    }

    /// Whether the sample may follow those before it; if so, it is one of them from now on.
    #[inline]
    fn follows(&mut self, sample: &Sample) -> Result<(), CampaignError> {
        if let Some(Misfit { column, expected, got }) = self.samples.misfit(sample) {
            let at = Place::file(&self.path).tick(sample.tick).column(column);
            return Err(CampaignError::content(at, expected, got, REMEDY));
        }
        self.samples.push(sample);
        Ok(())
    }

    /// What stands outside of chunks: a chunk is opened, most else is passed over.
    fn outside(&mut self, sample: &mut Sample) -> Result<Option<Step>, CampaignError> {
        enum Found {
            Chunk(Result<(), McapError>),
            Record(Result<Record<'static>, McapError>),
            Other,
        }
        let chunk = &mut self.chunk;
        let found = self.records.next(|opcode, data| match opcode {
            op::CHUNK => Found::Chunk(chunk.open(data)),
            // What is not used is not parsed, either: the fewer lengths of a damaged file are believed, the better.
            op::CHANNEL | op::MESSAGE | op::METADATA => {
                Found::Record(parse_record(opcode, data).map(Record::into_owned))
            }
            _ => Found::Other,
        });
        let record = match found.map_err(|broken| self.explain(broken))? {
            None => return self.check_end().map(|()| Some(Step::End)),
            Some(Found::Other | Found::Chunk(Ok(()))) => return Ok(None),
            Some(Found::Chunk(Err(error))) => Err(error),
            Some(Found::Record(record)) => record,
        };
        match record.map_err(|error| self.explain(Broken::Content(error)))? {
            Record::Message { header, data } => {
                let Some(topic) = self.topics.of(header.channel_id) else { return Ok(None) };
                match topic.decode(&data).map_err(|got| self.not_of_this_format(got))? {
                    Item::Sample(found) => {
                        *sample = found;
                        self.follows(sample).map(|()| Some(Step::Sample))
                    }
                    other => Ok(Some(Step::Other(other))),
                }
            }
            Record::Channel(channel) => {
                self.topics.learn(&channel);
                Ok(None)
            }
            Record::Metadata(metadata) if metadata.name == wire::LOSS_RECORD => {
                let certificate = wire::loss_of(&metadata.metadata).map_err(|bad| bad_field(&self.path, bad))?;
                self.certificate = Some(certificate);
                Ok(None)
            }
            _ => Ok(None),
        }
    }

    #[cold]
    fn explain(&self, broken: Broken) -> CampaignError {
        broken.explain(&self.path, self.samples(), self.next_tick())
    }

    #[cold]
    fn not_of_this_format(&self, got: String) -> CampaignError {
        let at = Place::file(&self.path).tick(self.next_tick());
        let remedy = "use the version of the program that wrote the file";
        CampaignError::content(at, "a message of this format", got, remedy)
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

/// What [`McapReader::advance`] came to.
pub(crate) enum Step {
    /// A sample, in the caller's memory.
    Sample,
    /// Anything else.
    Other(Item),
    /// The end of a whole recording.
    End,
}

impl Iterator for McapReader {
    type Item = Result<Item, CampaignError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        let mut sample = Sample::BLANK;
        match self.advance(&mut sample) {
            Ok(Step::Sample) => Some(Ok(Item::Sample(sample))),
            Ok(Step::Other(item)) => Some(Ok(item)),
            Ok(Step::End) => None,
            Err(error) => Some(Err(error)),
        }
    }
}

/// Reads a whole recording into columns and checks it against the contract. `plane`: what the campaign says, if known.
pub(crate) fn read_recording(
    path: &Path,
    protocol: Protocol,
    plane: Option<Plane>,
) -> Result<Recording, CampaignError> {
    let mut rows = Rows::open(path)?;
    let run = rows.run();
    let disagrees = |key: &str, campaign: &str, recording: &str| {
        let at = Place::file(path).column(key);
        let remedy = "correct campaign.toml, or use the recording that belongs there";
        Err(CampaignError::content(at, format!("{campaign:?} as in the campaign"), format!("{recording:?}"), remedy))
    };
    if run.protocol != protocol {
        return disagrees("protocol", protocol.as_str(), run.protocol.as_str());
    }
    if let Some(plane) = plane
        && run.plane != plane
    {
        return disagrees("plane", plane.as_str(), run.plane.as_str());
    }
    let mut recording = Recording::default();
    for block in &mut rows {
        recording.append(block?);
    }
    Ok(recording)
}

/// A topic that is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Topic {
    Sample,
    Event,
    Amplifier,
}

impl Topic {
    /// `None`: one that is ignored.
    fn named(channel: &Channel) -> Option<Topic> {
        match channel.topic.as_str() {
            _ if channel.message_encoding != wire::ENCODING => None,
            wire::SAMPLE_TOPIC => Some(Topic::Sample),
            wire::EVENT_TOPIC => Some(Topic::Event),
            wire::AMPLIFIER_TOPIC => Some(Topic::Amplifier),
            _ => None,
        }
    }

    /// The message's content, or what is wrong with it.
    pub(crate) fn decode(self, message: &[u8]) -> Result<Item, String> {
        match self {
            Topic::Sample => wire::decode_sample(message).map(Item::Sample),
            Topic::Event => wire::decode_event(message).map(Item::Event),
            Topic::Amplifier => wire::decode_amplifier(message).map(Item::Amplifier),
        }
    }
}

/// The topics that are read, by the numbers of their channels. There are few.
#[derive(Clone, Debug, Default)]
pub(crate) struct Topics(Vec<(u16, Topic)>);

impl Topics {
    /// As this project has always numbered them.
    pub(crate) fn usual() -> Topics {
        Topics(vec![
            (wire::SAMPLE_CHANNEL, Topic::Sample),
            (wire::EVENT_CHANNEL, Topic::Event),
            (wire::AMPLIFIER_CHANNEL, Topic::Amplifier),
        ])
    }

    #[inline]
    pub(crate) fn of(&self, channel: u16) -> Option<Topic> {
        self.0.iter().find(|(number, _)| *number == channel).map(|(_, topic)| *topic)
    }

    /// Takes a channel in, if it is of a topic that is read; false: it is not. The last one of a number counts.
    pub(crate) fn learn(&mut self, channel: &Channel) -> bool {
        let Some(topic) = Topic::named(channel) else { return false };
        self.0.retain(|(number, _)| *number != channel.id);
        self.0.push((channel.id, topic));
        true
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

fn bad_field(path: &Path, bad: BadField) -> CampaignError {
    let remedy = "use the version of the program that wrote the file, or record the run again";
    CampaignError::content(Place::file(path).column(bad.key), bad.expected, bad.got, remedy)
}
