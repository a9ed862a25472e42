//! The lossless logger as a process of its own: it subscribes to a running service and writes one recording a run. The service
//! does not know it; what it does not get is certified.

mod run_file;

pub use run_file::{Ending, RecordedRun};

use recordings::{CampaignError, RunMetadata};
use rt_core::announce::Announcements;
use rt_core::presence::is_published;
use rt_core::{Delivery, LinkError, RunCommand, Sample, SampleSubscriber, send_command};
use run_file::{RunFile, Taken};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Longest wait for samples before the recorder looks for orders.
const LOOK: Duration = Duration::from_millis(50);
/// A run that is silent for this long makes the recorder ask whether its service is still there.
const SILENCE: Duration = Duration::from_secs(2);
/// A run that was under way when the recorder came is described within this time, or not at all.
const PATIENCE: Duration = Duration::from_secs(1);

/// A service that runs answers at once; one on a machine under load a little later.
const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// What follows when the disk runs full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum OnFull {
    /// The run goes on unrecorded.
    #[default]
    GoOn,
    /// The service is asked for an orderly end of the run.
    Stop,
}

/// What follows when samples are lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum OnGap {
    /// The gap is certified in the recording.
    #[default]
    Certify,
    /// That, and the service is asked for an orderly end of the run.
    Stop,
}

/// What is to be recorded, and where.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The service.
    pub instance: String,
    /// The first run's recording, `.mcap`; further ones are called `NAME-2.mcap` and so on.
    pub out: PathBuf,
    /// So many runs; `None`: until it is told to end.
    pub runs: Option<u32>,
    /// When the disk runs full.
    pub on_full: OnFull,
    /// When samples are lost.
    pub on_gap: OnGap,
    /// What is to be said of runs whose service does not tell it; the name is the file's.
    pub metadata: RunMetadata,
}

/// Why nothing (more) is recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The samples could not be received.
    #[error("recorder: {0}")]
    Link(#[from] LinkError),
    /// A recording could not be begun.
    #[error("recorder: {0}")]
    Recording(#[from] CampaignError),
}

/// Who hears what happens.
pub trait Listener {
    /// Something a person should know now.
    fn say(&mut self, text: &str);
    /// A run is closed.
    fn closed(&mut self, run: &RecordedRun);
}

/// Records runs until the plan is fulfilled or `end` is set. What was closed has been told to the listener.
///
/// # Errors
/// The instance can't be subscribed to or sends what is no run; a recording can't be begun. What is open then is closed first.
pub fn record(plan: &Plan, end: &AtomicBool, listener: &mut dyn Listener) -> Result<(), RecorderError> {
    // Before the samples: of the first run that arrives whole, the description arrives, too.
    let announcements = Announcements::open(&plan.instance)?;
    let subscriber = SampleSubscriber::open(&plan.instance, Delivery::Lossless)?;
    listener.say(&format!("waiting for a run of instance {:?}", plan.instance));
    let mut recorder = Recorder {
        plan,
        listener,
        announcements,
        unheard: None,
        open: None,
        begun: 0,
        closed: 0,
        asked_to_stop: false,
    };
    let outcome = recorder.follow(subscriber, end);
    recorder.close(Ending::Interrupted);
    outcome
}

struct Recorder<'a> {
    plan: &'a Plan,
    listener: &'a mut dyn Listener,
    announcements: Announcements,
    /// Why an announcement was not understood, until a run begins that may have been the one.
    unheard: Option<LinkError>,
    open: Option<RunFile>,
    begun: u32,
    closed: u32,
    /// For the run that is open.
    asked_to_stop: bool,
}

impl Recorder<'_> {
    /// Records what arrives until the plan is fulfilled or `end` is set; a run that is under way then stays open.
    fn follow(&mut self, mut subscriber: SampleSubscriber, end: &AtomicBool) -> Result<(), RecorderError> {
        let mut samples = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
        let mut heard = Instant::now();
        while !self.fulfilled() && !end.load(Ordering::Relaxed) {
            samples.clear();
            let received = subscriber.receive(LOOK, &mut samples);
            // The recordings count for themselves: what they certify is what they hold.
            while subscriber.take_certificate().is_some() {}
            // Before anything that may fail: what has arrived comes from nowhere again.
            self.take(&samples)?;
            received?;
            if let Err(error) = self.announcements.hear() {
                self.unheard = Some(error);
            }
            if !samples.is_empty() || self.open.is_none() {
                heard = Instant::now();
            } else if heard.elapsed() >= SILENCE {
                heard = Instant::now();
                if !is_published(&self.plan.instance)? {
                    // What it published just before it went is in the buffer.
                    while subscriber.drain(&mut samples)? > 0 {}
                    self.take(&samples)?;
                    self.close(Ending::ServiceGone);
                }
            }
        }
        Ok(())
    }

    fn fulfilled(&self) -> bool {
        self.plan.runs.is_some_and(|runs| self.closed >= runs)
    }

    fn take(&mut self, samples: &[Sample]) -> Result<(), RecorderError> {
        for sample in samples {
            if self.open.as_ref().is_some_and(|open| !open.continues(sample)) {
                self.close(Ending::NextRun);
            }
            if self.fulfilled() {
                return Ok(());
            }
            let mut open = match self.open.take() {
                Some(open) => open,
                None => self.begin(sample)?,
            };
            let taken = open.take(sample);
            self.open = Some(open);
            self.heed(taken);
            if sample.last() {
                self.close(Ending::Last);
            }
        }
        Ok(())
    }

    fn begin(&mut self, first: &Sample) -> Result<RunFile, RecorderError> {
        let path = free_file(&self.plan.out, self.begun + 1);
        let mut metadata = self.description(first.run).unwrap_or_else(|| {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            RunMetadata { name, ..self.plan.metadata.clone() }
        });
        metadata.notes.insert("instance".to_owned(), self.plan.instance.clone());
        metadata.notes.insert("recorder".to_owned(), "bench record".to_owned());
        metadata.notes.insert("recorded_from_utc".to_owned(), jiff::Timestamp::now().to_string());
        let file = RunFile::create(&path, &metadata, first)?;
        self.begun += 1;
        self.asked_to_stop = false;
        self.listener.say(&format!("run {}: recording to {}", first.run, path.display()));
        if file.missed_before() > 0 {
            let missed = file.missed_before();
            self.listener.say(&format!("run {}: was under way; its first {missed} samples are missing", first.run));
        }
        Ok(file)
    }

    /// What the service says of its run. A run of which it says nothing, or nothing that is understood, is recorded all the same.
    fn description(&mut self, run: u32) -> Option<RunMetadata> {
        let unheard = self.unheard.take();
        let why = match self.announcements.of_run(run, PATIENCE) {
            Ok(Some(record)) => match RunMetadata::from_record(record) {
                Ok(metadata) => return Some(metadata),
                Err(error) => error,
            },
            Ok(None) => unheard.map_or_else(|| "it says nothing".to_owned(), |error| error.to_string()),
            Err(error) => error.to_string(),
        };
        self.listener.say(&format!(
            "run {run}: expected its service to say what it runs: {why}; the recording has protocol, role and plane from the command line and \
             can't be replayed"
        ));
        None
    }

    fn heed(&mut self, taken: Taken) {
        match taken {
            Taken::Recorded | Taken::Passed => {}
            Taken::AfterGap(first, last) => {
                self.listener.say(&format!("samples {first}..={last} were lost; the gap is certified"));
                if self.plan.on_gap == OnGap::Stop {
                    self.stop_service();
                }
            }
            Taken::Cut(cut) => {
                self.listener.say(&cut.to_string());
                match self.plan.on_full {
                    OnFull::Stop => self.stop_service(),
                    OnFull::GoOn => self.listener.say("the run goes on unrecorded"),
                }
            }
            Taken::Refused(why) => self.listener.say(&format!("a sample is left out: {why}")),
        }
    }

    fn stop_service(&mut self) {
        if std::mem::replace(&mut self.asked_to_stop, true) {
            return;
        }
        let instance = &self.plan.instance;
        let text = match ask_to_stop(instance) {
            Ok(()) => format!("instance {instance:?} is asked to stop"),
            Err(error) => format!("the run goes on, it could not be asked to stop: {error}"),
        };
        self.listener.say(&text);
    }

    fn close(&mut self, ending: Ending) {
        if let Some(open) = self.open.take() {
            let run = open.close(ending);
            self.closed += 1;
            self.listener.closed(&run);
        }
    }
}

/// Asks the service of `instance` for an orderly end of its run. That it was heard is seen in the samples.
///
/// # Errors
/// No service of this name listens, or answers; or it does not take the stop. In words, why.
pub fn ask_to_stop(instance: &str) -> Result<(), String> {
    let answer = send_command(instance, RunCommand::Stop, ANSWER_PATIENCE).map_err(|error| error.to_string())?;
    answer.taken.map(drop).map_err(|refusal| refusal.to_string())
}

/// The name for the run with this number (from 1), or the next one that is free: a measurement is never overwritten, and the
/// first file was asked for by name, so that it is refused where it exists.
fn free_file(out: &Path, number: u32) -> PathBuf {
    if number <= 1 {
        return out.to_owned();
    }
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    first_free((number..).map(|n| out.with_file_name(format!("{stem}-{n}.mcap"))))
}

/// The first of these `.mcap` names that neither a recording bears nor the part of one, which would be refused as well.
pub(crate) fn first_free(mut names: impl Iterator<Item = PathBuf>) -> PathBuf {
    let there = |path: &Path| path.symlink_metadata().is_ok();
    let free = |path: &PathBuf| !there(path) && !there(&path.with_extension("mcap.part"));
    names.find(free).expect("there are more names than files")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusing::refusing;
    use rt_core::Refusal;

    #[test]
    fn neither_a_recording_nor_the_part_of_one_leaves_its_name_free() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let put = |name: &str| std::fs::write(dir.path().join(name), "").expect("writable");
        let free = || {
            let names = (1..).map(|n| dir.path().join(format!("a.b-{n}.mcap")));
            first_free(names).file_name().map(|name| name.to_string_lossy().into_owned())
        };
        assert_eq!(free().as_deref(), Some("a.b-1.mcap"));
        put("a.b-1.mcap");
        assert_eq!(free().as_deref(), Some("a.b-2.mcap"));
        put("a.b-2.mcap.part");
        assert_eq!(free().as_deref(), Some("a.b-3.mcap"));
        assert_eq!(free_file(&dir.path().join("a.b.mcap"), 1), dir.path().join("a.b.mcap"), "asked for by its name");
        assert_eq!(free_file(&dir.path().join("a.b.mcap"), 2), dir.path().join("a.b-3.mcap"));
    }

    #[test]
    fn a_stop_that_was_refused_was_not_asked_for() {
        let instance = format!("test-record-refused-{}", std::process::id());
        let asked = refusing(&instance, Refusal::ReadOnly, || ask_to_stop(&instance));
        assert_eq!(asked, Err(Refusal::ReadOnly.to_string()));
    }
}
