//! The dry run: what a script would do to the rig, predicted on a model before anything moves.
//!
//! It is the real loop in virtual time, with the script's own playback, the rig's controller and the emulated rig in the place of the
//! rig, without sensor noise and without publication. The supervisor that drives never trips; a second one with the limits in force
//! listens to the same measurements and commands, and says where the run would have ended.
//!
//! So what is predicted differs from a run by the sensors' noise and by what the model does not know, and by nothing else.

mod watch;

use crate::devices::hands_of;
use crate::emulation;
use crate::failure::{Failure, Kind};
use crate::rig_file::{DeviceSpec, Rig};
use crate::setup::Knowledge;
use crate::simulation::added_effects;
use drivers::EmulatedRig;
use drivers::emulated::{Noise, Settings};
use drivers::faults::Faulty;
use drivers::journal::JournalReader;
use model::{ModelFile, Parameters};
use profiles::{Context, Need, Place, Script, Timeout};
use rt_core::{Channel, Device, Limits, Lockstep, Run, Sample, Stages, Supervisor, Tick, Trip};
use std::cell::RefCell;
use std::collections::BTreeMap;
use watch::{Heard, Watch, Watched};

/// What a dry run predicts.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// What the supervisor would enforce: the rig's limits, narrowed by the script's envelope.
    pub limits: Limits,
    /// Ticks until the script's own end, whether or not the run would get there.
    pub ticks: u64,
    /// Smallest and largest value of each quantity that was measured or commanded, in the order of [`Channel`]; behind a predicted trip
    /// too, so that they say how far beyond the limit the script would go.
    pub peaks: Vec<Peak>,
    /// When each step was played, in order. A step that a loop left out is missing.
    pub played: Vec<Played>,
    /// Where the run would have ended before the script did, and why.
    pub trip: Option<PredictedTrip>,
    /// Holds whose `timeout_s` struck.
    pub timeouts: Vec<Timeout>,
    /// Steps that drive the pump until people confirm, for as long as they were played: what comes later is not predicted.
    pub open_ended: Vec<(Place, Played)>,
    /// Why the rig failed before the script's end: the model left the range in which it holds, it was told what no rig can do, or a fault
    /// of the script stopped the amplifier.
    pub failed: Option<String>,
}

/// Smallest and largest value of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Which: pressures in bar absolute, angle in degrees, velocity of the free lever in degrees a second, torque on the clamp in Nm,
    /// voltage in V.
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
    /// The script's unrolled step that acts there, as in the samples.
    pub step: u32,
}

/// When a step was played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Played {
    /// The script's unrolled step.
    pub step: u32,
    /// Its first tick.
    pub tick: u64,
    /// How many.
    pub ticks: u64,
}

/// A trip that the run would have come to.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedTrip {
    /// What the supervisor would have said.
    pub trip: Trip,
    /// The script's unrolled step that leads to it.
    pub step: u32,
    /// Where that is written.
    pub place: Place,
}

impl Prediction {
    /// How long the script takes, s.
    pub fn duration_s(&self) -> f64 {
        Tick::at(self.ticks).seconds()
    }

    /// The peak of a channel; `None`: it was never measured.
    pub fn peak(&self, channel: Channel) -> Option<&Peak> {
        self.peaks.iter().find(|peak| peak.channel == channel)
    }

    /// Smallest and largest value that the supervisor lets pass, in the channel's unit. `None`: it has no such limit.
    pub fn limit(&self, channel: Channel) -> Option<(f64, f64)> {
        let both = |most: f64| Some((-most, most));
        match channel {
            Channel::Pressure1 | Channel::Pressure2 => {
                Some((self.limits.pressure_min_bar, self.limits.pressure_max_bar))
            }
            Channel::Angle => both(self.limits.angle_max_deg),
            Channel::Velocity => both(self.limits.velocity_max_deg_s),
            Channel::Torque => both(self.limits.torque_max_nm),
            Channel::Voltage => both(self.limits.voltage_max_v),
            Channel::Heartbeat | Channel::Deadline | Channel::EmergencyStop => None,
        }
    }

    /// What is left to the nearer limit, as a fraction of that limit; negative beyond it. `None`: there is no limit.
    pub fn margin(&self, peak: &Peak) -> Option<f64> {
        let (low, high) = self.limit(peak.channel)?;
        let above = (high - peak.most.value) / high.abs().max(f64::MIN_POSITIVE);
        let below = (peak.least.value - low) / low.abs().max(f64::MIN_POSITIVE);
        Some(above.min(below))
    }

    /// What people must know of the steps that last until they confirm: a sentence for each line of the script that has one.
    pub fn remarks(&self) -> Vec<String> {
        let mut by_line: BTreeMap<usize, u64> = BTreeMap::new();
        for (place, played) in &self.open_ended {
            let most = by_line.entry(place.line).or_default();
            *most = played.ticks.max(*most);
        }
        let sentence = |(line, ticks): (&usize, &u64)| {
            format!(
                "line {line} DRIVES THE PUMP UNTIL PEOPLE CONFIRM: predicted for {:.1} s of that, what comes later is not known; confirm by \
                 then, or give the step a timeout_s",
                Tick::at(*ticks).seconds()
            )
        };
        by_line.iter().map(sentence).collect()
    }

    /// Whether the run would reach the script's end.
    ///
    /// # Errors
    /// A predicted trip or failure: which, where and what to do (3).
    pub fn judge(&self, script: &Script) -> Result<(), Failure> {
        let name = &script.name;
        let message = match (&self.trip, &self.failed) {
            (Some(PredictedTrip { trip, place, .. }), _) => {
                format!(
                    "{name}: would trip in the step of {place}: {trip}; nothing was moved: change that step, or the limit if it is too narrow"
                )
            }
            (None, Some(what)) => format!("{name}: would fail: {what}; nothing was moved"),
            (None, None) => return Ok(()),
        };
        Err(Failure::new(Kind::Acceptance, message))
    }
}

/// Runs `script` on an emulated rig with the parameters and effects of `model`, under the limits, the largest voltage and the
/// controller of `rig`. The operator's part is done at once; but where people confirm, a step that drives the pump until they do is played
/// as long as [`Script::foreseen`] has it. `seed` draws the script's random steps and the frames that its faults
/// hit: the real run must use the same.
///
/// # Errors
/// The script or its envelope does not fit the rig, the rig's controller can't serve its targets, the model has an effect that the library
/// does not know (2).
pub fn predict(script: &Script, rig: &Rig, model: &ModelFile, seed: u64) -> Result<Prediction, Failure> {
    Ok(played(script, rig, model, seed, false)?.0)
}

/// As [`predict`], with every sample that the run would have.
///
/// # Errors
/// As there.
pub fn predict_samples(
    script: &Script,
    rig: &Rig,
    model: &ModelFile,
    seed: u64,
) -> Result<(Prediction, Vec<Sample>), Failure> {
    played(script, rig, model, seed, true)
}

fn played(
    script: &Script,
    rig: &Rig,
    model: &ModelFile,
    seed: u64,
    keep: bool,
) -> Result<(Prediction, Vec<Sample>), Failure> {
    let input = |e: &dyn std::error::Error| Failure::new(Kind::Input, e.to_string());
    let limits =
        script.envelope.narrow(&rig.limits).map_err(|e| Failure::new(Kind::Input, format!("{}: {e}", script.name)))?;
    served(script, &rig.knowledge)?;
    let context = Context { u_max_v: rig.facts.u_max_v, seed, hands: hands_of(&rig.device) };
    let mut playback = script.foreseen(&context).map_err(|e| input(&e))?;
    let mut controller = rig.knowledge.controller(script.plane)?;

    let mut parameters: Parameters = model.parameters;
    // The plant has no largest voltage of its own; the one in a model is that of the rig that it was identified on.
    parameters.pump.u_max = rig.facts.u_max_v;
    let settings = Settings { noise: Noise::NONE, release_spread: 0.0, ..emulation::prepared(script) };
    let effects = added_effects(model).map_err(|e| input(&e))?;
    let device = EmulatedRig::new(&parameters, effects, settings).map_err(|e| input(&e))?;
    let mut journals = JournalReader::default();
    let device: Box<dyn Device> = if script.faults.is_empty() {
        Box::new(device)
    } else {
        let faulty = Faulty::new(device, &script.faults, seed, journals.journal("faults")).map_err(|e| input(&e))?;
        Box::new(faulty.with_safe_state(limits.safe_state))
    };

    let watch = RefCell::new(Watch::new(Supervisor::new(limits).map_err(|e| input(&e))?));
    watch.borrow_mut().samples = keep.then(Vec::new);
    let mut supervisor = Supervisor::new(unlimited(&limits)).map_err(|e| input(&e))?;
    let (mut flight, _flown) = rt_core::flight::recorder();
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device: &mut Watched { device, watch: &watch },
        operator: &mut (),
        supervisor: &mut supervisor,
        reference: &mut playback,
        controller: &mut *controller,
        publish: &mut Heard(&watch),
        flight: &mut flight,
    };
    let outcome = rt_core::run(stages, Run { number: 0, overrun: script.overrun });

    let mut watch = watch.into_inner();
    let samples = watch.samples.take().unwrap_or_default();
    let last = watch.played.last().map_or(0, |played| played.step);
    let (trip, failed) = match outcome {
        // What trips without limits is a command that is no number, which the watch never sees.
        Ok(report) => (watch.trip.or(report.trip.map(|trip| (trip, last))), None),
        Err(error) => (watch.trip, Some(error.to_string())),
    };
    let trip = trip.map(|(trip, step)| {
        let place = playback.place(step).unwrap_or(Place { line: 1, with: String::new() });
        PredictedTrip { trip, step, place }
    });
    let open_ended = watch.played.iter().filter(|played| playback.is_open_ended(played.step));
    let open_ended = open_ended.filter_map(|played| Some((playback.place(played.step)?, *played))).collect();
    let prediction = Prediction {
        limits,
        ticks: watch.ticks,
        peaks: watch.peaks(),
        played: watch.played,
        trip,
        timeouts: playback.timeouts(),
        open_ended,
        failed,
    };
    Ok((prediction, samples))
}

/// The model that a rig file gives to predict with: the plant of an emulated rig, with its effects; of a rig on wires the controller's,
/// once it is identified.
pub fn model_of(rig: &Rig) -> Option<&ModelFile> {
    match (&rig.device, &rig.knowledge) {
        (DeviceSpec::Emulated(plant), _) => Some(plant),
        (DeviceSpec::Wired(_), Knowledge::Model(model, _)) => Some(model),
        (DeviceSpec::Wired(_), Knowledge::Pump(_) | Knowledge::Nothing) => None,
    }
}

/// Whether the rig's controller knows enough for the script's targets.
///
/// # Errors
/// It does not: what is missing (2).
pub fn served(script: &Script, knowledge: &Knowledge) -> Result<(), Failure> {
    let known = match knowledge {
        Knowledge::Nothing => Need::Nothing,
        Knowledge::Pump(_) => Need::Pump,
        Knowledge::Model(..) => Need::Model,
    };
    if script.need() <= known {
        return Ok(());
    }
    let (wanted, expected) = match script.need() {
        Need::Pump => ("flows", "the pump's model"),
        Need::Model | Need::Nothing => ("pressures or angles", "an identified model"),
    };
    let message = format!(
        "{}: asks for {wanted}, for which the controller needs {expected}, and the rig file names none: set [controller] model",
        script.name
    );
    Err(Failure::new(Kind::Input, message))
}

/// Limits under which nothing trips but a command that is no number; what changes the course of a run without a trip stays.
fn unlimited(limits: &Limits) -> Limits {
    Limits {
        pressure_min_bar: f64::MIN,
        pressure_max_bar: f64::MAX,
        angle_max_deg: f64::MAX,
        velocity_max_deg_s: f64::MAX,
        torque_max_nm: f64::MAX,
        missing_max_ticks: u32::MAX,
        // the largest that a supervisor takes, nearly: nothing is old on an emulated device
        age_max_ms: 4e3,
        heartbeat_max_ms: 4e3,
        voltage_max_v: f64::MAX,
        aftermath_ticks: 0,
        ..*limits
    }
}
