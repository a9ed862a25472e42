//! Where ticks come from. The loop asks the clock for its next tick and hands that tick on as an argument; no stage
//! reads a clock of its own. Real time, lockstep and replay differ in nothing but the clock and the device.

use crate::types::Tick;

/// A tick that has begun, and how late the loop woke up for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wake {
    /// The tick that begins now.
    pub tick: Tick,
    /// Wake-up later than scheduled by, ns; 0 in virtual time.
    pub lateness_ns: u64,
}

/// The loop's source of time.
pub trait Clock {
    /// A run begins: tick 0 is the next one.
    fn start(&mut self);
    /// Returns when the next tick begins.
    fn next(&mut self) -> Wake;
}

/// Virtual time: the next tick begins as soon as the loop asks for it. Deterministic, as fast as the stages are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lockstep {
    next_index: u64,
}

impl Clock for Lockstep {
    fn start(&mut self) {
        self.next_index = 0;
    }

    fn next(&mut self) -> Wake {
        let tick = Tick::at(self.next_index);
        self.next_index += 1;
        Wake { tick, lateness_ns: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::PERIOD_NS;

    #[test]
    fn lockstep_counts_from_zero_in_each_run_and_is_never_late() {
        let mut clock = Lockstep::default();
        for _run in 0..2 {
            clock.start();
            for index in 0..5 {
                let wake = clock.next();
                assert_eq!(wake.tick, Tick { index, scheduled_ns: index * PERIOD_NS });
                assert_eq!(wake.lateness_ns, 0);
            }
        }
    }
}
