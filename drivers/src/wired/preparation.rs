//! How a rig is prepared before a run.

use rt_core::Command;

/// What the fixture (or the emulated operator) is told before the first tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preparation {
    /// Counts the runs of a session, modulo 256: a new value is a new preparation.
    pub run: u8,
    /// Gravity acts on the lever.
    pub vertical: bool,
    /// Pressure of both chambers, bar absolute.
    pub fill_bar: f64,
    /// What is in force before the first step; at 0 V.
    pub start: Command,
}
