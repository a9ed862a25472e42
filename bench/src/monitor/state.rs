//! What was heard so far, reduced to what is shown. No clock and no transport in here: times are arguments.

use super::description::Description;
use super::happenings::{Happening, Happenings, ending, trip};
use super::history::History;
use super::timing::Timing;
use recordings::Severity;
use rt_core::Sample;
use std::time::{Duration, Instant};

/// A run that is silent for so long is no longer just between two samples. The publication hands on every 10 ms at most; a machine
/// under load may stall for some tenths.
const SILENCE: Duration = Duration::from_millis(500);

/// Where things stand.
#[derive(Clone, Debug, PartialEq)]
pub enum Phase {
    /// No sample has come since the monitor began.
    NoRunYet,
    /// Samples come.
    Running,
    /// Samples come; the run waits for the people at the rig.
    WaitsForPeople,
    /// Samples come; the supervisor has tripped, the command is the safe state.
    Tripped(String),
    /// The run's last sample has come: how it ended.
    Ended(Severity, String),
    /// The run has not ended, and no sample has come for so long.
    Silent(Duration),
    /// The run has not ended, no sample has come for so long, and nobody publishes any more.
    Gone(Duration),
}

impl Phase {
    /// One word for scripts.
    pub fn word(&self) -> &'static str {
        match self {
            Phase::NoRunYet => "no-run-yet",
            Phase::Running => "running",
            Phase::WaitsForPeople => "waits-for-people",
            Phase::Tripped(_) => "tripped",
            Phase::Ended(..) => "ended",
            Phase::Silent(_) => "silent",
            Phase::Gone(_) => "gone",
        }
    }
}

/// The run that is under way, or was last.
pub struct Followed {
    /// The newest sample.
    pub newest: Sample,
    /// Samples that came.
    pub received: u64,
    /// Samples between the first and the newest that did not come.
    pub missed: u64,
    /// When the newest came.
    pub heard: Instant,
    /// What the service says that it is.
    pub description: Option<Description>,
}

/// See the module.
pub struct State {
    /// Name of the instance.
    pub instance: String,
    /// The run.
    pub run: Option<Followed>,
    /// The last minute.
    pub history: History,
    /// Lateness and work.
    pub timing: Timing,
    /// What happened.
    pub happenings: Happenings,
    /// Nobody publishes, as was found when samples failed to come.
    published: bool,
}

impl State {
    /// Nothing was heard yet.
    pub fn new(instance: &str) -> State {
        State {
            instance: instance.to_owned(),
            run: None,
            history: History::default(),
            timing: Timing::default(),
            happenings: Happenings::default(),
            published: true,
        }
    }

    /// Takes samples in the order in which they came. Returns the number of a run that begins with them, whose description may be asked for.
    pub fn take(&mut self, samples: &[Sample], now: Instant) -> Option<u32> {
        let mut begun = None;
        for sample in samples {
            self.published = true;
            let continues = |run: &&mut Followed| {
                run.newest.run == sample.run && run.newest.sequence() < sample.sequence() && !run.newest.last()
            };
            match self.run.as_mut().filter(continues) {
                Some(run) => {
                    let missed = sample.sequence() - run.newest.sequence() - 1;
                    if missed > 0 {
                        run.missed += missed;
                        self.happenings.missed(sample, missed);
                    }
                    self.happenings.observe(&run.newest, sample);
                    run.received += 1;
                    (run.newest, run.heard) = (*sample, now);
                }
                None => {
                    self.history.clear();
                    self.timing = Timing::default();
                    self.happenings.begin(sample);
                    self.run =
                        Some(Followed { newest: *sample, received: 1, missed: 0, heard: now, description: None });
                    begun = Some(sample.run);
                }
            }
            self.history.push(sample);
            self.timing.push(sample);
        }
        begun
    }

    /// What the service says of the run that is followed.
    pub fn describe(&mut self, run: u32, description: Description) {
        if let Some(followed) = self.run.as_mut().filter(|followed| followed.newest.run == run) {
            followed.description = Some(description);
        }
    }

    /// Since when no sample comes although the run has not ended; `None`: they come, or there is nothing to wait for.
    pub fn silent(&self, now: Instant) -> Option<Duration> {
        let run = self.run.as_ref().filter(|run| !run.newest.last())?;
        Some(now.saturating_duration_since(run.heard)).filter(|silent| *silent >= SILENCE)
    }

    /// Whether anybody publishes, as found while samples failed to come.
    pub fn found_published(&mut self, published: bool) {
        if self.published && !published {
            self.happenings.say(Severity::Error, "the service is gone without ending its run");
        }
        self.published = published;
    }

    /// Where things stand.
    pub fn phase(&self, now: Instant) -> Phase {
        let Some(run) = &self.run else { return Phase::NoRunYet };
        let newest = &run.newest;
        if newest.last() {
            let (severity, how) = ending(newest);
            Phase::Ended(severity, how)
        } else if let Some(silent) = self.silent(now) {
            if self.published { Phase::Silent(silent) } else { Phase::Gone(silent) }
        } else if newest.tripped() {
            Phase::Tripped(trip(newest))
        } else if newest.waiting() {
            Phase::WaitsForPeople
        } else {
            Phase::Running
        }
    }

    /// The newest happenings, at most so many, the oldest of them first.
    pub fn latest(&self, count: usize) -> Vec<&Happening> {
        let all = self.happenings.iter();
        let skipped = all.len().saturating_sub(count);
        all.skip(skipped).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::{PERIOD_NS, flags};

    fn sample(run: u32, tick: u64, flags: u32) -> Sample {
        Sample { run, tick, scheduled_ns: tick * PERIOD_NS, flags, ..Sample::BLANK }
    }

    fn counted(state: &State) -> (u32, u64, u64) {
        let run = state.run.as_ref().expect("samples came");
        (run.newest.run, run.received, run.missed)
    }

    #[test]
    fn samples_that_did_not_come_are_counted_and_ticks_that_were_skipped_are_not() {
        let mut state = State::new("a");
        let now = Instant::now();
        let skipping = |tick: u64, skipped: u64| Sample { skipped, ..sample(3, tick, 0) };
        assert_eq!(state.take(&[sample(3, 100, 0), sample(3, 101, 0)], now), Some(3));
        assert_eq!(counted(&state), (3, 2, 0), "joined at sample 100: nothing is missing");
        assert_eq!(state.take(&[skipping(110, 8), skipping(115, 8)], now), None);
        assert_eq!(counted(&state), (3, 4, 4));
        assert_eq!(state.latest(1)[0].text, "4 samples were not received here");
    }

    #[test]
    fn another_run_begins_afresh_also_one_of_a_service_that_counts_anew() {
        let mut state = State::new("a");
        let now = Instant::now();
        state.take(&[sample(0, 0, 0), sample(0, 1, 0), sample(0, 2, flags::LAST)], now);
        assert_eq!(state.take(&[sample(1, 0, 0)], now), Some(1));
        assert_eq!(counted(&state), (1, 1, 0));
        state.take(&[sample(1, 1, 0), sample(1, 2, 0)], now);
        // Killed and started again, it numbers its runs anew.
        assert_eq!(state.take(&[sample(1, 0, 0)], now), Some(1));
        assert_eq!(counted(&state), (1, 1, 0));
    }

    #[test]
    fn phases_in_the_order_of_a_life() {
        let mut state = State::new("a");
        let begin = Instant::now();
        let after = |ms: u64| begin + Duration::from_millis(ms);
        assert_eq!(state.phase(begin), Phase::NoRunYet);
        state.take(&[sample(0, 0, 0)], begin);
        assert_eq!(state.phase(after(400)), Phase::Running);
        assert_eq!(state.phase(after(1_300)), Phase::Silent(Duration::from_millis(1_300)));
        state.found_published(false);
        assert_eq!(state.phase(after(2_000)), Phase::Gone(Duration::from_secs(2)));
        assert_eq!(state.latest(1)[0].text, "the service is gone without ending its run");
        state.take(&[sample(1, 0, flags::WAITING)], after(3_000));
        assert_eq!(state.phase(after(3_000)), Phase::WaitsForPeople);
        let tripped = Sample { trip: 9 | 6 << 8, ..sample(1, 1, flags::TRIPPED) };
        state.take(&[tripped], after(3_001));
        assert_eq!(state.phase(after(3_001)), Phase::Tripped("emergency stop demanded".to_owned()));
        state.take(&[Sample { tick: 2, flags: flags::TRIPPED | flags::LAST, ..tripped }], after(3_002));
        let ended = Phase::Ended(Severity::Error, "tripped, emergency stop demanded".to_owned());
        assert_eq!(state.phase(after(60_000)), ended, "who has ended is not silent");
    }
}
