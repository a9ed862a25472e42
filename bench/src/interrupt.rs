//! Ctrl-C: while a loop drives a rig it is asked to stop, so that the outputs are zeroed; otherwise the process ends. What would halt the
//! process, or end it at once, must not do so meanwhile: the outputs would stand as they are.

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

/// Ctrl-Z, and what a terminal sends to a process in its background that reads from it or sets it.
const HALTING: [libc::c_int; 3] = [libc::SIGTSTP, libc::SIGTTIN, libc::SIGTTOU];

/// From here on a loop drives a rig: the first Ctrl-C sets the flag that the loop looks at, a second one ends the
/// process at once; Ctrl-\ is the same, Ctrl-Z does nothing. Returns the switches that hold it and a guard; when the guard is dropped, each
/// does again what it did before, and Ctrl-C ends the process.
pub fn driving() -> Result<(&'static Switches, Driving), Failure> {
    static INSTALLED: AtomicBool = AtomicBool::new(false);
    if !INSTALLED.swap(true, Ordering::SeqCst) {
        ctrlc::set_handler(|| {
            // Asked before the loop is: it may be over as soon as it is told.
            let driving = DRIVING.load(Ordering::SeqCst);
            let since_ms = monotonic_ns() / 1_000_000;
            let asked = SWITCHES.stop.swap(true, Ordering::SeqCst);
            let first_ms = match ASKED_MS.compare_exchange(0, since_ms, Ordering::SeqCst, Ordering::SeqCst) {
                Ok(_) => since_ms,
                Err(first_ms) => first_ms,
            };
            // `timeout` and some shells send a signal twice at once: that is one wish, not impatience.
            let again = asked && since_ms - first_ms >= GRACE_MS;
            if !driving || again {
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
    let changed =
        HALTING.map(|signal| (signal, Action::Ignore)).into_iter().chain([(libc::SIGQUIT, Action::Interrupt)]);
    let before = changed.filter_map(|(signal, action)| Some((signal, set(signal, action)?))).collect();
    Ok((&SWITCHES, Driving { before }))
}

/// While it lives, Ctrl-C stops the loop instead of the process, and nothing halts it.
pub struct Driving {
    /// What the other signals did.
    before: Vec<(libc::c_int, libc::sigaction)>,
}

impl Drop for Driving {
    fn drop(&mut self) {
        for (signal, before) in &self.before {
            // SAFETY: what the system gave for this signal is given back to it.
            unsafe { libc::sigaction(*signal, before, std::ptr::null_mut()) };
        }
        DRIVING.store(false, Ordering::SeqCst);
    }
}

enum Action {
    Ignore,
    /// The same as Ctrl-C.
    Interrupt,
}

/// What the signal did before; `None`: the system does not let it be changed.
fn set(signal: libc::c_int, action: Action) -> Option<libc::sigaction> {
    // SAFETY: zeroes are a valid `sigaction`: no flags, an empty mask. The handler is one that may be called at any time.
    unsafe {
        let (mut after, mut before): (libc::sigaction, libc::sigaction) = (std::mem::zeroed(), std::mem::zeroed());
        after.sa_flags = libc::SA_RESTART;
        after.sa_sigaction = match action {
            Action::Ignore => libc::SIG_IGN,
            Action::Interrupt => as_interrupt as *const () as libc::sighandler_t,
        };
        (libc::sigaction(signal, &raw const after, &raw mut before) == 0).then_some(before)
    }
}

extern "C" fn as_interrupt(_: libc::c_int) {
    // SAFETY: both calls are among those that a signal handler may make.
    unsafe { libc::kill(libc::getpid(), libc::SIGINT) };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn action(signal: libc::c_int) -> libc::sighandler_t {
        // SAFETY: only asks; zeroes are a valid `sigaction`.
        unsafe {
            let mut now: libc::sigaction = std::mem::zeroed();
            assert_eq!(libc::sigaction(signal, std::ptr::null(), &raw mut now), 0);
            now.sa_sigaction
        }
    }

    #[test]
    fn while_a_rig_is_driven_nothing_halts_the_process_and_quit_is_a_stop() {
        let all = || [libc::SIGTSTP, libc::SIGTTIN, libc::SIGTTOU, libc::SIGQUIT].map(action);
        let before = all();
        let (switches, driving) = driving().expect("nobody else has the handler");
        assert_eq!(all()[..3], [libc::SIG_IGN; 3]);
        // SAFETY: a signal to this process, which has a handler for it.
        assert_eq!(unsafe { libc::raise(libc::SIGQUIT) }, 0);
        while !switches.stop.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        switches.stop.store(false, Ordering::SeqCst);
        drop(driving);
        assert_eq!(all(), before);
    }
}
