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

    /// Frames of an older set that did not go out: what this one does not say anew goes out before its own, as far as there is room. How many do not.
    pub(super) fn take_over(&mut self, older: &[Frame]) -> usize {
        let mut both = self.frames;
        let mut length = 0;
        for frame in older {
            let said_anew = self.frames().iter().any(|own| own.id == frame.id);
            if !said_anew && length + self.length < MOST_COMMAND_FRAMES {
                both[length] = *frame;
                length += 1;
            }
        }
        both[length..length + self.length].copy_from_slice(self.frames());
        self.frames = both;
        self.length += length;
        older.len() - length
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test")]

    use super::*;
    use crate::can::FrameId;

    fn frame(id: u16, byte: u8) -> Frame {
        Frame::new(FrameId::Standard(id), &[byte]).unwrap()
    }

    #[test]
    fn what_a_newer_set_does_not_say_anew_goes_out_before_it() {
        let mut newer = Set::new(2, &[frame(5, 1), frame(1, 1)]).unwrap();
        assert_eq!(newer.take_over(&[frame(9, 0), frame(7, 0), frame(5, 0), frame(1, 0)]), 2);
        assert_eq!(
            newer.frames(),
            [frame(9, 0), frame(7, 0), frame(5, 1), frame(1, 1)],
            "its own last frame is the last"
        );
        assert_eq!(newer.take_over(&[frame(9, 3)]), 1, "what was taken over before is newer");
        assert_eq!(newer.take_over(&[]), 0);
    }

    #[test]
    fn where_there_is_no_room_the_newer_set_stands() {
        let own: Vec<Frame> = (0..MOST_COMMAND_FRAMES as u16 - 1).map(|id| frame(id, 1)).collect();
        let mut newer = Set::new(2, &own).unwrap();
        assert_eq!(newer.take_over(&[frame(100, 0), frame(101, 0)]), 1);
        assert_eq!(newer.frames()[0], frame(100, 0));
        assert_eq!(newer.frames()[1..], own);
    }
}
