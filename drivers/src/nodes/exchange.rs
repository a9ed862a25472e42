//! What is said between the bus and the plant behind it: commands, answers, news and counts.

use crate::wired::Preparation;
use rt_core::Measurement;

/// A command frame on which nodes act, with what the frames before it said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sync {
    /// Counts the commands; `None` where the bus has no counter: every frame is one tick then.
    pub counter: Option<Counter>,
    /// A run goes on.
    pub running: bool,
    /// The run, and valves and fixture as commanded now. Its voltage is not read: that comes over the other wire.
    pub preparation: Preparation,
}

/// A value that begins anew after so many.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counter {
    /// 0..modulus.
    pub value: u64,
    /// > 1.
    pub modulus: u64,
}

impl Counter {
    /// How far it went on since `before`; `None` where it stands or went back.
    pub(super) fn since(self, before: Counter) -> Option<u64> {
        let Counter { value, modulus } = self;
        let ahead = (value % modulus + modulus - before.value % modulus) % modulus;
        (1..=modulus / 2).contains(&ahead).then_some(ahead)
    }
}

/// What the nodes say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Everything that is measured; all of it faulty where the plant has failed.
    pub measurement: Measurement,
    /// The command's counter as it came.
    pub counter: u64,
    /// As the valve stands.
    pub brake_is_open: bool,
    /// As the valve stands.
    pub bypass_is_open: bool,
    /// No fresh command came in time.
    pub timed_out: bool,
}

/// What happened, for people.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    /// A rig was prepared.
    Prepared(Preparation),
    /// No fresh command came: the nodes went to the safe state at this tick.
    TimedOut(u64),
    /// Fresh commands come again, from this tick on.
    Recovered(u64),
    /// What no rig could be told, or no rig could be prepared for: the one before stays.
    Refused(String),
    /// The plant can't go on.
    Failed(String),
}

/// What was counted, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counted {
    /// SYNCs.
    pub syncs: u64,
    /// Of these, those whose counter stood or went back.
    pub repeated: u64,
    /// Ticks that counters passed over.
    pub passed_over: u64,
    /// SYNCs of a run whose command of the amplifier had not come when it was to act: the one before stayed.
    pub late: u64,
    /// Commands that were refused.
    pub refused: u64,
    /// Times that the nodes went to the safe state by themselves.
    pub timeouts: u64,
    /// Preparations.
    pub preparations: u64,
}
