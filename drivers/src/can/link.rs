//! The loop's end of a bus: none of what it calls waits, locks or allocates.

use super::orders::{Orders, Set};
use super::thread;
use super::{BusState, CanError, Condition, Frame, FrameId, Interface, TimedFrame};
use crate::exchange::{Giver, Taker, exchange};
use crate::journal::Journal;
use rustix::event::{EventfdFlags, eventfd};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::Ordering::Release;
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Most frames of one set of commands.
pub const MOST_COMMAND_FRAMES: usize = 16;
/// Sets that the loop may be ahead of a thread that is held up; those beyond are not sent.
const SETS_AHEAD: usize = 8;
/// Frames that may wait for the loop: 50 ms of a full bus at 1 Mbit/s.
const FRAMES_AHEAD: usize = 1024;
/// How long a link that is dropped waits for its thread to take the last commands.
const LAST_SET: Duration = Duration::from_millis(200);

/// A bus, owned by a thread of its own. Dropped, it sends the last set of commands, as far as there is room within 200 ms.
pub struct CanLink {
    sets: Giver<Set>,
    heard: Taker<TimedFrame>,
    orders: Arc<Orders>,
    wake: Arc<OwnedFd>,
    number: u64,
    /// The newest set, where there was no room for it.
    refused: Option<Set>,
    thread: Option<JoinHandle<()>>,
}

impl CanLink {
    /// Opens the bus in a thread of its own, which first calls `prepare` (its priority). Of the data frames only those with the
    /// `wanted` identifiers are received. The bus may be bus-off then; what it does later stands in [`state`](Self::state) and
    /// in the journal. After a loss (interface down or gone, peer gone) the thread tries again every 200 ms.
    ///
    /// # Errors
    /// See [`CanError`]: each says what to do.
    pub fn open(
        interface: &Interface,
        wanted: &[FrameId],
        prepare: impl FnOnce() + Send + 'static,
        journal: Journal,
    ) -> Result<CanLink, CanError> {
        let system = |what| move |source: io::Error| CanError::System { interface: interface.clone(), what, source };
        let (give_set, take_set) = exchange(SETS_AHEAD);
        let (give_frame, take_frame) = exchange(FRAMES_AHEAD);
        let wake =
            eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC).map_err(|e| system("eventfd")(e.into()))?;
        let wake = Arc::new(wake);
        let orders = Arc::new(Orders::new());
        let worker = thread::Worker {
            interface: interface.clone(),
            wanted: wanted.to_vec(),
            sets: take_set,
            heard: give_frame,
            orders: orders.clone(),
            wake: wake.clone(),
        };
        let (opened, told) = mpsc::sync_channel(1);
        let thread = std::thread::Builder::new()
            .name("can".to_owned())
            .spawn(move || {
                prepare();
                worker.work(journal, opened);
            })
            .map_err(system("thread"))?;
        let mut link =
            CanLink { sets: give_set, heard: take_frame, orders, wake, number: 0, refused: None, thread: Some(thread) };
        match told.recv() {
            Ok(Ok(())) => Ok(link),
            Ok(Err(error)) => {
                link.join();
                Err(error)
            }
            Err(_) => Err(system("thread")(io::Error::other("it ended before the bus was open"))),
        }
    }

    /// Gives a set of command frames, at most [`MOST_COMMAND_FRAMES`] (those beyond count as unsent), in the order in which they are to
    /// be sent. It replaces what is left of the one before. One system call, which does not wait: the thread's wake-up.
    pub fn send(&mut self, frames: &[Frame]) {
        let beyond = frames.len().saturating_sub(MOST_COMMAND_FRAMES);
        if beyond > 0 {
            self.orders.unsent(beyond as u64);
        }
        if let Some(set) = Set::new(self.number + 1, frames) {
            self.number += 1;
            self.give(set);
            self.wake();
        }
    }

    /// Calls `with` for each frame that came since the last call, in order; at most 1024.
    pub fn receive(&mut self, with: &mut dyn FnMut(&TimedFrame)) {
        self.heard.each(|frame| with(&frame));
    }

    /// How the bus does.
    pub fn state(&self) -> BusState {
        self.orders.shared.state()
    }

    fn give(&mut self, set: Set) {
        self.refused = if self.sets.give(set) { None } else { Some(set) };
        // After the set: who sees the number finds the set, if there was room for it.
        self.orders.newest.store(set.number, Release);
    }

    fn wake(&self) {
        // Refused only where 2^64 wake-ups are pending.
        let _ = rustix::io::write(&self.wake, &1u64.to_ne_bytes());
    }

    fn join(&mut self) {
        if let Some(thread) = self.thread.take() {
            // It has no result; a panic in it has been told on stderr, and the bus counts as down.
            let _ = thread.join();
        }
    }
}

impl Drop for CanLink {
    fn drop(&mut self) {
        let since = Instant::now();
        while let Some(set) = self.refused {
            self.give(set);
            if since.elapsed() > LAST_SET || self.orders.shared.condition() == Condition::Down {
                break;
            }
            self.wake();
            std::thread::sleep(Duration::from_millis(1));
        }
        self.orders.stop.store(true, Release);
        self.wake();
        self.join();
    }
}
