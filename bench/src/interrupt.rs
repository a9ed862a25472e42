//! Ctrl-C: while a loop drives a rig it is asked to stop, so that the outputs are zeroed; otherwise the process ends.

use crate::failure::{Failure, Kind};
use rt_core::Switches;
use std::sync::atomic::{AtomicBool, Ordering};

static SWITCHES: Switches = Switches::new();
static DRIVING: AtomicBool = AtomicBool::new(false);

/// From here on a loop drives a rig: the first Ctrl-C sets the flag that the loop looks at, a second one ends the process
/// at once. Returns the switches that hold it and a guard; when the guard is dropped, Ctrl-C ends the process again.
pub fn driving() -> Result<(&'static Switches, Driving), Failure> {
    static INSTALLED: AtomicBool = AtomicBool::new(false);
    if !INSTALLED.swap(true, Ordering::SeqCst) {
        ctrlc::set_handler(|| {
            if !DRIVING.load(Ordering::SeqCst) || SWITCHES.stop.swap(true, Ordering::SeqCst) {
                crate::keyboard::restore();
                std::process::exit(Kind::Interrupted as i32);
            }
        })
        .map_err(|error| Failure::new(Kind::Internal, format!("Ctrl-C could not be caught: {error}")))?;
    }
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
