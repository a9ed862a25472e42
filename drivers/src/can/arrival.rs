//! When a frame came: the kernel's receive time, which is of the wall clock, on the loop's clock.
//!
//! Both clocks are read at each reception, so neither a clock that is being slewed nor one that was set hours ago matters. What
//! remains is the time between the two readings (some 0.1 us) and a wall clock that is set between a frame's arrival and its
//! reception: a step is seen as a jump of the clocks' difference, and a frame can't have come before the socket was last found empty.
//! Where a time contradicts either, that of the reception is taken: late by as long as the thread took to wake.

use rustix::time::{ClockId, clock_gettime};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::time::{SystemTime, UNIX_EPOCH};

/// Frames are stamped a moment before they are in the socket: a softirq, on another processor at times.
const BEFORE_QUEUED_NS: i64 = 1_000_000;
/// The clocks' difference may change by so much between two readings, plus a tenth of the time between: faster than clocks are slewed.
const JUMP_NS: i64 = 100_000;
/// Readings of which the one that was interrupted least is taken.
const TRIES: usize = 3;
/// Two readings of the loop's clock with one of the wall clock between them that are closer than this are good enough, ns.
const UNDISTURBED_NS: u64 = 1_000;

/// `CLOCK_MONOTONIC`, ns.
pub(super) fn monotonic_ns() -> u64 {
    read_ns(ClockId::Monotonic)
}

fn read_ns(clock: ClockId) -> u64 {
    let now = clock_gettime(clock);
    // Neither clock is before its origin.
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Both clocks at one moment, ns.
#[derive(Clone, Copy, Debug)]
struct Reading {
    monotonic_ns: u64,
    realtime_ns: u64,
}

impl Reading {
    fn now() -> Reading {
        let mut best = (u64::MAX, Reading { monotonic_ns: 0, realtime_ns: 0 });
        for _ in 0..TRIES {
            let before = monotonic_ns();
            let realtime_ns = read_ns(ClockId::Realtime);
            let span = monotonic_ns() - before;
            if span < best.0 {
                best = (span, Reading { monotonic_ns: before + span / 2, realtime_ns });
            }
            if span < UNDISTURBED_NS {
                break;
            }
        }
        best.1
    }

    fn offset_ns(self) -> i64 {
        self.realtime_ns as i64 - self.monotonic_ns as i64
    }
}

/// Turns the kernel's times of one socket into the loop's.
#[derive(Debug, Default)]
pub(super) struct Arrivals {
    /// When the socket was last found empty, `CLOCK_MONOTONIC`.
    empty_ns: AtomicU64,
    /// Wall clock - loop's clock at the last reading; 0 before the first.
    offset_ns: AtomicI64,
    read_ns: AtomicU64,
}

impl Arrivals {
    /// The socket had nothing at `before_ns`, `CLOCK_MONOTONIC`.
    pub(super) fn found_empty(&self, before_ns: u64) {
        self.empty_ns.store(before_ns, Relaxed);
    }

    /// When a frame that was received just now came, `CLOCK_MONOTONIC`, ns.
    pub(super) fn of(&self, kernel: Option<SystemTime>) -> u64 {
        let since_epoch = kernel.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let Some(stamp_ns) = since_epoch.and_then(|time| u64::try_from(time.as_nanos()).ok()) else {
            return monotonic_ns();
        };
        self.at(stamp_ns, Reading::now())
    }

    fn at(&self, stamp_ns: u64, now: Reading) -> u64 {
        let offset_ns = now.offset_ns();
        let before_ns = self.offset_ns.swap(offset_ns, Relaxed);
        let elapsed_ns = now.monotonic_ns.saturating_sub(self.read_ns.swap(now.monotonic_ns, Relaxed));
        let jumped = before_ns != 0 && (offset_ns - before_ns).abs() > JUMP_NS + (elapsed_ns / 10) as i64;
        let came_ns = stamp_ns as i64 - offset_ns;
        let earliest_ns = self.empty_ns.load(Relaxed) as i64 - BEFORE_QUEUED_NS;
        let plausible = (earliest_ns..=now.monotonic_ns as i64 + JUMP_NS).contains(&came_ns);
        if jumped || !plausible {
            return now.monotonic_ns;
        }
        // Not negative: it is at most 1 ms before a reading of a clock that has run since the machine was started, and never ahead of now.
        now.monotonic_ns.min(came_ns.max(0) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;
    const EPOCH: u64 = 1_700_000_000 * 1_000 * MS;

    fn reading(monotonic_ns: u64, offset_ns: u64) -> Reading {
        Reading { monotonic_ns, realtime_ns: monotonic_ns + offset_ns }
    }

    proptest! {
        #[test]
        fn a_clock_that_is_slewed_by_a_tenth_changes_nothing(waited in prop::collection::vec((0..20 * MS, 0..2 * MS), 1..50)) {
            let arrivals = Arrivals::default();
            let (mut now, mut offset) = (5_000 * MS, EPOCH);
            for (pause, age) in waited {
                now += pause + age;
                offset += (pause + age) / 11;
                let came = now - age;
                arrivals.found_empty(came - pause.min(came));
                prop_assert_eq!(arrivals.at(came + offset, reading(now, offset)), came);
            }
        }

        #[test]
        fn no_step_of_the_wall_clock_gives_a_time_outside_of_the_wait(step in -10_000_000 * MS as i64..10_000_000 * MS as i64, age in 0..MS) {
            let arrivals = Arrivals::default();
            let (empty, now) = (5_000 * MS, 5_001 * MS);
            arrivals.found_empty(empty);
            prop_assert_eq!(arrivals.at(empty + EPOCH, reading(empty, EPOCH)), empty);
            // Stamped before the clock was set, received after it.
            let stepped = EPOCH.checked_add_signed(step).expect("after the epoch");
            let came = arrivals.at(now - age + EPOCH, reading(now, stepped));
            let true_ns = now - age;
            prop_assert!(came <= now && came >= empty - 1_000_000, "{} for {}", came, true_ns);
            if step.unsigned_abs() > 210_000 {
                prop_assert_eq!(came, now, "a step is no age");
            }
            // The next one is right again.
            let (empty, now) = (now, now + MS);
            arrivals.found_empty(empty);
            prop_assert_eq!(arrivals.at(now - age + stepped, reading(now, stepped)), now - age);
        }
    }

    #[test]
    fn a_time_of_the_future_or_of_before_the_socket_was_empty_is_not_taken() {
        let arrivals = Arrivals::default();
        arrivals.found_empty(5_000 * MS);
        let now = reading(5_003 * MS, EPOCH);
        let at = |came: u64| arrivals.at(came + EPOCH, now);
        assert_eq!(at(5_001 * MS), 5_001 * MS);
        assert_eq!(at(5_004 * MS), 5_003 * MS);
        assert_eq!(at(4_000 * MS), 5_003 * MS);
        assert_eq!(at(5_003 * MS + 10), 5_003 * MS);
    }

    #[test]
    fn without_a_time_of_the_kernel_it_is_now() {
        let (before, came) = (monotonic_ns(), Arrivals::default().of(None));
        assert!((before..=monotonic_ns()).contains(&came));
        let came = Arrivals::default().of(Some(SystemTime::now()));
        assert!(came <= monotonic_ns());
    }
}
