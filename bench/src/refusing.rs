//! For tests: the far end of a command channel that refuses whatever is asked, as a link does that may only look.

use rt_core::{Answer, CommandServer, Refusal};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

/// Refuses commands to `instance` while `body` runs.
pub fn refusing<T>(instance: &str, refusal: Refusal, body: impl FnOnce() -> T) -> T {
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        let (ready, opened) = mpsc::channel();
        scope.spawn(|| {
            let ready = ready; // the channel closes should the listener not open
            let mut server = CommandServer::open(instance).expect("shared memory is there");
            ready.send(()).expect("the test waits");
            let mut refuse = |_| {
                let (answer, answers) = mpsc::channel();
                let refused = Answer { taken: Err(refusal), open: None, text: String::new() };
                answer.send(refused).expect("its receiver is here");
                answers
            };
            while !over.load(Ordering::Relaxed) {
                server.pass_on(Duration::from_millis(10), &mut refuse).expect("it listens");
            }
        });
        opened.recv().expect("it listens");
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(body));
        over.store(true, Ordering::Relaxed);
        result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}
