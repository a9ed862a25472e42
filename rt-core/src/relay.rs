//! Samples of a loop on another machine, put into this machine's shared memory by a program that carries them across: who subscribes
//! here finds them as if the loop were here.

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;

use crate::link::{Ipc, Link, LinkError};
use crate::types::Sample;

/// The publication of an instance whose loop is elsewhere. It belongs to the thread that opened it. Dropped, nobody publishes under
/// the instance's name any more, which its subscribers can see.
#[derive(Debug)]
pub struct Relay {
    samples: Publisher<Ipc, Sample, ()>,
    wake: Notifier<Ipc>,
    link: Link,
}

impl Relay {
    /// Takes the instance's name.
    ///
    /// # Errors
    /// A loop or another relay publishes under it; a name that is none; no shared memory.
    pub fn open(instance: &str) -> Result<Relay, LinkError> {
        let link = Link::open(instance)?;
        let samples = link.loop_publisher()?;
        let wake = link.wake.notifier_builder().create();
        let wake = wake.map_err(|e| link.failed("create the notifier", e.to_string()))?;
        Ok(Relay { samples, wake, link })
    }

    /// Publishes samples as they are. A subscriber that does not keep up loses its oldest ones; nobody is waited for.
    ///
    /// # Errors
    /// The transport fails.
    pub fn send(&self, samples: &[Sample]) -> Result<(), LinkError> {
        for sample in samples {
            self.samples.send_copy(*sample).map_err(|e| {
                self.link.broken("sending a sample", format!("{e} (run {}, tick {})", sample.run, sample.tick))
            })?;
        }
        // A listener that misses a wake-up finds its samples when it looks.
        if let Err(error) = self.wake.notify() {
            tracing::debug!(%error, "wake-up of the subscribers");
        }
        Ok(())
    }
}
