//! Rescue of a truncated or damaged recording: every complete chunk comes back, in a new file; nothing is invented.

use std::fmt;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap::parse_record;
use mcap::records::{Record, op};
use rt_core::{LossCertificate, Sample};

use crate::CampaignError;
use crate::chunk::{Chunk, Inner};
use crate::error::Place;
use crate::mcap_reader::{Item, Topics};
use crate::mcap_writer::McapWriter;
use crate::part_file::Existing;
use crate::run_metadata::RunMetadata;
use crate::survey::{Survey, open_chunk, read};

/// Bytes of a file that are no sound record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// First and first no more.
    pub bytes: Range<u64>,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "bytes {}..{}", self.bytes.start, self.bytes.end)
    }
}

/// What a rescue brought.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovered {
    /// The new recording.
    pub path: PathBuf,
    /// What it says about its run.
    pub run: RunMetadata,
    /// The damaged file said so; false: what it said was lost, and the caller's words stand for it.
    pub run_known: bool,
    /// What it certifies. The end was seen if the run's last sample is there, or the damaged file's own certificate is.
    pub certificate: LossCertificate,
    /// Scheduled time of the first and the last sample, s.
    pub span_s: Option<(f64, f64)>,
    /// Events that came back.
    pub events: u64,
    /// Reports of the amplifier that came back.
    pub amplifier_reports: u64,
    /// Sound samples that were left out, since they do not follow those before them.
    pub left_out: u64,
    /// What was passed over, in the order of the file.
    pub damage: Vec<Damage>,
    /// The damaged file had the end of a closed one.
    pub ended: bool,
}

/// Writes every sample and event that stands in a complete chunk of `source` to a new recording `target`. `source` stays
/// as it is. `unknown`: what is to be said of the run where `source` no longer does.
///
/// # Errors
/// Nothing of this project's format is in `source`; `target` exists; the system refuses.
pub fn recover(source: &Path, target: &Path, unknown: &RunMetadata) -> Result<Recovered, CampaignError> {
    let system = |error| CampaignError::read(source, error);
    let file = File::open(source).map_err(system)?;
    let survey = Survey::of(&file).map_err(system)?;
    let topics = topics(source, &file, &survey)?;
    let run_known = survey.run.is_some();
    let mut run = survey.run.unwrap_or_else(|| unknown.clone());
    run.notes.insert("recovered".to_owned(), note(source, &survey.damage, run_known));

    let mut writer = McapWriter::create_as(target, &run, Existing::Rescue)?;
    let mut tally = Tally::default();
    let mut open = Chunk::default();
    for chunk in &survey.chunks {
        reopen(&mut open, source, &file, chunk)?;
        while let Ok(Some(record)) = open.next_record() {
            let Inner::Message { channel, window, length } = record else { continue };
            let Some(topic) = topics.of(channel) else { continue };
            let item = topic.decode(Inner::message(window, length));
            match item.map_err(|got| unread(source, chunk, got))? {
                Item::Sample(sample) => tally.sample(&mut writer, &sample)?,
                Item::Event(event) => {
                    writer.write_event(&event)?;
                    tally.events += 1;
                }
                Item::Amplifier(report) => {
                    writer.write_amplifier(&report)?;
                    tally.amplifier_reports += 1;
                }
            }
        }
    }
    let certificate = certificate(&writer, survey.certificate.as_ref(), tally.ended);
    let path = writer.finish(&certificate)?;
    Ok(Recovered {
        path,
        run,
        run_known,
        certificate,
        span_s: tally.span_s,
        events: tally.events,
        amplifier_reports: tally.amplifier_reports,
        left_out: tally.left_out,
        damage: survey.damage.into_iter().map(|bytes| Damage { bytes }).collect(),
        ended: survey.ended,
    })
}

/// What was written to the new recording.
#[derive(Default)]
struct Tally {
    events: u64,
    amplifier_reports: u64,
    left_out: u64,
    span_s: Option<(f64, f64)>,
    /// The run's last sample is there.
    ended: bool,
}

impl Tally {
    fn sample(&mut self, writer: &mut McapWriter, sample: &Sample) -> Result<(), CampaignError> {
        // Of the samples before it: what comes after the last one is not of this run.
        if self.ended {
            self.left_out += 1;
            return Ok(());
        }
        match writer.write(sample) {
            Ok(()) => {
                let first_s = self.span_s.map_or(sample.time_s(), |(first_s, _)| first_s);
                self.span_s = Some((first_s, sample.time_s()));
                self.ended = sample.last();
                Ok(())
            }
            Err(CampaignError::Content(_)) => {
                self.left_out += 1;
                Ok(())
            }
            Err(error) => Err(error),
        }
    }
}

/// What can be said of the run as a whole. The damaged file's own certificate tells its length where the last sample is gone.
fn certificate(writer: &McapWriter, of_source: Option<&LossCertificate>, ended: bool) -> LossCertificate {
    let own = writer.certificate(0);
    let seen = own.received + own.gaps.iter().map(|(first, last)| last - first + 1).sum::<u64>();
    let of_source = of_source.filter(|c| c.run == own.run && c.expected >= seen);
    match of_source {
        Some(told) => LossCertificate { end_seen: told.end_seen || ended, ..writer.certificate(told.expected) },
        None => LossCertificate { end_seen: ended, ..writer.certificate(seen) },
    }
}

/// The topic of each channel: as the file's sound chunks say, or as this project has always numbered them.
fn topics(source: &Path, file: &File, survey: &Survey) -> Result<Topics, CampaignError> {
    let mut topics = Topics::default();
    let mut foreign = false;
    let mut open = Chunk::default();
    for chunk in &survey.chunks {
        reopen(&mut open, source, file, chunk)?;
        while let Ok(Some(record)) = open.next_record() {
            if let Inner::Other(op::CHANNEL, data) = record
                && let Ok(Record::Channel(channel)) = parse_record(op::CHANNEL, data)
            {
                foreign |= !topics.learn(&channel);
            }
        }
        // All channels stand before the first message.
        if !topics.is_empty() {
            return Ok(topics);
        }
    }
    if foreign || (survey.run.is_none() && survey.chunks.is_empty()) {
        let got = format!("{} bytes without any sound record of one", survey.bytes);
        let remedy = "there is nothing to recover; is it the right file?";
        return Err(CampaignError::content(Place::file(source), "a recording of this project", got, remedy));
    }
    Ok(Topics::usual())
}

/// Opens a chunk that the survey has proven.
fn reopen(open: &mut Chunk, source: &Path, file: &File, chunk: &Range<u64>) -> Result<(), CampaignError> {
    let bytes = read(file, chunk.clone()).map_err(|error| CampaignError::read(source, error))?;
    open_chunk(open, &bytes).ok_or_else(|| {
        let expected = format!("the sound chunk at byte {} that was there before", chunk.start);
        let remedy = "let nothing write to the file while it is recovered";
        CampaignError::content(Place::file(source), expected, "another content", remedy)
    })
}

fn unread(source: &Path, chunk: &Range<u64>, got: String) -> CampaignError {
    let expected = format!("messages of this format in the sound chunk at byte {}", chunk.start);
    let remedy = "use the version of the program that wrote the file";
    CampaignError::content(Place::file(source), expected, got, remedy)
}

/// What the new recording says about its origin.
fn note(source: &Path, damage: &[Range<u64>], run_known: bool) -> String {
    let name = source.file_name().unwrap_or_default().to_string_lossy();
    let at = match damage {
        [] => "no damage within".to_owned(),
        [first, ..] => format!("damage in {} places, from byte {} on", damage.len(), first.start),
    };
    let run = if run_known {
        ""
    } else {
        "; what it said about its run was lost, and protocol, role and plane were given anew"
    };
    format!("from {name}: {at}{run}")
}
