//! Which slices a measurement consists of. Loop, bare loop and cyclictest take turns, so that what else goes on in the
//! machine meets all of them alike.

use rt_core::PERIOD_NS;

/// Numbers of subscribers that the loop's slices go through.
pub const SUBSCRIBERS: [usize; 3] = [0, 1, 10];
/// Subscribers of one slice from which on one of them is stalled and another one killed.
pub const DISTURBED_FROM: usize = 10;
/// Shortest slice, ticks.
const LEAST_TICKS: u64 = 100;

/// What a slice measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The real loop, with this many subscribers in processes of their own.
    Loop {
        /// How many.
        subscribers: usize,
    },
    /// A loop of the same thread that does nothing but wait for the next period.
    Bare,
    /// The program of that name, which does the same.
    Cyclictest,
}

/// The slices in their order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// What each slice measures.
    pub slices: Vec<Kind>,
    /// Length of a slice, ticks of 1 ms.
    pub ticks: u64,
}

impl Plan {
    /// Slices of `slice_s` that take `seconds` (both above 0) in all, at least one of each kind: a short measurement has
    /// shorter slices. As many of the loop as of the others.
    pub fn new(seconds: f64, slice_s: f64, cyclictest: bool) -> Plan {
        let beside: &[Kind] = if cyclictest { &[Kind::Bare, Kind::Cyclictest] } else { &[Kind::Bare] };
        let kinds = 1 + beside.len();
        let slice_s = slice_s.min(seconds / (kinds * SUBSCRIBERS.len()) as f64);
        // The small surplus: 60 s are twelve slices of 5 s, whatever the last digit of the quotient.
        let rounds = (seconds / (slice_s * kinds as f64) + 1e-9) as usize;
        let slices = (0..rounds).flat_map(|round| {
            let subscribers = SUBSCRIBERS[round % SUBSCRIBERS.len()];
            std::iter::once(Kind::Loop { subscribers }).chain(beside.iter().copied())
        });
        let ticks = (slice_s * 1e9 / PERIOD_NS as f64).round() as u64;
        Plan { slices: slices.collect(), ticks: ticks.max(LEAST_TICKS) }
    }

    /// Length of a slice, s.
    pub fn slice_s(&self) -> f64 {
        (self.ticks * PERIOD_NS) as f64 * 1e-9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(plan: &Plan, kind: Kind) -> usize {
        plan.slices.iter().filter(|k| **k == kind).count()
    }

    #[test]
    fn a_minute_is_twelve_slices_that_alternate() {
        let plan = Plan::new(60.0, 5.0, false);
        assert_eq!((plan.slices.len(), plan.ticks, plan.slice_s()), (12, 5000, 5.0));
        assert!(plan.slices.chunks(2).all(|pair| matches!(pair, [Kind::Loop { .. }, Kind::Bare])));
        for subscribers in SUBSCRIBERS {
            assert_eq!(count(&plan, Kind::Loop { subscribers }), 2, "{subscribers} subscribers");
        }
    }

    #[test]
    fn a_short_measurement_has_every_kind_in_shorter_slices() {
        for (cyclictest, ticks) in [(false, 500), (true, 333)] {
            let plan = Plan::new(3.0, 5.0, cyclictest);
            assert_eq!((plan.slices.len(), plan.ticks), (if cyclictest { 9 } else { 6 }, ticks));
            for subscribers in SUBSCRIBERS {
                assert_eq!(count(&plan, Kind::Loop { subscribers }), 1);
            }
            assert_eq!((count(&plan, Kind::Bare), count(&plan, Kind::Cyclictest)), (3, if cyclictest { 3 } else { 0 }));
        }
        assert_eq!(Plan::new(1e-3, 5.0, false).ticks, LEAST_TICKS);
    }

    #[test]
    fn the_kinds_have_equally_many_slices_and_stay_within_the_time() {
        for seconds in [7.0, 31.5, 100.0, 600.0] {
            for slice_s in [0.7, 1.0, 5.0] {
                let plan = Plan::new(seconds, slice_s, true);
                let loops = plan.slices.iter().filter(|k| matches!(k, Kind::Loop { .. })).count();
                assert_eq!((loops, loops), (count(&plan, Kind::Bare), count(&plan, Kind::Cyclictest)));
                let all_s = plan.slices.len() as f64 * plan.slice_s();
                assert!(all_s <= seconds * 1.001 && all_s > seconds - 3.0 * slice_s, "{all_s} of {seconds} s");
            }
        }
    }
}
