//! When the publication thread looks for the next sample of a run in real time. The loop makes no system call to wake it, so it
//! wakes by itself: shortly after the loop does, and again in small steps until the sample is there.

use crate::types::{PERIOD_NS, Sample};

/// The loop's own part of a period is over by then on most ticks, ns.
const AFTER_TICK_NS: u64 = 12_000;
/// Between two looks, ns.
const STEP_NS: u64 = 20_000;
/// A run that has been silent for so many periods is over, or in trouble.
const SILENT_PERIODS: u64 = 50;

/// Follows the schedule of the run whose samples are heard.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Rhythm {
    /// When the newest sample's tick should have begun, `CLOCK_MONOTONIC` ns; `None` in virtual time and after a run.
    newest_due_ns: Option<u64>,
}

impl Rhythm {
    /// This sample is the newest.
    pub fn heard(&mut self, sample: &Sample) {
        let due_ns = sample.woken_ns.saturating_sub(sample.lateness_ns);
        self.newest_due_ns = (due_ns > 0 && !sample.last()).then_some(due_ns);
    }

    /// When to look again (absolute, `CLOCK_MONOTONIC` ns), nothing being there at `now_ns`; `None`: no run goes on.
    pub fn next_look_ns(&self, now_ns: u64) -> Option<u64> {
        let due_ns = self.newest_due_ns?;
        if now_ns > due_ns + SILENT_PERIODS * PERIOD_NS {
            return None;
        }
        let next_ns = due_ns + PERIOD_NS + AFTER_TICK_NS;
        if now_ns < next_ns {
            return Some(next_ns);
        }
        // Half a period of small steps, then the period after: a skipped tick comes with the next one.
        let beyond_ns = (now_ns - next_ns) % PERIOD_NS;
        Some(if beyond_ns < PERIOD_NS / 2 { now_ns + STEP_NS } else { now_ns + PERIOD_NS - beyond_ns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::flags;

    #[test]
    fn it_looks_after_the_next_tick_then_often_then_once_a_period_and_gives_up() {
        let mut rhythm = Rhythm::default();
        assert_eq!(rhythm.next_look_ns(5), None, "no run yet");
        let sample = Sample { woken_ns: 10_040_000, lateness_ns: 40_000, ..Sample::BLANK };
        rhythm.heard(&sample);
        assert_eq!(rhythm.next_look_ns(10_100_000), Some(11_012_000));
        assert_eq!(rhythm.next_look_ns(11_013_000), Some(11_033_000));
        assert_eq!(rhythm.next_look_ns(11_600_000), Some(12_012_000));
        assert_eq!(rhythm.next_look_ns(61_000_000), None);
        rhythm.heard(&Sample { flags: flags::LAST, ..sample });
        assert_eq!(rhythm.next_look_ns(10_100_000), None, "the run is over");
        rhythm.heard(&Sample::BLANK);
        assert_eq!(rhythm.next_look_ns(1), None, "virtual time has no schedule");
    }

    #[test]
    fn every_look_lies_ahead_and_it_never_spins() {
        let mut rhythm = Rhythm::default();
        rhythm.heard(&Sample { woken_ns: 5_000_000_000, lateness_ns: 0, ..Sample::BLANK });
        let (mut now_ns, mut looks) = (5_000_000_000, 0);
        while let Some(look_ns) = rhythm.next_look_ns(now_ns) {
            assert!(look_ns >= now_ns + 12_000, "{now_ns} -> {look_ns}");
            assert!(look_ns <= now_ns + PERIOD_NS + AFTER_TICK_NS, "{now_ns} -> {look_ns}");
            now_ns = look_ns;
            looks += 1;
        }
        let after_ns = now_ns - 5_000_000_000;
        assert!((50 * PERIOD_NS..52 * PERIOD_NS).contains(&after_ns), "given up after {after_ns} ns");
        assert!(looks < 50 * 30, "{looks} looks for a loop that is gone");
    }

    #[test]
    fn a_sample_that_comes_late_does_not_shift_the_schedule() {
        let mut rhythm = Rhythm::default();
        for late_ns in [0, 300_000, 2_700_000] {
            rhythm.heard(&Sample { woken_ns: 10_000_000 + late_ns, lateness_ns: late_ns, ..Sample::BLANK });
            assert_eq!(rhythm.next_look_ns(10_100_000), Some(11_012_000));
        }
    }
}
