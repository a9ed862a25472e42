//! What is done beside a work, until that is over.

use rt_core::LinkError;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Between two attempts to have a port, where the transport failed.
const AGAIN: Duration = Duration::from_secs(1);
/// Between two looks whether it is over.
const LOOK: Duration = Duration::from_millis(50);

/// Says that it is over when it is dropped: by a panic of the work, too. The threads beside it are waited for before that is told, and would
/// go on for ever.
pub struct OverAtEnd<'a>(pub &'a AtomicBool);

impl Drop for OverAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Opens a port and serves it until it is over. Where either fails it is opened anew a second later; `say` hears of a failure once, however
/// often it comes in a row. The port belongs to this thread.
pub fn keep_open<P>(
    over: &AtomicBool,
    mut open: impl FnMut() -> Result<P, LinkError>,
    mut serve: impl FnMut(&mut P) -> Result<(), LinkError>,
    mut say: impl FnMut(&LinkError),
) {
    let mut trouble = None;
    while !over.load(Ordering::Relaxed) {
        let served = open().and_then(|mut port| {
            while !over.load(Ordering::Relaxed) {
                serve(&mut port)?;
                trouble = None;
            }
            Ok(())
        });
        if let Err(error) = served {
            if trouble.as_ref() != Some(&error) {
                say(&error);
                trouble = Some(error);
            }
            let failed = Instant::now();
            while failed.elapsed() < AGAIN && !over.load(Ordering::Relaxed) {
                thread::sleep(LOOK);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    #[test]
    fn a_panic_of_the_work_ends_what_is_done_beside_it() {
        let over = AtomicBool::new(false);
        let work = || {
            thread::scope(|scope| {
                scope.spawn(|| {
                    while !over.load(Ordering::Relaxed) {
                        thread::sleep(Duration::from_millis(1));
                    }
                });
                let _over = OverAtEnd(&over);
                panic!("a defect");
            });
        };
        assert!(catch_unwind(AssertUnwindSafe(work)).is_err(), "it comes back, and says so");
    }

    #[test]
    fn a_port_that_fails_is_opened_anew_and_its_failure_is_said_once_in_a_row() {
        let over = AtomicBool::new(false);
        let (mut opened, mut told) = (0, 0);
        let open = || {
            opened += 1;
            // The second attempt fails as the first port did.
            if opened == 2 { Err(LinkError::Ended) } else { Ok(opened) }
        };
        let serve = |port: &mut i32| match port {
            1 => Err(LinkError::Ended),
            _ => {
                over.store(true, Ordering::Relaxed);
                Ok(())
            }
        };
        keep_open(&over, open, serve, |_| told += 1);
        assert_eq!((opened, told), (3, 1));
    }
}
