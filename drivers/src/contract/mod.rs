//! What every device of the loop owes it, as functions that test a device: the emulated rig, the wired rig against an emulated one,
//! a wrapper, your own.
//!
//! A test implements [`Subject`] for a device with what is at its far end, and calls [`check`]. What a device can't be tested for, its
//! subject says with the reason ([`Subject::exempt`]).
//!
//! | clause | |
//! |---|---|
//! | [`Clause::Freshness`] | a value is as old as its age says, and no older than the wires make it |
//! | [`Clause::Ordering`] | no value is followed by an older one; ticks may be passed over |
//! | [`Clause::TimeOuts`] | what is silent grows old or fails, and nothing is invented |
//! | [`Clause::LastCommand`] | of several commands the last counts |
//! | [`Clause::SafeOnDrop`] | a device that is dropped leaves 0 V and the safe valves |
//! | [`Clause::Rearm`] | after a cut of the amplifier's wire 0 V, until the operator's word |
//! | [`Clause::Shutdown`] | dropped, it lets go, and can be opened again |
//! | [`Clause::TimeGoesOn`] | a tick of before is refused or does no harm |

mod case;
mod clauses;

pub use clauses::{freshness, last_command, ordering, rearm, safe_on_drop, shutdown, time_goes_on, time_outs};

use rt_core::{Device, Input, Measurement, SafeState, Tick};

/// What is tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the module's table says it")]
pub enum Clause {
    Freshness,
    Ordering,
    TimeOuts,
    LastCommand,
    SafeOnDrop,
    Rearm,
    Shutdown,
    TimeGoesOn,
}

/// A way to the rig that can be cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// To the pump's amplifier.
    Amplifier,
    /// To valves and sensors.
    Bus,
}

/// A wire that carries nothing from one tick to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Which one.
    pub wire: Wire,
    /// Nothing passes from this tick on.
    pub from_tick: u64,
    /// From this tick on everything passes again.
    pub until_tick: u64,
}

/// What the rig has in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FarEnd {
    /// At the amplifier, V.
    pub voltage_v: f64,
    /// As the valve stands.
    pub brake_open: bool,
    /// As the valve stands.
    pub bypass_open: bool,
}

/// What went wrong outside the device.
pub type Trouble = Box<dyn std::error::Error>;

/// A device, and the hands at its far end.
pub trait Subject {
    /// What is tested.
    type Device: Device;

    /// Opens the device with its rig at rest, arms it and begins a run (`begin_run` is called here): tick 0 is now or soon. `cut` is
    /// done in the course of that run, by [`Subject::wait`] where nothing else does it.
    ///
    /// # Errors
    /// The rig or the device can't be had.
    fn open(&mut self, cut: Option<Cut>) -> Result<Self::Device, Trouble>;

    /// Returns when this tick of the run begins; at once in virtual time. Also called with the tick after the last.
    fn wait(&mut self, index: u64) -> Tick {
        Tick::at(index)
    }

    /// What the rig has in force now, after everything that was sent has arrived. `None` where it can't be seen.
    fn far_end(&mut self) -> Option<FarEnd>;

    /// What the rig showed at this tick of the run, as its sensors measured it; `None` where that is not known.
    fn shown(&mut self, tick: u64) -> Option<Measurement>;

    /// Whether [`Subject::shown`] knows most ticks. Where it does not (a real rig), values are judged by their ages alone.
    fn knows_what_was_shown(&self) -> bool {
        true
    }

    /// How far a value that is read may be from what was shown, in the unit of the input: the wire's resolution.
    fn resolution(&self, _input: Input) -> f64 {
        0.0
    }

    /// Oldest age of a value on sound wires, ticks: 0 where it is measured at the tick itself.
    fn age_ticks(&self) -> u64 {
        0
    }

    /// How far the rig's voltage may be from the command, V: the wire's resolution.
    fn voltage_resolution_v(&self) -> f64 {
        0.0
    }

    /// Where the valves go.
    fn safe_state(&self) -> SafeState {
        SafeState::default()
    }

    /// The operator's word after a cut, and the begin of another run, without a cut: tick 0 is now or soon.
    ///
    /// # Errors
    /// The device refuses.
    fn arm(&mut self, device: &mut Self::Device) -> Result<(), Trouble>;

    /// Why this can't be tested here; `None` = it can.
    fn exempt(&self, _clause: Clause) -> Option<&'static str> {
        None
    }
}

/// A clause that a device does not keep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{clause:?}: {what}")]
pub struct Violation {
    /// Which clause.
    pub clause: Clause,
    /// Expected and got.
    pub what: String,
}

/// Tests every clause; returns those from which the subject is exempt, with its reasons.
///
/// # Errors
/// The first clause that is not kept.
pub fn check<S: Subject>(subject: &mut S) -> Result<Vec<(Clause, &'static str)>, Violation> {
    type Test<S> = fn(&mut S) -> Result<(), Violation>;
    let clauses: [(Clause, Test<S>); 8] = [
        (Clause::Freshness, freshness),
        (Clause::Ordering, ordering),
        (Clause::TimeOuts, time_outs),
        (Clause::LastCommand, last_command),
        (Clause::SafeOnDrop, safe_on_drop),
        (Clause::Rearm, rearm),
        (Clause::Shutdown, shutdown),
        (Clause::TimeGoesOn, time_goes_on),
    ];
    let mut exempt = vec![];
    for (clause, test) in clauses {
        match subject.exempt(clause) {
            Some(reason) => exempt.push((clause, reason)),
            None => test(subject)?,
        }
    }
    Ok(exempt)
}
