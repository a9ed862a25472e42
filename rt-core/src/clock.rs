//! Where ticks come from. The loop asks the clock to wait for a tick and hands that tick on as an argument; no stage
//! reads a clock of its own. Real time, lockstep and replay differ in nothing but the clock and the device.

use crate::system::time::{monotonic_ns, sleep_until_ns};
use crate::types::Tick;

/// A tick that has begun, and how late the loop woke up for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wake {
    /// The tick that begins now.
    pub tick: Tick,
    /// `CLOCK_MONOTONIC` at the wake-up, ns; 0 in virtual time.
    pub woken_ns: u64,
    /// Wake-up later than scheduled by, ns; 0 in virtual time.
    pub lateness_ns: u64,
    /// The part of it that was gone already when the wait began, ns.
    pub behind_ns: u64,
}

/// The loop's source of time.
pub trait Clock {
    /// A run begins; its tick 0 is scheduled for now, or soon.
    fn start(&mut self);
    /// Returns when the tick with this index begins. Called with increasing indices.
    fn wait(&mut self, index: u64) -> Wake;
    /// Time since the run's start, ns. In virtual time stages take none: the scheduled time of the tick that was waited
    /// for last.
    fn now_ns(&mut self) -> u64;
    /// `CLOCK_MONOTONIC` at tick 0, ns; 0 in virtual time.
    fn origin_ns(&self) -> u64 {
        0
    }
}

/// Virtual time: a tick begins as soon as the loop asks for it. Deterministic, as fast as the stages are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lockstep {
    now_ns: u64,
}

impl Clock for Lockstep {
    fn start(&mut self) {
        self.now_ns = 0;
    }

    fn wait(&mut self, index: u64) -> Wake {
        let tick = Tick::at(index);
        self.now_ns = tick.scheduled_ns;
        Wake { tick, woken_ns: 0, lateness_ns: 0, behind_ns: 0 }
    }

    fn now_ns(&mut self) -> u64 {
        self.now_ns
    }
}

/// Lead before tick 0 of a run, ns: the first wait is a wait like any other.
const LEAD_NS: u64 = 2_000_000;

/// Real time: absolute waits on `CLOCK_MONOTONIC`. A late wake-up never shifts the ticks after it.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealTime {
    /// `CLOCK_MONOTONIC` at tick 0, ns.
    origin_ns: u64,
}

impl Clock for RealTime {
    fn start(&mut self) {
        self.origin_ns = monotonic_ns() + LEAD_NS;
    }

    fn wait(&mut self, index: u64) -> Wake {
        let tick = Tick::at(index);
        let due_ns = self.origin_ns + tick.scheduled_ns;
        let asked_ns = monotonic_ns();
        if asked_ns < due_ns {
            sleep_until_ns(due_ns);
        }
        let woken_ns = monotonic_ns();
        Wake {
            tick,
            woken_ns,
            lateness_ns: woken_ns.saturating_sub(due_ns),
            behind_ns: asked_ns.saturating_sub(due_ns),
        }
    }

    fn now_ns(&mut self) -> u64 {
        monotonic_ns().saturating_sub(self.origin_ns)
    }

    fn origin_ns(&self) -> u64 {
        self.origin_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::PERIOD_NS;

    #[test]
    fn lockstep_is_never_late_and_stages_take_no_time() {
        let mut clock = Lockstep::default();
        for _run in 0..2 {
            clock.start();
            for index in [0, 1, 2, 7] {
                let wake = clock.wait(index);
                assert_eq!(wake.tick, Tick { index, scheduled_ns: index * PERIOD_NS });
                assert_eq!((wake.lateness_ns, wake.woken_ns, clock.now_ns()), (0, 0, index * PERIOD_NS));
            }
        }
    }

    #[test]
    fn real_time_wakes_at_the_tick_or_after_it_and_says_by_how_much() {
        let mut clock = RealTime::default();
        clock.start();
        let origin_ns = clock.origin_ns();
        assert!(origin_ns > 0, "what a device gets to compare its own times with");
        for index in 0..20 {
            let wake = clock.wait(index);
            assert_eq!(wake.woken_ns, origin_ns + wake.tick.scheduled_ns + wake.lateness_ns, "never early");
            assert!(wake.behind_ns <= wake.lateness_ns);
            assert!(clock.now_ns() >= wake.tick.scheduled_ns);
        }
        // A tick that is long past is not waited for, and the delay is the loop's own.
        while clock.now_ns() < 40 * PERIOD_NS {
            std::hint::spin_loop();
        }
        let wake = clock.wait(21);
        assert!(wake.behind_ns >= 19 * PERIOD_NS && wake.behind_ns <= wake.lateness_ns, "{wake:?}");
    }
}
