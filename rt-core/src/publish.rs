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

use ringbuf::traits::{Producer, Split};
use ringbuf::{HeapProd, HeapRb};

use crate::link::LinkError;
use crate::sender::Sender;
use crate::types::Sample;

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
/// Sleep of a side that waits for the other.
pub(crate) const NAP: Duration = Duration::from_micros(100);
/// How long the last sample of a real-time run waits for room in the queue.
const PATIENCE_AFTER_RUN: Duration = Duration::from_secs(2);

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
pub(crate) struct Shared {
    /// Publish what was handed over, then end.
    pub stop: AtomicBool,
    /// The thread has ended, for whatever reason.
    pub ended: AtomicBool,
    /// Samples that were published.
    pub sent: AtomicU64,
    /// As many of them as every lossless logger that is waited for has taken.
    pub taken_by_all: AtomicU64,
    /// Lossless loggers that are there.
    pub loggers: AtomicUsize,
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

#[cfg(test)]
mod tests {
    use super::*;
    use ringbuf::HeapCons;

    /// A publication whose thread does nothing but to hold the other end of the queue, until it is told to panic.
    fn doomed(pace: Pace) -> (Publication, HeapCons<Sample>, mpsc::Sender<()>) {
        let (queue, from_loop) = HeapRb::new(8).split();
        let shared = Arc::new(Shared::default());
        let (die, death) = mpsc::channel();
        let ended = SetOnDrop(Arc::clone(&shared));
        let thread = thread::spawn(move || {
            let _ended = ended;
            let _ = death.recv();
            panic!("as a test wants it");
        });
        (Publication { queue, shared, thread: Some(thread), pace, handed: 0 }, from_loop, die)
    }

    fn kill(publication: &Publication, die: mpsc::Sender<()>) {
        drop(die);
        while !publication.shared.ended.load(Ordering::Acquire) {
            thread::sleep(NAP);
        }
    }

    #[test]
    fn a_publication_that_died_takes_nothing_any_more_although_its_queue_has_room() {
        for pace in [Pace::RealTime, Pace::LOCKSTEP] {
            let (mut publication, _queue, die) = doomed(pace);
            assert_eq!(publication.publish(&Sample::BLANK), Handover::Taken);
            kill(&publication, die);
            assert_eq!(publication.publish(&Sample::BLANK), Handover::Lost);
            assert_eq!(publication.publish_patiently(&Sample::BLANK), Handover::Lost, "nobody to be patient with");
            assert_eq!(publication.settle(Duration::from_secs(30)), Err(LinkError::Ended), "what it took is not out");
            assert_eq!(publication.stop(), Err(LinkError::Ended));
        }
    }

    #[test]
    fn in_real_time_a_full_queue_loses_the_new_sample_and_waits_for_nobody() {
        let (mut publication, queue, die) = doomed(Pace::RealTime);
        let handed: Vec<_> = (0..12).map(|tick| publication.publish(&Sample { tick, ..Sample::BLANK })).collect();
        assert_eq!(handed, [[Handover::Taken; 8].as_slice(), &[Handover::Lost; 4]].concat());
        let mut queue = queue;
        let kept: Vec<u64> = ringbuf::traits::Consumer::pop_iter(&mut queue).map(|s| s.tick).collect();
        assert_eq!((kept, publication.handed), ((0..8).collect(), 8));
        assert_eq!(publication.publish(&Sample::BLANK), Handover::Taken, "there is room again");
        kill(&publication, die);
    }

    #[test]
    fn in_lockstep_a_loop_that_waits_for_room_is_released_when_the_thread_dies() {
        let (mut publication, _queue, die) = doomed(Pace::LOCKSTEP);
        for _ in 0..8 {
            assert_eq!(publication.publish(&Sample::BLANK), Handover::Taken);
        }
        let waiting = thread::spawn(move || (publication.publish(&Sample::BLANK), publication));
        drop(die);
        let (handover, publication) = waiting.join().unwrap();
        assert_eq!(handover, Handover::Lost);
        assert_eq!(publication.stop(), Err(LinkError::Ended));
    }
}
