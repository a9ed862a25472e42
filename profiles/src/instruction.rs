//! What a compiled script is made of: holds, with what they aim at and where loops are left.

use crate::ask::Part;
use crate::condition::Condition;
use crate::controlled::Controlled;
use crate::script::FixtureChange;
use crate::signal::Signal;
use crate::timeout::Place;
use std::sync::Arc;

/// One hold, ready to play. It is played at most once, so its conditions keep their state in place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Instruction {
    /// Line of the script, from 1.
    pub line: usize,
    /// Variables and passes of the loops around it, in words; may be empty.
    pub with: Arc<str>,
    /// Looked at before it begins.
    pub jumps: Vec<Jump>,
    pub aim: Option<Aim>,
    pub brake_open: Option<bool>,
    pub bypass_open: Option<bool>,
    pub fixture: Option<FixtureChange>,
    /// Longest duration, in ticks.
    pub ticks: u64,
    /// Ends it earlier.
    pub any: Vec<Condition>,
    /// Ends when its ramp has arrived.
    pub on_arrival: bool,
    /// It drives the pump until people confirm, and has no time of its own.
    pub open_ended: bool,
    /// What people do in it, where the rig does not.
    pub part: Part,
    pub new_segment: bool,
    /// Beyond this angle no voltage drives outward: it changes sign.
    pub guard_deg: Option<f64>,
    /// The tick at which its time was over before any of its conditions was met.
    pub struck_at: Option<u64>,
}

impl Instruction {
    pub fn place(&self) -> Place {
        Place { line: self.line, with: self.with.as_ref().to_owned() }
    }
}

/// What is controlled, and the wave that it follows, times a gain.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Aim {
    pub quantity: Controlled,
    pub gain: f64,
    pub signal: Signal,
}

impl Aim {
    /// 0 V, for as long as it is in force.
    pub fn rests(&self) -> bool {
        rests(self.quantity, &self.signal)
    }
}

/// Whether this quantity with this wave is 0 V at any time. A flow of 0 is none: it may need a voltage.
pub(crate) fn rests(quantity: Controlled, signal: &Signal) -> bool {
    let voltage = matches!(quantity, Controlled::VoltageV | Controlled::VoltageUMax);
    voltage && matches!(signal, Signal::Constant(value) if *value == 0.0)
}

/// Where a loop is left.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Jump {
    pub when: Vec<Condition>,
    pub to: usize,
}
