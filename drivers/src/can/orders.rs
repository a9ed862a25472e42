//! What the loop hands to the thread: command frames, and its word that the bus is let go.

use super::Frame;
use super::link::MOST_COMMAND_FRAMES;
use super::state::Shared;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// A set of command frames.
#[derive(Clone, Copy)]
pub(super) struct Set {
    /// Counts the sets, from 1.
    pub(super) number: u64,
    frames: [Frame; MOST_COMMAND_FRAMES],
    pub(super) length: usize,
}

impl Set {
    /// The frames that have a place in it; `None` where there are none.
    pub(super) fn new(number: u64, frames: &[Frame]) -> Option<Set> {
        let length = frames.len().min(MOST_COMMAND_FRAMES);
        let mut set = Set { number, frames: [*frames.first()?; MOST_COMMAND_FRAMES], length };
        set.frames[..length].copy_from_slice(&frames[..length]);
        Some(set)
    }

    pub(super) fn frames(&self) -> &[Frame] {
        &self.frames[..self.length]
    }
}

/// What loop and thread share besides the queues.
pub(super) struct Orders {
    pub(super) shared: Shared,
    /// Number of the newest set, whether or not there was room for it.
    pub(super) newest: AtomicU64,
    /// Send what there is and end.
    pub(super) stop: AtomicBool,
}

impl Orders {
    pub(super) fn new() -> Orders {
        Orders { shared: Shared::new(), newest: AtomicU64::new(0), stop: AtomicBool::new(false) }
    }

    pub(super) fn unsent(&self, frames: u64) {
        self.shared.unsent.fetch_add(frames, Relaxed);
    }
}
