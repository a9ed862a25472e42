//! What is done beside a work, until that is over.

use std::sync::atomic::{AtomicBool, Ordering};

/// Says that it is over when it is dropped: by a panic of the work, too. The threads beside it are waited for before that is told, and would
/// go on for ever.
pub struct OverAtEnd<'a>(pub &'a AtomicBool);

impl Drop for OverAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::thread;
    use std::time::Duration;

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
}
