//! Sensors that stand still, saturate or repeat their twin.
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

use super::series::{Motion, longest_constant};
use crate::noise::{step, white_std};
use crate::prepare::segments;

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

    fn of(self, r: &Recording) -> &[f64] {
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
const TOO_MUCH: f64 = 0.5;

/// Looks at all sensors of a run; what is broken becomes missing.
pub(super) fn broken(entry: &RunEntry, r: &mut Recording) -> Vec<SetAside> {
    let mut out = dead(entry, r);
    if out.iter().any(|s| s.whole_run) {
        return out;
    }
    out.extend(duplicated(entry, r));
    if out.iter().any(|s| s.whole_run) {
        return out;
    }
    out.extend(stuck(entry, r));
    out.extend(saturated(entry, r));
    out
}

fn free(protocol: Protocol) -> bool {
    matches!(protocol, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps)
}

/// Rows in which the pump works on the chambers.
fn driven(r: &Recording) -> impl Fn(usize) -> bool + '_ {
    |i| r.brake_open[i] && !r.bypass_open[i]
}

fn values_mut(r: &mut Recording, channel: Sensor) -> &mut [f64] {
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
        let meanwhile =
            if moves.is_empty() { "the pump turns".into() } else { format!("{} moves", moves.join(" and ")) };
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
    let read: Vec<bool> = segments(r)
        .into_iter()
        .map(|(first, end)| r.torque_nm[first..end].iter().filter(|v| v.is_finite()).count() * 2 > end - first)
        .collect();
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

fn missing(values: &[f64]) -> f64 {
    values.iter().filter(|v| !v.is_finite()).count() as f64 / values.len().max(1) as f64
}

/// Plateaus at the extreme value that the signal runs into at full speed.
fn saturated(entry: &RunEntry, r: &mut Recording) -> Vec<SetAside> {
    let channels: &[Sensor] = match entry.protocol {
        Protocol::PumpMap => &[],
        Protocol::ClampSteps => &[Sensor::Pressure1, Sensor::Torque],
        // a lever that is led stops where it is held
        Protocol::TorqueMap | Protocol::VolumeMap => &[Sensor::Pressure1, Sensor::Pressure2, Sensor::Torque],
        _ => &[Sensor::Angle, Sensor::Pressure1, Sensor::Pressure2],
    };
    let mut out = Vec::new();
    for &channel in channels {
        let values = channel.of(r);
        let (white, coarse) = (white_std(values).unwrap_or(0.0), step(values));
        // a coarse encoder stands still at a stop of the lever, too, unless its noise shows that it sees; steps alone look like 0.3
        if channel == Sensor::Angle && white < 0.5 * coarse {
            continue;
        }
        let noise = white.max(coarse);
        let long = if coarse == 0.0 {
            PLATEAU
        } else if white >= 0.5 * coarse {
            DITHERED
        } else {
            usize::MAX
        };
        for (side, word) in [(1.0, "above"), (-1.0, "below")] {
            let rows = clipped(channel.of(r), side, noise, long);
            if rows.is_empty() {
                continue;
            }
            let value = channel.of(r)[rows[0]];
            let count = rows.len();
            let target = values_mut(r, channel);
            rows.into_iter().for_each(|i| target[i] = f64::NAN);
            let share = missing(channel.of(r));
            out.push(SetAside {
                file: entry.file.clone(),
                fault: Fault::Saturated,
                channels: vec![channel],
                why: format!(
                    "expected values {word} {value:.4} where it stops dead at that value, got {count} samples of exactly {value:.4}, its extreme"
                ),
                whole_run: free(entry.protocol) && share > TOO_MUCH,
            });
        }
    }
    out
}

/// A plateau has this many rows at least.
const PLATEAU: usize = 5;
/// So many equal values of a sensor whose noise dithers its steps are no chance: at its largest value it is in the tail of the noise.
const DITHERED: usize = 30;
/// The way into a plateau is judged over twice this many noises.
const REACH: f64 = 10.0;
/// The second half of that way may take this many times as long as the first: 1 for a signal that is cut off, 1.9 for one that turns
/// smoothly within one step of the sensor, more for one that comes to rest.
const SLOWER: f64 = 1.5;
/// By so many noises the signal would have gone on in half of the plateau; a sharp turn stands for a step or two.
const BEYOND: f64 = 8.0;

/// Rows of the plateaus at the largest (`side` = 1) or smallest (-1) value, where there are at least two, and they are `long`, or the
/// signal runs into them with a slope that does not end there.
fn clipped(values: &[f64], side: f64, noise: f64, long: usize) -> Vec<usize> {
    let extreme = values.iter().filter(|v| v.is_finite()).fold(f64::NEG_INFINITY, |m, v| m.max(side * v));
    let at = |i: usize| values[i].is_finite() && side * values[i] == extreme;
    let mut plateaus: Vec<(usize, usize)> = Vec::new();
    let mut i = 0;
    while i < values.len() {
        let end = (i..values.len()).find(|&j| !at(j)).unwrap_or(values.len());
        if end - i >= PLATEAU {
            plateaus.push((i, end));
        }
        i = end.max(i + 1);
    }
    let runs_on = |&(first, end): &(usize, usize)| {
        if end - first >= long {
            return true;
        }
        let below = |levels: f64, from: usize| {
            (0..from).rev().find(|&i| values[i].is_finite() && extreme - side * values[i] > levels * REACH * noise)
        };
        let Some(near) = below(1.0, first) else { return false };
        let Some(far) = below(2.0, near) else { return false };
        let (before, behind) = ((near - far) as f64, (first - near) as f64);
        let beyond = REACH / before * (end - first) as f64 / 2.0;
        behind + before >= 3.0 && behind <= SLOWER * before && beyond >= BEYOND
    };
    let hits = plateaus.iter().filter(|p| runs_on(p)).count();
    if hits < 2 || hits * 2 < plateaus.len() {
        return Vec::new();
    }
    // every sample at that value, also those that the noise let dip below it in between
    (0..values.len()).filter(|&i| at(i)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    fn wave(rows: usize, noise: f64, coarse: f64) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        (0..rows)
            .map(|i| {
                let y = 3.0 + 1.5 * (i as f64 * 0.01).sin() + noise * (rng.random::<f64>() - 0.5) * 3.4;
                if coarse > 0.0 { (y / coarse).round() * coarse } else { y }
            })
            .collect()
    }

    #[test]
    fn a_clipped_wave_is_found_and_a_smooth_one_is_not_whatever_its_steps() {
        for (noise, coarse) in [(0.006, 0.0), (0.006, 0.02), (0.0, 0.02), (0.0, 0.1), (0.02, 0.005)] {
            let values = wave(20_000, noise, coarse);
            assert!(clipped(&values, 1.0, noise.max(coarse), usize::MAX).is_empty(), "{noise} {coarse}");
            let cut: Vec<f64> = values.iter().map(|v| v.min(4.0)).collect();
            assert!(clipped(&cut, 1.0, noise.max(coarse), usize::MAX).len() > 3000, "{noise} {coarse}");
            assert!(clipped(&cut, -1.0, noise.max(coarse), usize::MAX).is_empty(), "{noise} {coarse}");
        }
    }

    #[test]
    fn noise_free_rests_at_the_extreme_are_not_clipped() {
        // a pump that holds its pressure: it comes near slowly
        let values: Vec<f64> = (0..20_000)
            .map(|i| {
                let t = (i % 4000) as f64 * 1e-3;
                ((3.0 + (1.0 - (-t * 3.0).exp())) / 0.02).round() * 0.02
            })
            .collect();
        assert!(clipped(&values, 1.0, 0.02, usize::MAX).is_empty());
    }
}
