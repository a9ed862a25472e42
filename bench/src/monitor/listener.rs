//! Samples and announcements from shared memory into the state. Best effort: the service does not know that it is watched.

use super::description::Description;
use super::state::State;
use recordings::RunMetadata;
use rt_core::announce::Announcements;
use rt_core::presence::is_published;
use rt_core::{Delivery, LinkError, Sample, SampleSubscriber};
use std::time::{Duration, Instant};

/// What is taken in one look at most: a run in virtual time may publish faster than anybody can look.
const LOOK_MAX: usize = 32 * rt_core::subscribe::DRAIN_MAX;
/// Between two questions whether anybody publishes at all, while samples fail to come.
const ASK: Duration = Duration::from_secs(1);
/// What a run is said to be comes a little after who joins it late.
const PATIENCE: Duration = Duration::from_secs(2);

/// See the module. Belongs to the thread that opened it.
pub struct Listener {
    announcements: Announcements,
    subscriber: SampleSubscriber,
    samples: Vec<Sample>,
    /// A run whose description is still awaited, and until when.
    nameless: Option<(u32, Instant)>,
    asked: Option<Instant>,
}

impl Listener {
    /// Listens to `instance`, whether anybody publishes there already or not.
    ///
    /// # Errors
    /// The instance's services can't be had.
    pub fn open(instance: &str) -> Result<Listener, LinkError> {
        let announcements = Announcements::open(instance)?;
        let subscriber = SampleSubscriber::open(instance, Delivery::BestEffort)?;
        let samples = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
        Ok(Listener { announcements, subscriber, samples, nameless: None, asked: None })
    }

    /// Brings the state up to now; waits a millisecond at most.
    ///
    /// # Errors
    /// The transport failed, or sends what is no run.
    pub fn look(&mut self, state: &mut State) -> Result<(), LinkError> {
        let mut taken = 0;
        while taken < LOOK_MAX {
            self.samples.clear();
            let count = self.subscriber.drain(&mut self.samples)?;
            if count == 0 {
                break;
            }
            taken += count;
            self.hand_on(state);
        }
        // Takes the wake-ups that have come, too, which would pile up otherwise. Once: at 1 kHz there is always another sample to wait for.
        self.samples.clear();
        self.subscriber.receive(Duration::ZERO, &mut self.samples)?;
        self.hand_on(state);
        self.announcements.hear()?;
        let now = Instant::now();
        if let Some((run, until)) = self.nameless {
            let announced = self.announcements.of_run(run, Duration::ZERO)?.map(RunMetadata::from_record);
            if let Some(Ok(metadata)) = &announced {
                state.describe(run, Description::of(metadata));
            }
            if announced.is_some() || now >= until {
                self.nameless = None;
            }
        }
        if state.silent(now).is_none() {
            self.asked = None;
        } else if self.asked.is_none_or(|asked| now.duration_since(asked) >= ASK) {
            self.asked = Some(now);
            state.found_published(is_published(&state.instance)?);
        }
        Ok(())
    }

    fn hand_on(&mut self, state: &mut State) {
        // The state counts for itself.
        while self.subscriber.take_certificate().is_some() {}
        let now = Instant::now();
        if let Some(run) = state.take(&self.samples, now) {
            self.nameless = Some((run, now + PATIENCE));
        }
    }
}
