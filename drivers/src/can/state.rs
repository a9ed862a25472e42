//! How a bus does, for the loop and the recording.

use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU64, Ordering::Relaxed};

/// Fault confinement of the controller (ISO 11898-1), and whether there is one at all; worse later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Condition {
    /// Error-active: it takes part in the bus.
    Active,
    /// An error counter has reached 96.
    Warning,
    /// Error-passive: an error counter has reached 128.
    Passive,
    /// The transmit error counter has passed 255: the controller is off the bus until it is restarted.
    BusOff,
    /// The interface is down or gone, or nobody is at the other end of the Unix socket.
    Down,
}

impl Condition {
    const ALL: [Condition; 5] =
        [Condition::Active, Condition::Warning, Condition::Passive, Condition::BusOff, Condition::Down];

    /// Whether frames can come and go.
    pub fn carries_frames(self) -> bool {
        self <= Condition::Passive
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Condition::Active => "error-active",
            Condition::Warning => "error-warning",
            Condition::Passive => "error-passive",
            Condition::BusOff => "bus-off",
            Condition::Down => "down",
        })
    }
}

/// How a bus does; counts are since the link was opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusState {
    /// The controller's.
    pub condition: Condition,
    /// Its transmit and receive error counters, where it has told them.
    pub error_counters: Option<(u8, u8)>,
    /// Frames that the system has taken.
    pub sent: u64,
    /// Command frames that were not sent: a newer set came before there was room, or the bus was off or down.
    pub unsent: u64,
    /// Wanted frames that came.
    pub received: u64,
    /// Wanted frames that the loop did not get: it had not taken 1024 others, or the system's buffer was full.
    pub lost: u64,
    /// Error frames.
    pub errors: u64,
}

/// The same, written by the I/O thread and read by the loop. Each value is right by itself; they need not be of one moment.
#[derive(Debug)]
pub(super) struct Shared {
    condition: AtomicU8,
    /// Transmit counter in the high byte.
    counters: AtomicU16,
    counters_known: AtomicBool,
    pub(super) sent: AtomicU64,
    pub(super) unsent: AtomicU64,
    pub(super) received: AtomicU64,
    pub(super) lost: AtomicU64,
    pub(super) errors: AtomicU64,
}

impl Shared {
    pub(super) fn new() -> Shared {
        Shared {
            condition: AtomicU8::new(Condition::Down as u8),
            counters: AtomicU16::new(0),
            counters_known: AtomicBool::new(false),
            sent: AtomicU64::new(0),
            unsent: AtomicU64::new(0),
            received: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            errors: AtomicU64::new(0),
        }
    }

    pub(super) fn condition(&self) -> Condition {
        Condition::ALL[usize::from(self.condition.load(Relaxed))]
    }

    /// Says the condition that was.
    pub(super) fn set_condition(&self, condition: Condition) -> Condition {
        Condition::ALL[usize::from(self.condition.swap(condition as u8, Relaxed))]
    }

    pub(super) fn set_counters(&self, counters: (u8, u8)) {
        self.counters.store(u16::from_be_bytes([counters.0, counters.1]), Relaxed);
        self.counters_known.store(true, Relaxed);
    }

    pub(super) fn state(&self) -> BusState {
        let [transmit, receive] = self.counters.load(Relaxed).to_be_bytes();
        BusState {
            condition: self.condition(),
            error_counters: self.counters_known.load(Relaxed).then_some((transmit, receive)),
            sent: self.sent.load(Relaxed),
            unsent: self.unsent.load(Relaxed),
            received: self.received.load(Relaxed),
            lost: self.lost.load(Relaxed),
            errors: self.errors.load(Relaxed),
        }
    }
}
