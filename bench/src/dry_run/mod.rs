//! The dry run: what a script would do to the rig, predicted on a model before anything moves.
//!
//! It is the real loop in virtual time, with the script's own playback, the rig's controller and the emulated rig in the place of the
//! rig, without sensor noise and without publication. The supervisor that drives never trips; a second one with the limits in force
//! listens to the same measurements and commands, and says where the run would have ended.

use crate::failure::{Failure, Kind};
use crate::rig_file::Rig;
use model::ModelFile;
use profiles::Script;
use rt_core::{Channel, Limits, Trip};

/// What a dry run predicts.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// What the supervisor would enforce: the rig's limits, narrowed by the script's envelope.
    pub limits: Limits,
    /// Ticks until the script's own end.
    pub ticks: u64,
    /// Smallest and largest value of each quantity that was measured or commanded, in the order of [`Channel`].
    pub peaks: Vec<Peak>,
    /// Where the run would have ended before the script did, and why.
    pub trip: Option<PredictedTrip>,
    /// Holds whose `timeout_s` struck.
    pub timeouts: Vec<PredictedTimeout>,
}

/// Smallest and largest value of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Which: pressures in bar absolute, angle in degrees, velocity in degrees a second, torque in Nm, voltage in V.
    pub channel: Channel,
    /// The smallest value.
    pub least: Extreme,
    /// The largest value.
    pub most: Extreme,
}

/// A value and where it occurs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extreme {
    /// In the channel's unit.
    pub value: f64,
    /// The tick.
    pub tick: u64,
    /// The script's unrolled step, as in the samples.
    pub step: u32,
}

/// A trip that the run would have come to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedTrip {
    /// What the supervisor would have said.
    pub trip: Trip,
    /// The script's unrolled step.
    pub step: u32,
    /// Line of the script where that step is written, from 1.
    pub line: usize,
}

/// A hold that would end by its `timeout_s`.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedTimeout {
    /// The tick at which it struck.
    pub tick: u64,
    /// The script's unrolled step.
    pub step: u32,
    /// Line of the script where that step is written, from 1.
    pub line: usize,
    /// What was waited for and how far away it was, for people.
    pub left: String,
}

impl Prediction {
    /// How long the run takes, s.
    pub fn duration_s(&self) -> f64 {
        self.ticks as f64 * 1e-9 * rt_core::PERIOD_NS as f64
    }

    /// No trip is predicted, or a failure that says which, where and what to do (3).
    ///
    /// # Errors
    /// A predicted trip.
    pub fn judge(&self, script: &Script) -> Result<(), Failure> {
        let Some(PredictedTrip { trip, line, .. }) = &self.trip else { return Ok(()) };
        let message =
            format!("{}: the dry run trips in the step of line {line}: {trip}; nothing was moved", script.name);
        Err(Failure::new(Kind::Acceptance, message))
    }
}

/// Runs `script` on an emulated rig with the parameters and effects of `model`, under the limits, the largest voltage and the
/// controller of `rig`. `seed` draws the script's random steps; the real run must use the same.
///
/// # Errors
/// The script or its envelope does not fit the rig, the model has an effect that the library does not know (2).
pub fn predict(script: &Script, rig: &Rig, model: &ModelFile, seed: u64) -> Result<Prediction, Failure> {
    let _ = (script, rig, model, seed);
    Err(Failure::new(Kind::Internal, "the dry run is not there yet"))
}
