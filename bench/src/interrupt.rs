//! Ctrl-C: while a loop drives a rig it is asked to stop, so that the outputs are zeroed; otherwise the process ends.

use crate::failure::{Failure, Kind};
use rt_core::Switches;
use rt_core::system::time::monotonic_ns;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

static SWITCHES: Switches = Switches::new();
static DRIVING: AtomicBool = AtomicBool::new(false);
/// When the first signal came, ms of the monotonic clock; 0 = none did.
static ASKED_MS: AtomicU64 = AtomicU64::new(0);
/// A second signal within this time says no more than the first.
const GRACE_MS: u64 = 1000;

/// From here on a loop drives a rig: the first Ctrl-C sets the flag that the loop looks at, a second one ends the
/// process at once. Returns the switches that hold it and a guard; when the guard is dropped, Ctrl-C ends the process again.
pub fn driving() -> Result<(&'static Switches, Driving), Failure> {
    static INSTALLED: AtomicBool = AtomicBool::new(false);
    if !INSTALLED.swap(true, Ordering::SeqCst) {
        ctrlc::set_handler(|| {
            let since_ms = monotonic_ns() / 1_000_000;
            let asked = SWITCHES.stop.swap(true, Ordering::SeqCst);
            let first_ms = match ASKED_MS.compare_exchange(0, since_ms, Ordering::SeqCst, Ordering::SeqCst) {
                Ok(_) => since_ms,
                Err(first_ms) => first_ms,
            };
            // `timeout` and some shells send a signal twice at once: that is one wish, not impatience.
            let again = asked && since_ms - first_ms >= GRACE_MS;
            if !DRIVING.load(Ordering::SeqCst) || again {
                crate::keyboard::restore();
                std::process::exit(Kind::Interrupted as i32);
            }
        })
        .map_err(|error| {
            Failure::new(
                Kind::Internal,
                format!("expected to catch Ctrl-C, so that the outputs are zeroed, got \"{error}\"; nothing was moved"),
            )
        })?;
    }
    // SAFETY: ignoring a signal installs no handler and touches no memory of ours. A write beyond a file-size limit then is an
    // error that the logger tells, instead of the end of a process whose outputs are not zeroed.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
    DRIVING.store(true, Ordering::SeqCst);
    Ok((&SWITCHES, Driving(())))
}

/// While it lives, Ctrl-C stops the loop instead of the process.
pub struct Driving(());

impl Drop for Driving {
    fn drop(&mut self) {
        DRIVING.store(false, Ordering::SeqCst);
    }
}
