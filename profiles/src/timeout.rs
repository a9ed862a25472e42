//! What is said of a hold whose time was over too early, and where a step is written.

use rt_core::Tick;
use std::fmt;

/// A hold whose time was over before what it waited for had come.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeout {
    /// The script's unrolled step, as in the samples.
    pub step: u32,
    /// Where that is written.
    pub place: Place,
    /// The first tick after the hold.
    pub tick: u64,
    /// How long it lasted, ticks: its `timeout_s`.
    pub ticks: u64,
    /// What it waited for.
    pub waited: Vec<Waited>,
}

/// Where an unrolled step is written, and which pass through its loops it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Line of the script, from 1.
    pub line: usize,
    /// The loops around it, outer first: `"angle_deg = 20, pass 2 of 10"`. Empty outside of loops.
    pub with: String,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}", self.line)?;
        if self.with.is_empty() { Ok(()) } else { write!(f, " ({})", self.with) }
    }
}

/// A condition that was not met.
#[derive(Clone, Debug, PartialEq)]
pub struct Waited {
    /// In words.
    pub what: String,
    /// What was left at the end: the value, the rate per second or the spread that was compared last, in the channel's unit; `None`:
    /// the channel was not measured, or not for long enough.
    pub left: Option<f64>,
}

impl fmt::Display for Timeout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Timeout { place, tick, ticks, waited, .. } = self;
        write!(f, "{place}: after {} s, at tick {tick}, still waited for ", Tick::at(*ticks).seconds())?;
        if waited.is_empty() {
            write!(f, "the operator's confirmation")?;
        }
        for (number, Waited { what, left }) in waited.iter().enumerate() {
            let or = if number > 0 { ", or " } else { "" };
            match left {
                Some(left) => write!(f, "{or}{what} (was {left:.4})")?,
                None => write!(f, "{or}{what} (not measured for long enough)")?,
            }
        }
        Ok(())
    }
}
