//! Sensors that stand still or repeat their twin; those that saturate are in [`super::saturation`].
//!
//! A quiet sensor is no broken one: at rest everything stands still, a clamped lever keeps its angle, a shut chamber its pressure. A
//! sensor is called broken only where another one, or the command, says that it should have moved:
//!
//! | run | should move | because |
//! |---|---|---|
//! | lever free | both pressures, the angle | the pump is driven both ways with the chambers connected to it, and another sensor moves |
//! | torque-map | both pressures, the torque, the angle between the clamps | the pump presses against the clamp; the lever is led from one clamp to the next |
//! | volume-map | angle, both pressures | the lever is led with the chambers shut |
//! | clamp-steps | pressure 1, volume, torque | oil is released from chamber 1 |
//! | pump-map | volume | the pump turns |

use recordings::{Protocol, Recording, RunEntry};

use super::saturation::{Reach, saturated};
use super::series::{Motion, longest_constant};
use crate::prepare::{is_read, segments};

/// A sensor of the rig, with its column of the contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Encoder.
    Angle,
    /// Of chamber 1.
    Pressure1,
    /// Of chamber 2.
    Pressure2,
    /// Force sensor of the clamp.
    Torque,
    /// Measuring cylinder.
    Volume,
}

impl Sensor {
    const ALL: [Sensor; 5] = [Sensor::Angle, Sensor::Pressure1, Sensor::Pressure2, Sensor::Torque, Sensor::Volume];

    /// Column of the campaign format.
    pub fn column(self) -> &'static str {
        ["angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml"][self as usize]
    }

    pub(super) fn of(self, r: &Recording) -> &[f64] {
        match self {
            Sensor::Angle => &r.angle_deg,
            Sensor::Pressure1 => &r.pressure1_bar,
            Sensor::Pressure2 => &r.pressure2_bar,
            Sensor::Torque => &r.torque_nm,
            Sensor::Volume => &r.volume_ml,
        }
    }
}

/// What is wrong with a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It shows one value while it should move.
    Dead,
    /// It stops at its extreme value while what it measures goes on.
    Saturated,
    /// Two sensors show the same.
    Duplicated,
}

impl Fault {
    /// Word in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Fault::Dead => "dead",
            Fault::Saturated => "saturated",
            Fault::Duplicated => "duplicated",
        }
    }
}

/// A sensor whose values are not used.
#[derive(Clone, Debug, PartialEq)]
pub struct SetAside {
    /// The run's file.
    pub file: String,
    /// What is wrong.
    pub fault: Fault,
    /// The channels.
    pub channels: Vec<Sensor>,
    /// Expected and got.
    pub why: String,
    /// The run is of no use without them and is left out.
    pub whole_run: bool,
}

impl SetAside {
    /// Columns of the contract.
    pub fn columns(&self) -> String {
        self.channels.iter().map(|c| c.column()).collect::<Vec<_>>().join(", ")
    }

    /// One line: the columns, the fault, what was done.
    pub fn said(&self) -> String {
        let what = if self.whole_run { "the run is set aside" } else { "these values are passed over" };
        format!("{}: sensor {}: {}; {what}", self.columns(), self.fault.as_str(), self.why)
    }
}

/// Rows in which a stuck sensor must at least stand, as a share of the run, and voltage changes meanwhile.
const STUCK_SHARE: f64 = 0.2;
const STUCK_CHANGES: usize = 2;
/// Share of missing rows from which a run is of no use.
pub(super) const TOO_MUCH: f64 = 0.5;

/// Looks at all sensors of a run; what is broken becomes missing. `lever_deg`: where the lever was in other runs.
pub(super) fn broken(entry: &RunEntry, r: &mut Recording, lever_deg: Reach) -> Vec<SetAside> {
    let mut out = dead(entry, r);
    if out.iter().any(|s| s.whole_run) {
        return out;
    }
    out.extend(duplicated(entry, r));
    if out.iter().any(|s| s.whole_run) {
        return out;
    }
    // a long stay at the end of a sensor's range is not one that is stuck there
    out.extend(saturated(entry, r, lever_deg));
    out.extend(stuck(entry, r));
    out
}

pub(super) fn free(protocol: Protocol) -> bool {
    matches!(protocol, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps)
}

/// Rows in which the pump works on the chambers.
fn driven(r: &Recording) -> impl Fn(usize) -> bool + '_ {
    |i| r.brake_open[i] && !r.bypass_open[i]
}

pub(super) fn values_mut(r: &mut Recording, channel: Sensor) -> &mut [f64] {
    match channel {
        Sensor::Angle => &mut r.angle_deg,
        Sensor::Pressure1 => &mut r.pressure1_bar,
        Sensor::Pressure2 => &mut r.pressure2_bar,
        Sensor::Torque => &mut r.torque_nm,
        Sensor::Volume => &mut r.volume_ml,
    }
}

/// Whole channels that show nothing.
fn dead(entry: &RunEntry, r: &mut Recording) -> Vec<SetAside> {
    use Sensor::*;
    let motion = Sensor::ALL.map(|c| Motion::of(c.of(r), |_| true));
    let of = |c: Sensor| &motion[c as usize];
    // one reading a segment has no noise to be judged by: only a constant is flat
    let constant = |c: Sensor| of(c).blocks >= 4 && of(c).range == 0.0;
    let drives = r.voltage_v.iter().any(|u| *u > 0.0) && r.voltage_v.iter().any(|u| *u < 0.0);
    // (channel, shows it, what else moves)
    let suspects: Vec<(Sensor, bool, Vec<Sensor>)> = match entry.protocol {
        Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps if drives => vec![
            (Angle, of(Angle).is_flat(), vec![Pressure1, Pressure2]),
            (Pressure1, of(Pressure1).is_flat(), vec![Angle, Pressure2]),
            (Pressure2, of(Pressure2).is_flat(), vec![Angle, Pressure1]),
        ],
        Protocol::TorqueMap if drives => vec![
            (Angle, of(Angle).is_flat() && led_between(r) >= 2, vec![Torque, Pressure1, Pressure2]),
            (Pressure1, of(Pressure1).is_flat(), vec![Pressure2, Torque]),
            (Pressure2, of(Pressure2).is_flat(), vec![Pressure1, Torque]),
            (Torque, of(Torque).is_flat(), vec![Pressure1, Pressure2]),
        ],
        Protocol::VolumeMap => vec![
            (Angle, of(Angle).is_flat(), vec![Pressure1, Pressure2]),
            (Pressure1, of(Pressure1).is_flat(), vec![Angle, Pressure2]),
            (Pressure2, of(Pressure2).is_flat(), vec![Angle, Pressure1]),
        ],
        Protocol::ClampSteps => vec![
            (Pressure1, of(Pressure1).is_flat(), vec![Volume, Torque]),
            (Volume, constant(Volume), vec![Pressure1]),
            (Torque, of(Torque).is_flat(), vec![Pressure1]),
        ],
        Protocol::PumpMap if drives => vec![(Volume, constant(Volume), vec![])],
        _ => vec![],
    };
    let mut out = Vec::new();
    for (channel, flat, others) in suspects {
        let moves: Vec<&str> = others.iter().filter(|c| of(**c).is_clear()).map(|c| c.column()).collect();
        if !flat || (moves.is_empty() && !others.is_empty()) {
            continue;
        }
        let shown = crate::noise::mean(channel.of(r).iter().copied()).0;
        let meanwhile = match &moves[..] {
            [] => "the pump turns".into(),
            [one] => format!("{one} moves"),
            more => format!("{} move", more.join(" and ")),
        };
        let held = if channel == Sensor::Angle {
            " (or the lever was held, and then the lever of this run is not free)"
        } else {
            ""
        };
        // the force sensor is no input, and a clamp-steps run is of use without it
        let whole_run = !(channel == Sensor::Torque && entry.protocol == Protocol::ClampSteps);
        values_mut(r, channel).fill(f64::NAN);
        out.push(SetAside {
            file: entry.file.clone(),
            fault: Fault::Dead,
            channels: vec![channel],
            why: format!("expected it to move while {meanwhile}, got {shown:.4} throughout{held}"),
            whole_run,
        });
    }
    out
}

/// How often a torque-map leads the lever: stretches without torque between two with it.
fn led_between(r: &Recording) -> usize {
    let read: Vec<bool> = segments(r).into_iter().map(|(first, end)| is_read(r, &r.torque_nm, first, end)).collect();
    read.windows(2).filter(|w| w[0] && !w[1]).count()
}

/// Pressure sensors that show one chamber twice.
fn duplicated(entry: &RunEntry, r: &mut Recording) -> Vec<SetAside> {
    // on the bench and between the steps both ports may well lie at one pressure
    if !(free(entry.protocol) || matches!(entry.protocol, Protocol::TorqueMap | Protocol::VolumeMap)) {
        return Vec::new();
    }
    let keep = driven(r);
    let shut = entry.protocol == Protocol::VolumeMap;
    let chosen = |i: usize| shut || keep(i);
    let [p1, p2] = [&r.pressure1_bar, &r.pressure2_bar].map(|p| Motion::of(p, chosen));
    let difference: Vec<f64> = r.pressure1_bar.iter().zip(&r.pressure2_bar).map(|(a, b)| a - b).collect();
    let difference = Motion::of(&difference, chosen);
    let twin = p1.is_clear() && p2.is_clear() && difference.is_flat();
    if !twin {
        return Vec::new();
    }
    vec![SetAside {
        file: entry.file.clone(),
        fault: Fault::Duplicated,
        channels: vec![Sensor::Pressure1, Sensor::Pressure2],
        why: format!(
            "expected a pressure difference that moves with the pump or the lever, got one that stays within {:.4} bar while both pressures range over {:.3} bar: both columns show one sensor",
            difference.range, p1.range
        ),
        whole_run: true,
    }]
}

/// Sensors that stop working within a run of a free lever.
fn stuck(entry: &RunEntry, r: &mut Recording) -> Vec<SetAside> {
    if !free(entry.protocol) {
        return Vec::new();
    }
    let most = r.voltage_v.iter().fold(0.0f64, |m, u| m.max(u.abs()));
    let mut out = Vec::new();
    for channel in [Sensor::Angle, Sensor::Pressure1, Sensor::Pressure2] {
        let (first, end) = longest_constant(channel.of(r));
        if ((end - first) as f64) < STUCK_SHARE * r.len() as f64 {
            continue;
        }
        // driven both ways with voltages that count as large in this run: no lever sticks through that
        let mut changes = 0;
        let mut side = 0.0;
        for i in (first..end).filter(|&i| r.brake_open[i] && !r.bypass_open[i] && r.voltage_v[i].abs() >= 0.5 * most) {
            if side != 0.0 && r.voltage_v[i].signum() != side {
                changes += 1;
            }
            side = r.voltage_v[i].signum();
        }
        if changes < STUCK_CHANGES {
            continue;
        }
        let value = channel.of(r)[first];
        let (from_s, to_s) = (r.time_s[first], r.time_s[end - 1]);
        values_mut(r, channel)[first..end].fill(f64::NAN);
        let whole_run = missing(channel.of(r)) > TOO_MUCH || first == 0;
        out.push(SetAside {
            file: entry.file.clone(),
            fault: Fault::Dead,
            channels: vec![channel],
            why: format!(
                "expected it to move while the pump is driven both ways, got {value:.4} from {from_s:.2} to {to_s:.2} s"
            ),
            whole_run,
        });
    }
    out
}

pub(super) fn missing(values: &[f64]) -> f64 {
    values.iter().filter(|v| !v.is_finite()).count() as f64 / values.len().max(1) as f64
}
