//! The lossless logger as a process of its own: it subscribes to a running service and writes one recording a run. The service
//! does not know it; what it does not get is certified.

mod run_file;
mod service;

pub use run_file::{Ending, RecordedRun};
pub use service::ask_to_stop;

use recordings::{CampaignError, RunMetadata};
use rt_core::{Delivery, LinkError, Sample, SampleSubscriber};
use run_file::{RunFile, Taken};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Longest wait for samples before the recorder looks for orders.
const LOOK: Duration = Duration::from_millis(50);
/// A run that is silent for this long makes the recorder ask whether its service is still there.
const SILENCE: Duration = Duration::from_secs(2);

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
    /// What is to be said of each run; the name is the file's.
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
    let subscriber = SampleSubscriber::open(&plan.instance, Delivery::Lossless)?;
    listener.say(&format!("waiting for a run of instance {:?}", plan.instance));
    let mut recorder = Recorder { plan, listener, open: None, begun: 0, closed: 0, asked_to_stop: false };
    let outcome = recorder.follow(subscriber, end);
    recorder.close(Ending::Interrupted);
    outcome
}

struct Recorder<'a> {
    plan: &'a Plan,
    listener: &'a mut dyn Listener,
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
            self.take(&samples)?;
            received?;
            if !samples.is_empty() || self.open.is_none() {
                heard = Instant::now();
            } else if heard.elapsed() >= SILENCE {
                heard = Instant::now();
                if !service::publishes(&self.plan.instance)? {
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
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut metadata = RunMetadata { name, ..self.plan.metadata.clone() };
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

/// The name for the run with this number (from 1), or the next one that is free: a measurement is never overwritten, and the
/// first file was asked for by name, so that it is refused where it exists.
fn free_file(out: &Path, number: u32) -> PathBuf {
    if number <= 1 {
        return out.to_owned();
    }
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let taken = |path: &Path| path.exists() || path.with_extension("mcap.part").exists();
    let names = (number..).map(|n| out.with_file_name(format!("{stem}-{n}.mcap")));
    names.into_iter().find(|path| !taken(path)).expect("there are more names than files")
}
