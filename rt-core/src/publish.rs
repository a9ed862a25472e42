//! Publication: the loop hands its samples through a queue to a thread that puts them into shared memory. The
//! transport allocates for every sample it lends and makes a system call for every wake-up, so neither happens in the
//! loop's own thread.
//!
//! In real time the loop never waits: what does not fit is counted as lost. In virtual time it runs at many times real
//! time and would overrun any logger, so the thread holds back until every lossless logger's progress is within a
//! window of its buffer, and the loop waits behind it. A logger that dies is noticed; one that stalls is waited for
//! with bounded patience, and what it misses is in its loss certificate.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use ringbuf::traits::{Consumer, Observer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};

use crate::flow::{Flow, LoggerId};
use crate::rhythm::Rhythm;
use crate::link::{BUFFER_SAMPLES, Ipc, Link, LinkError, Progress};
use crate::system::time::{monotonic_ns, sleep_until_ns};
use crate::types::{SAMPLE_VERSION, Sample};

/// Where the loop's samples go.
pub trait Publish {
    /// Takes the sample of a tick.
    fn publish(&mut self, sample: &Sample) -> Handover;
    /// The same after the run, when the rig is safe and waiting does no harm: a run's last sample should arrive.
    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        self.publish(sample)
    }
}

/// What became of a sample that the loop handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handover {
    /// It will be published.
    Taken,
    /// There was no room, or nobody who takes it.
    Lost,
}

/// Keeps every sample in memory.
impl Publish for Vec<Sample> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.push(*sample);
        Handover::Taken
    }
}

/// Who waits for whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Virtual time: the loop waits for its lossless loggers, for each of them `patience` at most without any progress.
    Lockstep {
        /// For how long a logger may stand still before the run goes on without it.
        patience: Duration,
    },
    /// Real time: the loop never waits.
    RealTime,
}

impl Pace {
    /// Lockstep with 5 s of patience.
    pub const LOCKSTEP: Pace = Pace::Lockstep { patience: Duration::from_secs(5) };
}

/// Samples between the loop and the publication thread.
const QUEUE_SAMPLES: usize = 4096;
/// Samples that are sent between two wake-ups of the subscribers.
const BATCH_SAMPLES: usize = 256;
/// Samples that may be under way to a lossless logger. The rest of its buffer is kept for what is sent before the
/// thread knows of a logger that has just joined.
const WINDOW_SAMPLES: u64 = (BUFFER_SAMPLES - 8 * BATCH_SAMPLES) as u64;
/// The thread looks for new loggers after this many batches, and whenever it is idle.
const BATCHES_BETWEEN_LOOKS: u32 = 4;
/// The same in real time, where a batch is one sample.
const BATCHES_BETWEEN_LOOKS_IN_REAL_TIME: u32 = 100;
/// Sleep of a side that waits for the other.
const NAP: Duration = Duration::from_micros(100);
/// Sleep of the thread when nothing has come for a while.
const LONG_NAP: Duration = Duration::from_millis(1);
/// Naps before the sleep gets longer.
const NAPS_BEFORE_LONG: u32 = 200;
/// How long the last sample of a real-time run waits for room in the queue.
const PATIENCE_AFTER_RUN: Duration = Duration::from_secs(2);
/// A run that is held up for this long asks whether the logger's process is still alive.
const SUSPECT_AFTER: Duration = Duration::from_millis(50);
/// Between two such questions.
const SUSPECT_AGAIN: Duration = Duration::from_millis(100);

/// The publication of one instance. Dropping it publishes what was handed over, then ends the thread.
pub struct Publication {
    queue: HeapProd<Sample>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<(), LinkError>>>,
    pace: Pace,
    handed: u64,
}

/// What the thread lets the others know.
#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    ended: AtomicBool,
    sent: AtomicU64,
    taken_by_all: AtomicU64,
    loggers: AtomicUsize,
}

/// What [`Publication::settle`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settled {
    /// Samples that were published since the publication began.
    pub published: u64,
    /// Lossless loggers that are there now.
    pub loggers: usize,
    /// Samples that some lossless logger has not taken out of its buffer yet; those that the run went on without do
    /// not count.
    pub pending: u64,
}

impl Publication {
    /// Opens the services of `instance` and begins to publish.
    pub fn start(instance: &str, pace: Pace) -> Result<Self, LinkError> {
        Self::start_prepared(instance, pace, || {})
    }

    /// The same; the publication thread calls `prepare` first, to give itself a priority or a processor.
    pub fn start_prepared(
        instance: &str,
        pace: Pace,
        prepare: impl FnOnce() + Send + 'static,
    ) -> Result<Self, LinkError> {
        let (queue, from_loop) = HeapRb::new(QUEUE_SAMPLES).split();
        let shared = Arc::new(Shared::default());
        let (ready, started) = mpsc::channel();
        let thread = thread::Builder::new().name("publication".to_owned()).spawn({
            let (instance, shared) = (instance.to_owned(), Arc::clone(&shared));
            move || {
                let ended = SetOnDrop(Arc::clone(&shared));
                prepare();
                let mut sender = match Sender::open(&instance, pace, shared) {
                    Ok(sender) => sender,
                    Err(error) => {
                        // The other end can only be gone when the whole start was given up.
                        let _ = ready.send(Err(error));
                        return Ok(());
                    }
                };
                let _ = ready.send(Ok(()));
                let result = sender.serve(from_loop);
                drop(ended);
                result
            }
        });
        let thread = thread.map_err(|e| LinkError::Open {
            instance: instance.to_owned(),
            what: "start the publication thread",
            cause: e.to_string(),
        })?;
        started.recv().map_err(|_| LinkError::Ended)??;
        Ok(Publication { queue, shared, thread: Some(thread), pace, handed: 0 })
    }

    /// Waits until at least `count` lossless loggers are there: what is published from then on reaches each of them.
    pub fn wait_for_loggers(&self, count: usize, timeout: Duration) -> Result<(), LinkError> {
        let what = || {
            let there = self.shared.loggers.load(Ordering::Acquire);
            format!("{count} lossless loggers, {there} came")
        };
        self.wait_until(timeout, what, || self.shared.loggers.load(Ordering::Acquire) >= count)
    }

    /// Waits until everything that was handed over is published and, in lockstep, taken by every lossless logger; for
    /// the loggers no longer than `timeout`. To be called between runs, never within one.
    pub fn settle(&self, timeout: Duration) -> Result<Settled, LinkError> {
        let sent = || self.shared.sent.load(Ordering::Acquire);
        let pending = || self.handed.saturating_sub(self.shared.taken_by_all.load(Ordering::Acquire));
        let Pace::Lockstep { patience } = self.pace else {
            self.wait_until(timeout, || format!("{} samples to be published", self.handed), || sent() >= self.handed)?;
            return Ok(self.settled(0));
        };
        // Each logger that stalls may cost the thread its patience before it goes on.
        let limit = timeout + patience * crate::link::MAX_SUBSCRIBERS as u32;
        self.wait_until(limit, || format!("{} samples to be published", self.handed), || sent() >= self.handed)?;
        match self.wait_until(timeout, String::new, || pending() == 0) {
            Ok(()) | Err(LinkError::Timeout { .. }) => Ok(self.settled(pending())),
            Err(error) => Err(error),
        }
    }

    /// Publishes what was handed over and ends the thread.
    pub fn stop(mut self) -> Result<(), LinkError> {
        self.end()
    }

    fn settled(&self, pending: u64) -> Settled {
        let Shared { sent, loggers, .. } = &*self.shared;
        Settled { published: sent.load(Ordering::Acquire), loggers: loggers.load(Ordering::Acquire), pending }
    }

    fn wait_until(
        &self,
        timeout: Duration,
        what: impl Fn() -> String,
        done: impl Fn() -> bool,
    ) -> Result<(), LinkError> {
        let begin = Instant::now();
        loop {
            // Read before the condition: a thread that ended may have fulfilled it at the last moment.
            let ended = self.shared.ended.load(Ordering::Acquire);
            if done() {
                return Ok(());
            }
            if ended {
                return Err(LinkError::Ended);
            }
            if begin.elapsed() >= timeout {
                return Err(LinkError::Timeout { what: what(), waited_s: timeout.as_secs_f64() });
            }
            thread::sleep(NAP);
        }
    }

    fn end(&mut self) -> Result<(), LinkError> {
        self.shared.stop.store(true, Ordering::Release);
        let Some(thread) = self.thread.take() else { return Ok(()) };
        thread.join().unwrap_or(Err(LinkError::Ended))
    }
}

impl Publish for Publication {
    /// In lockstep this waits for room; in real time it neither waits nor makes a system call.
    fn publish(&mut self, sample: &Sample) -> Handover {
        // Room in the queue is worth nothing when nobody empties it any more.
        while !self.shared.ended.load(Ordering::Acquire) {
            if self.queue.try_push(*sample).is_ok() {
                self.handed += 1;
                return Handover::Taken;
            }
            if self.pace == Pace::RealTime {
                return Handover::Lost;
            }
            thread::sleep(NAP);
        }
        Handover::Lost
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        let begin = Instant::now();
        loop {
            let handover = self.publish(sample);
            let ended = self.shared.ended.load(Ordering::Acquire);
            if handover == Handover::Taken || ended || begin.elapsed() >= PATIENCE_AFTER_RUN {
                return handover;
            }
            thread::sleep(NAP);
        }
    }
}

impl Drop for Publication {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::error!(%error, "publication");
        }
    }
}

/// Tells that the thread has ended, by a panic too: nobody must wait for it in vain.
struct SetOnDrop(Arc<Shared>);

impl Drop for SetOnDrop {
    fn drop(&mut self) {
        self.0.ended.store(true, Ordering::Release);
    }
}

/// The publication thread's own things.
struct Sender {
    samples: Publisher<Ipc, Sample, ()>,
    wake: Notifier<Ipc>,
    progress: Subscriber<Ipc, Progress, ()>,
    link: Link,
    shared: Arc<Shared>,
    pace: Pace,
    flow: Flow,
    begin: Instant,
    suspected: Option<Instant>,
    ids: Vec<LoggerId>,
    rhythm: Rhythm,
}

impl Sender {
    fn open(instance: &str, pace: Pace, shared: Arc<Shared>) -> Result<Self, LinkError> {
        let link = Link::open(instance)?;
        let samples = link.loop_publisher()?;
        let wake = link.wake.notifier_builder().create();
        let wake = wake.map_err(|e| link.failed("create the notifier", e.to_string()))?;
        let progress = link.progress.subscriber_builder().create();
        let progress = progress.map_err(|e| link.failed("create the progress subscriber", e.to_string()))?;
        let patience = match pace {
            Pace::Lockstep { patience } => patience,
            Pace::RealTime => Duration::ZERO,
        };
        let flow = Flow::new(WINDOW_SAMPLES, patience);
        let (begin, ids) = (Instant::now(), Vec::new());
        Ok(Sender { samples, wake, progress, link, shared, pace, flow, begin, suspected: None, ids, rhythm: Rhythm::default() })
    }

    fn serve(&mut self, mut queue: HeapCons<Sample>) -> Result<(), LinkError> {
        let mut batch = Vec::with_capacity(BATCH_SAMPLES);
        let (mut naps, mut batches) = (0_u32, 0_u32);
        loop {
            // Read before the queue: what was handed over before the stop is published.
            let stop = self.shared.stop.load(Ordering::Acquire);
            if self.time_to_look(batches, naps) {
                self.look_for_loggers();
                self.hear_progress()?;
            }
            let waiting = queue.occupied_len();
            let room = if waiting > 0 { self.room() } else { 0 };
            batch.clear();
            batch.extend(queue.pop_iter().take(room.min(BATCH_SAMPLES)));
            if let Some(newest) = batch.last() {
                self.rhythm.heard(newest);
                self.send(&batch)?;
                naps = 0;
                batches = batches.wrapping_add(1);
            } else if waiting == 0 && stop {
                return Ok(());
            } else {
                naps = if waiting == 0 { naps.saturating_add(1) } else { 1 };
                match self.rhythm.next_look_ns(monotonic_ns()) {
                    Some(look_ns) if waiting == 0 => sleep_until_ns(look_ns),
                    _ => thread::sleep(if naps < NAPS_BEFORE_LONG { NAP } else { LONG_NAP }),
                }
            }
        }
    }

    /// In virtual time the loggers' progress decides how fast the run may go; in real time nobody waits for it.
    fn time_to_look(&self, batches: u32, naps: u32) -> bool {
        match self.pace {
            Pace::Lockstep { .. } => batches.is_multiple_of(BATCHES_BETWEEN_LOOKS) || naps > 0,
            Pace::RealTime => batches.is_multiple_of(BATCHES_BETWEEN_LOOKS_IN_REAL_TIME) || naps >= NAPS_BEFORE_LONG,
        }
    }

    fn send(&mut self, batch: &[Sample]) -> Result<(), LinkError> {
        for sample in batch {
            self.samples.send_copy(*sample).map_err(|e| {
                self.link.broken("sending a sample", format!("{e} (run {}, tick {})", sample.run, sample.tick))
            })?;
            self.flow.sent(sample);
        }
        self.shared.sent.fetch_add(batch.len() as u64, Ordering::Release);
        // A listener that does not read its wake-ups still gets its samples; it finds them when it looks.
        if let Err(error) = self.wake.notify() {
            tracing::debug!(%error, "wake-up of the subscribers");
        }
        Ok(())
    }

    fn look_for_loggers(&mut self) {
        self.link.logger_ids(&mut self.ids);
        self.flow.present(&self.ids);
        self.shared.loggers.store(self.flow.loggers(), Ordering::Release);
    }

    fn hear_progress(&mut self) -> Result<(), LinkError> {
        let broken = |e: &dyn std::fmt::Display| self.link.broken("reading the loggers' progress", e.to_string());
        while let Some(message) = self.progress.receive().map_err(|e| broken(&e))? {
            let Progress { version, run, next_sequence } = *message.payload();
            if version == SAMPLE_VERSION {
                self.flow.progress(message.origin().value(), run, next_sequence);
            }
        }
        self.shared.taken_by_all.store(self.flow.taken_by_all(), Ordering::Release);
        Ok(())
    }

    /// How many samples may be sent now.
    fn room(&mut self) -> usize {
        if self.pace == Pace::RealTime {
            return usize::MAX;
        }
        let room = self.flow.room(self.begin.elapsed());
        for logger in &room.given_up {
            tracing::warn!(
                logger = format!("{logger:x}"),
                "a lossless logger stands still; the run goes on without it"
            );
        }
        if room.held_for >= SUSPECT_AFTER && self.suspected.is_none_or(|at| at.elapsed() >= SUSPECT_AGAIN) {
            // A killed process leaves its ports behind until somebody removes them.
            self.link.node.try_cleanup_dead_nodes();
            self.look_for_loggers();
            self.suspected = Some(Instant::now());
        }
        usize::try_from(room.samples).unwrap_or(usize::MAX)
    }
}
