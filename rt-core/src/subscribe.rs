//! The other end of the publication: samples in order, gaps by tick number, a loss certificate for each run.

use std::time::Duration;

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;

use crate::link::{BUFFER_SAMPLES, Ipc, Link, LinkError, Progress};
use crate::loss::{LossCertificate, LossTracker};
use crate::types::{SAMPLE_VERSION, Sample};

/// What a subscriber asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// It reports its progress; in virtual time the loop waits for it. For loggers.
    Lossless,
    /// It takes what it gets; the loop never waits for it. For monitors.
    BestEffort,
    /// The same, and nobody wakes it: it looks when it wants to, at least every few seconds. The cheapest for both ends.
    Polled,
}

/// Samples that one call of [`SampleSubscriber::drain`] takes at most; after each such call a lossless subscriber
/// reports its progress.
pub const DRAIN_MAX: usize = 1024;

/// The transport takes a wait of no length, which a socket's timeout of less than a microsecond is too, for one without end.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);

/// A subscription to the samples of an instance. Its ports belong to the thread that opened it.
#[derive(Debug)]
pub struct SampleSubscriber {
    // Dropped first: who no longer reports is no longer waited for.
    progress: Option<Publisher<Ipc, Progress, ()>>,
    wake: Option<Listener<Ipc>>,
    samples: Subscriber<Ipc, Sample, ()>,
    link: Link,
    tracker: LossTracker,
}

impl SampleSubscriber {
    /// Subscribes to `instance`; the publication may begin before or after. Samples that were published before are not
    /// delivered.
    pub fn open(instance: &str, delivery: Delivery) -> Result<Self, LinkError> {
        let link = Link::open(instance)?;
        let samples = link.sample.subscriber_builder().buffer_size(BUFFER_SAMPLES).create();
        let samples = samples.map_err(|e| link.failed("create the sample subscriber", e.to_string()))?;
        let wake = match delivery {
            Delivery::Polled => None,
            Delivery::Lossless | Delivery::BestEffort => {
                let port = link.wake.listener_builder().create();
                Some(port.map_err(|e| link.failed("create the listener", e.to_string()))?)
            }
        };
        // Created last: by this port the publication knows the logger, whose buffer must exist by then.
        let progress = match delivery {
            Delivery::BestEffort | Delivery::Polled => None,
            Delivery::Lossless => {
                let port = link.progress.publisher_builder().create();
                Some(port.map_err(|e| link.failed("create the progress publisher", e.to_string()))?)
            }
        };
        Ok(SampleSubscriber { progress, wake, samples, link, tracker: LossTracker::default() })
    }

    /// Appends what is there, at most [`DRAIN_MAX`] samples; does not wait. Returns how many.
    pub fn drain(&mut self, into: &mut Vec<Sample>) -> Result<usize, LinkError> {
        let mut newest = None;
        let mut count = 0;
        while count < DRAIN_MAX {
            let arrival = self.samples.receive().map_err(|e| self.link.broken("receiving a sample", e.to_string()))?;
            let Some(arrival) = arrival else { break };
            let sample = *arrival.payload();
            if sample.version != SAMPLE_VERSION {
                return Err(LinkError::Version { got: sample.version });
            }
            sample.in_range().map_err(|beyond| LinkError::BeyondRange { run: sample.run, beyond })?;
            self.tracker.received(arrival.origin().value(), &sample)?;
            into.push(sample);
            newest = Some((sample.run, sample.sequence()));
            count += 1;
        }
        if let (Some((run, sequence)), Some(progress)) = (newest, &self.progress) {
            let message = Progress { version: SAMPLE_VERSION, run, next_sequence: sequence + 1 };
            progress.send_copy(message).map_err(|e| self.link.broken("reporting progress", e.to_string()))?;
        }
        Ok(count)
    }

    /// Like [`drain`](Self::drain), but waits up to `timeout`, a millisecond at least, when nothing is there; one that is not woken waits
    /// that long.
    pub fn receive(&mut self, timeout: Duration, into: &mut Vec<Sample>) -> Result<usize, LinkError> {
        let count = self.drain(into)?;
        if count > 0 {
            return Ok(count);
        }
        let Some(wake) = &self.wake else {
            std::thread::sleep(timeout);
            return self.drain(into);
        };
        // Wake-ups are sent after their samples: one that comes between the look above and this wait ends it.
        match wake.timed_wait(|_| {}, timeout.max(SHORTEST_WAIT)) {
            // A signal that interrupts the wait only makes it shorter.
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(e) => return Err(self.link.broken("waiting for samples", e.to_string())),
        }
        self.drain(into)
    }

    /// The certificate of the oldest run that has ended and was not asked for yet. A run has ended when its last sample
    /// was drained, or when a sample of another run was.
    pub fn take_certificate(&mut self) -> Option<LossCertificate> {
        self.tracker.take()
    }

    /// Certifies `run` with the length that the loop's report tells, where its last sample did not arrive.
    pub fn close_run(&mut self, run: u32, expected: u64) {
        self.tracker.close(run, expected);
    }

    /// Certifies the run that is still open, its end unseen: the subscriber is about to go.
    pub fn abandon_run(&mut self) {
        self.tracker.abandon();
    }
}
