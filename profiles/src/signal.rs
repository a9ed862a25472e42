//! Waves over time, ready to play: value and exact rate at any tick, whatever ticks were looked at before.

use crate::table::{Interpolation, Table};
use rt_core::PERIOD_NS;
use serde::Deserialize;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Ticks of the loop a second.
pub(crate) const TICKS_PER_S: f64 = 1e9 / PERIOD_NS as f64;

/// Value of a wave at a tick, and its rate of change (from there on, where it has a kink).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Point {
    pub value: f64,
    pub rate_per_s: f64,
}

/// How a chirp's frequency goes from one end to the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Sweep {
    Linear,
    Logarithmic,
}

/// How fast a ramp goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Pace {
    RatePerS(f64),
    Ticks(u64),
}

/// A wave. Where it has an end, its last value stays.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Signal {
    Constant(f64),
    Ramp {
        /// `None`: from where things stand when it begins.
        from: Option<f64>,
        to: f64,
        pace: Pace,
    },
    Sine {
        mean: f64,
        amplitude: f64,
        frequency_hz: f64,
        phase_rad: f64,
    },
    Chirp {
        mean: f64,
        amplitude: f64,
        phase_rad: f64,
        from_hz: f64,
        to_hz: f64,
        sweep: Sweep,
        ticks: u64,
    },
    Multisine {
        mean: f64,
        amplitude: f64,
        /// One period with a peak of 1, tick by tick.
        period: Arc<[Point]>,
    },
    /// Constant values from a tick on; the first begins at 0.
    Steps(Arc<[(u64, f64)]>),
    Table {
        table: Arc<Table>,
        interpolation: Interpolation,
    },
}

impl Signal {
    /// The wave `elapsed` ticks after it began. `begin`: where a ramp without a start of its own sets out.
    pub fn at(&self, elapsed: u64, begin: f64) -> Point {
        let seconds = elapsed as f64 / TICKS_PER_S;
        match self {
            Signal::Constant(value) => Point { value: *value, rate_per_s: 0.0 },
            Signal::Ramp { from, to, pace } => ramp(from.unwrap_or(begin), *to, *pace, seconds),
            Signal::Sine { mean, amplitude, frequency_hz, phase_rad } => {
                oscillation(*mean, *amplitude, frequency_hz * seconds, *phase_rad, *frequency_hz)
            }
            Signal::Chirp { mean, amplitude, phase_rad, from_hz, to_hz, sweep, ticks } => {
                let end_s = *ticks as f64 / TICKS_PER_S;
                let (cycles, hz) = swept(*sweep, *from_hz, *to_hz, end_s, seconds.min(end_s));
                let point = oscillation(*mean, *amplitude, cycles, *phase_rad, hz);
                if elapsed < *ticks { point } else { Point { rate_per_s: 0.0, ..point } }
            }
            Signal::Multisine { mean, amplitude, period } => {
                let Point { value, rate_per_s } = period[(elapsed % period.len() as u64) as usize];
                Point { value: mean + amplitude * value, rate_per_s: amplitude * rate_per_s }
            }
            Signal::Steps(steps) => {
                let following = steps.partition_point(|(begins, _)| *begins <= elapsed);
                Point { value: steps[following - 1].1, rate_per_s: 0.0 }
            }
            Signal::Table { table, interpolation } => table.at(elapsed * PERIOD_NS, *interpolation),
        }
    }

    /// Smallest and largest value, at any time. A ramp's start counts where the script gives it.
    pub fn range(&self) -> (f64, f64) {
        match self {
            Signal::Constant(value) => (*value, *value),
            Signal::Ramp { from, to, .. } => (to.min(from.unwrap_or(*to)), to.max(from.unwrap_or(*to))),
            Signal::Sine { mean, amplitude, .. }
            | Signal::Chirp { mean, amplitude, .. }
            | Signal::Multisine { mean, amplitude, .. } => (mean - amplitude, mean + amplitude),
            Signal::Steps(steps) => ends(steps.iter().map(|(_, value)| *value)),
            Signal::Table { table, .. } => ends(table.rows().iter().map(|row| row.value)),
        }
    }
}

fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

fn ramp(from: f64, to: f64, pace: Pace, seconds: f64) -> Point {
    let way = to - from;
    let whole_s = match pace {
        Pace::RatePerS(rate_per_s) => way.abs() / rate_per_s,
        Pace::Ticks(ticks) => ticks as f64 / TICKS_PER_S,
    };
    if seconds >= whole_s {
        return Point { value: to, rate_per_s: 0.0 };
    }
    Point { value: from + way * (seconds / whole_s), rate_per_s: way / whole_s }
}

fn oscillation(mean: f64, amplitude: f64, cycles: f64, phase_rad: f64, hz: f64) -> Point {
    let (sin, cos) = (TAU * cycles.fract() + phase_rad).sin_cos();
    Point { value: mean + amplitude * sin, rate_per_s: amplitude * TAU * hz * cos }
}

/// Cycles so far and frequency of a chirp after `seconds` of `end_s`.
fn swept(sweep: Sweep, from_hz: f64, to_hz: f64, end_s: f64, seconds: f64) -> (f64, f64) {
    let part = seconds / end_s;
    let octaves = (to_hz / from_hz).ln();
    match sweep {
        Sweep::Logarithmic if octaves != 0.0 => {
            (from_hz * end_s * (part * octaves).exp_m1() / octaves, from_hz * (part * octaves).exp())
        }
        _ => (seconds * (from_hz + 0.5 * (to_hz - from_hz) * part), from_hz + (to_hz - from_hz) * part),
    }
}

/// One period of a multisine with a peak of 1: equal amplitudes, Schroeder's phases (M. R. Schroeder, IEEE Trans. Inf. Theory
/// 16, 1970, p. 85), which keep the peak low. Begins where the sum is nearest to 0, so that a loop which follows it is not
/// kicked.
///
/// `lines`: frequencies in whole cycles a period, each below half of `ticks`, at least one.
pub(crate) fn multisine(lines: &[u64], ticks: u64) -> Arc<[Point]> {
    let length = ticks as usize;
    let circle: Vec<(f64, f64)> = (0..length).map(|k| (TAU * k as f64 / length as f64).sin_cos()).collect();
    let mut points = vec![Point::default(); length];
    for (number, &line) in lines.iter().enumerate() {
        // The phase's factor grows with the square: reduced in whole numbers, it stays exact.
        let turns = (number as u128 * (number as u128 + 1)) % (2 * lines.len() as u128);
        let (phase_sin, phase_cos) = (-TAU * turns as f64 / (2.0 * lines.len() as f64)).sin_cos();
        let rad_per_s = TAU * line as f64 * TICKS_PER_S / length as f64;
        let mut place = 0;
        for point in &mut points {
            let (sin, cos) = circle[place];
            point.value += cos * phase_cos - sin * phase_sin;
            point.rate_per_s -= rad_per_s * (sin * phase_cos + cos * phase_sin);
            place = (place + line as usize) % length;
        }
    }
    let peak = points.iter().fold(0.0, |peak: f64, point| peak.max(point.value.abs()));
    let nearest = points.iter().enumerate().min_by(|(_, a), (_, b)| a.value.abs().total_cmp(&b.value.abs()));
    let first = nearest.map_or(0, |(place, _)| place);
    points.rotate_left(first);
    for point in &mut points {
        point.value /= peak;
        point.rate_per_s /= peak;
    }
    points.into()
}
