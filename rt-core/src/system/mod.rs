//! What Linux is asked for on behalf of the loop, and what it granted.
//!
//! [`prepare_process`] once, before the loop's threads are started; [`prepare_thread`] in each of them. Neither fails: a wish
//! that the system refuses is a [`Grant`] with the cause and the remedy, and whoever asked decides whether that ends the
//! run. Nothing is reported as granted that was not read back from the kernel or seen to work.
//!
//! | wish | of the | because otherwise |
//! |---|---|---|
//! | memory locked | process | a page fault stalls the loop until the disk has answered |
//! | freed memory kept, heap touched before | process | the first use of a page costs a fault, each time it was given back |
//! | CPU latency request | process | an idle CPU sleeps so deeply that waking it takes 10..200 us |
//! | timer slack 1 ns | thread | the kernel may merge wake-ups within 50 us (before it is `SCHED_FIFO`) |
//! | CPU affinity | thread | moving to another CPU leaves the caches behind |
//! | stack touched before | thread | the first deep call faults |
//! | `SCHED_FIFO` | thread | the loop waits until the others have had their share |

mod faults;
mod process;
pub mod remedies;
mod report;
mod rights;
mod thread;
pub mod time;

pub use process::{ProcessGuard, prepare_process};
pub use report::{Grant, Outcome, Report};
pub use thread::prepare_thread;

/// What to ask the system for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Priority under `SCHED_FIFO`, 1..=99. Above 90 the loop would compete with the kernel's own threads.
    pub priority: u8,
    /// CPUs that the thread may run on, as the kernel counts them; `None` = any.
    pub cpus: Option<Vec<usize>>,
    /// Lock all memory of the process, now and in future, and prepare its heap.
    pub lock_memory: bool,
    /// Keep the CPUs from deep sleep while the [`ProcessGuard`] lives.
    pub latency_request: bool,
}

impl Request {
    /// Priority of the loop unless somebody says otherwise: above the threaded interrupts of a real-time kernel (50).
    pub const PRIORITY: u8 = 80;
}

impl Default for Request {
    fn default() -> Self {
        Request { priority: Request::PRIORITY, cpus: None, lock_memory: true, latency_request: true }
    }
}
