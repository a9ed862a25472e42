//! `CLOCK_MONOTONIC`: reading it, and waiting for an instant of it. No allocation, no lock; reading is no system call
//! where the kernel's vDSO serves the clock source (`bench doctor` says so).

use rustix::io::Errno;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};
use std::time::Duration;

const NS_PER_S: u64 = 1_000_000_000;

/// `CLOCK_MONOTONIC`, ns since an arbitrary instant (the boot). Never goes back.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    // Neither is negative: the clock counts from the boot, and the kernel keeps tv_nsec in 0..1e9.
    now.tv_sec as u64 * NS_PER_S + now.tv_nsec as u64
}

/// Returns when [`monotonic_ns`] has reached `deadline_ns`, never before; at once when it has already.
///
/// The wait is absolute, so that neither a signal nor a preemption before the call shifts it.
pub fn sleep_until_ns(deadline_ns: u64) {
    let deadline =
        Timespec { tv_sec: (deadline_ns / NS_PER_S) as i64, tv_nsec: (deadline_ns % NS_PER_S) as rustix::time::Nsecs };
    loop {
        match clock_nanosleep_absolute(ClockId::Monotonic, &deadline) {
            Ok(()) => return,
            Err(Errno::INTR) => {}
            // The request is valid by construction, so only a system call filter gets here. The promise is kept all the same.
            Err(_) => return park_until_ns(deadline_ns),
        }
    }
}

#[cold]
fn park_until_ns(deadline_ns: u64) {
    loop {
        match deadline_ns.saturating_sub(monotonic_ns()) {
            0 => return,
            left_ns => std::thread::park_timeout(Duration::from_nanos(left_ns)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wait_ends_at_its_instant_or_later() {
        for ahead_ns in [0, 1, 999, 1_000_000, 3_500_000] {
            let deadline_ns = monotonic_ns() + ahead_ns;
            sleep_until_ns(deadline_ns);
            assert!(monotonic_ns() >= deadline_ns);
        }
    }

    #[test]
    fn the_way_around_a_refused_call_keeps_the_promise_too() {
        let deadline_ns = monotonic_ns() + 2_000_000;
        std::thread::current().unpark(); // a token that ends the first park at once
        park_until_ns(deadline_ns);
        assert!(monotonic_ns() >= deadline_ns);
    }

    #[test]
    fn an_instant_that_is_past_is_not_waited_for() {
        sleep_until_ns(0);
        sleep_until_ns(monotonic_ns() - 1);
    }

    /// Two clocks that must agree: std's `Instant` is `CLOCK_MONOTONIC` on Linux.
    #[test]
    fn the_unit_is_the_nanosecond() {
        let (before, instant) = (monotonic_ns(), std::time::Instant::now());
        std::thread::sleep(Duration::from_millis(20));
        let (elapsed, after) = (instant.elapsed(), monotonic_ns());
        assert!(u128::from(after - before) >= elapsed.as_nanos());
        assert!(after - before >= 20_000_000);
    }
}
