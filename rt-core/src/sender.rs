//! The publication thread: takes samples out of the loop's queue, puts them into shared memory, wakes the subscribers, and in
//! virtual time holds back for its lossless loggers.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use ringbuf::HeapCons;
use ringbuf::traits::{Consumer, Observer};

use crate::flow::{Flow, LoggerId};
use crate::leftovers::watched;
use crate::link::{BUFFER_SAMPLES, Ipc, Link, LinkError, Progress};
use crate::publish::{NAP, Pace, Shared};
use crate::rhythm::Rhythm;
use crate::system::time::{monotonic_ns, sleep_until_ns};
use crate::types::{SAMPLE_VERSION, Sample};

/// Samples that are sent between two wake-ups of the subscribers.
const BATCH_SAMPLES: usize = 256;
/// Samples that may be under way to a lossless logger. The rest of its buffer is kept for what is sent before the
/// thread knows of a logger that has just joined.
const WINDOW_SAMPLES: u64 = (BUFFER_SAMPLES - 8 * BATCH_SAMPLES) as u64;
/// The thread looks for new loggers after this many batches, and whenever it is idle.
const BATCHES_BETWEEN_LOOKS: u32 = 4;
/// The same in real time, where a batch is one sample.
const BATCHES_BETWEEN_LOOKS_IN_REAL_TIME: u32 = 100;
/// Sleep of the thread when nothing has come for a while.
const LONG_NAP: Duration = Duration::from_millis(1);
/// Naps before the sleep gets longer.
const NAPS_BEFORE_LONG: u32 = 200;
/// A run that is held up for this long asks whether the logger's process is still alive.
const SUSPECT_AFTER: Duration = Duration::from_millis(50);
/// Between two such questions.
const SUSPECT_AGAIN: Duration = Duration::from_millis(100);

/// The publication thread's own things.
pub(crate) struct Sender {
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
    pub fn open(instance: &str, pace: Pace, shared: Arc<Shared>) -> Result<Self, LinkError> {
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
        Ok(Sender {
            samples,
            wake,
            progress,
            link,
            shared,
            pace,
            flow,
            begin,
            suspected: None,
            ids,
            rhythm: Rhythm::default(),
        })
    }

    /// Publishes until it is told to stop and the queue is empty.
    ///
    /// # Errors
    /// The transport fails.
    pub fn serve(&mut self, mut queue: HeapCons<Sample>) -> Result<(), LinkError> {
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
            watched(|| self.link.node.try_cleanup_dead_nodes());
            self.look_for_loggers();
            self.suspected = Some(Instant::now());
        }
        usize::try_from(room.samples).unwrap_or(usize::MAX)
    }
}
