//! Work that takes a thread for a while.

use tokio::task::{JoinError, JoinHandle, spawn_blocking};

/// Does it in one of the few threads that may wait, for as long as somebody waits for the outcome: what nobody waits for any more before
/// it began is not begun. A confirmation that is given up while it queues would otherwise confirm whatever is asked for by then.
///
/// # Errors
/// It panicked, or the service ends.
pub async fn in_thread<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, JoinError> {
    let mut asked = Asked(spawn_blocking(work));
    (&mut asked.0).await
}

/// Work that is given up with this. What has begun goes on to its end.
struct Asked<T>(JoinHandle<T>);

impl<T> Drop for Asked<T> {
    fn drop(&mut self) {
        self.0.abort();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc;

    #[test]
    fn what_nobody_waits_for_any_more_is_not_begun() {
        let runtime = tokio::runtime::Builder::new_current_thread().max_blocking_threads(1).build();
        let (free, taken) = mpsc::channel::<()>();
        let done = Arc::new(AtomicBool::new(false));
        runtime.expect("a runtime").block_on(async {
            // The only thread.
            let other = spawn_blocking(move || taken.recv());
            let given_up = Arc::clone(&done);
            tokio::select! {
                biased;
                _ = in_thread(move || given_up.store(true, Ordering::Relaxed)) => panic!("there is no thread for it"),
                // It was asked for by now, and its asker goes.
                () = std::future::ready(()) => {}
            }
            free.send(()).expect("it is waited for");
            other.await.expect("it ends").expect("it was told to");
            assert_eq!(in_thread(|| 1).await.expect("there is a thread again"), 1);
        });
        assert!(!done.load(Ordering::Relaxed));
    }
}
