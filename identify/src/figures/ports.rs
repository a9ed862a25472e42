//! The residual in physical units: what torque and what flows the reference model lacks, read off the measured motion.
//!
//! Over windows of 0.1 s the measured angle and pressures give state and derivative; what the equations of motion and of the
//! chambers don't explain of the derivative is a torque or a flow. Beside it stands what was added to the model: what it
//! contributes along the model's own free run.

use model::effects::EffectSet;
use model::integrate::Integrator;
use model::parameters::index;
use model::rec::{self, Input, STATES, state};

use crate::figure::{Figure, Mark};
use crate::figures::{Subject, section, series};
use crate::fit::Fit;
use crate::noise::mean;
use crate::prepare::{Channel, Stand, Stretch};

/// Length of a window, s: long against the oscillation of the lever on its chambers.
const WINDOW_S: f64 = 0.1;
/// Classes of an abscissa.
const CLASSES: usize = 32;
/// Fewest windows whose mean is shown.
const LEAST_WINDOWS: usize = 8;
/// Step of the model's free run, s.
const STEP_S: f64 = 1e-3;

/// What one window says.
#[derive(Clone, Copy)]
struct Window {
    time_s: f64,
    /// rad, rad/s, bar, bar
    state: [f64; 4],
    /// Torque (Nm), flow into chamber 1 and into chamber 2 (ml/s) that the base equations lack.
    lacking: [f64; 3],
    /// The same of what was added, in the model's free run; 0 where nothing was.
    added: [f64; 3],
    /// The lever moves fast enough for its losses to be known.
    moving: bool,
}

/// An ordinate of the figures.
struct Quantity {
    id: &'static str,
    title: &'static str,
    y_label: &'static str,
    of: fn(&[f64; 3]) -> f64,
    /// Only windows in which the lever moves.
    moving: bool,
}

/// An abscissa.
type Against = (&'static str, &'static str, fn(&Window) -> f64);

const TORQUE: Quantity = Quantity {
    id: "torque",
    title: "Torque balance: lacking torque",
    y_label: "torque / Nm",
    of: |v| v[0],
    moving: true,
};
const EXCHANGE: Quantity = Quantity {
    id: "exchange",
    title: "Flow and pump balance: lacking flow from chamber 2 to chamber 1",
    y_label: "flow / ml/s",
    of: |v| 0.5 * (v[1] - v[2]),
    moving: false,
};
const SUM: Quantity = Quantity {
    id: "oil",
    title: "Flow balance: lacking flow into both chambers together",
    y_label: "flow / ml/s",
    of: |v| v[1] + v[2],
    moving: false,
};

const VELOCITY: Against = ("velocity", "velocity / rad/s", |w| w.state[1]);
const ANGLE: Against = ("angle", "angle / deg", |w| w.state[0].to_degrees());
const LOAD: Against = ("pressure", "p1 + p2 / bar", |w| w.state[2] + w.state[3]);
const DIFFERENCE: Against = ("dp", "p1 - p2 / bar", |w| w.state[2] - w.state[3]);
const TIME: Against = ("time", "time since the run's start / s", |w| w.time_s);

const SHOWN: [(Quantity, Against); 7] = [
    (TORQUE, VELOCITY),
    (TORQUE, ANGLE),
    (TORQUE, LOAD),
    (EXCHANGE, DIFFERENCE),
    (EXCHANGE, TIME),
    (SUM, LOAD),
    (SUM, TIME),
];

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let fit = subject.last();
    let stretches = subject.identified.problem.stretches.iter().enumerate().filter(|(_, s)| s.stand == Stand::Free);
    let windows: Vec<Window> = stretches.flat_map(|(n, s)| windows(s, fit, n)).collect();
    SHOWN.iter().map(|(quantity, against)| figure(subject, quantity, against, &windows)).collect()
}

fn figure(subject: &Subject, quantity: &Quantity, (what, x_label, of): &Against, windows: &[Window]) -> Figure {
    let usable: Vec<&Window> = windows.iter().filter(|w| w.moving || !quantity.moving).collect();
    let means = |value: &dyn Fn(&Window) -> f64| classes(usable.iter().map(|w| (of(w), value(w))));
    let mut figure = Figure {
        id: format!("lacking_{}_{what}", quantity.id),
        section: section::RESIDUAL.into(),
        title: format!("{} over {}", quantity.title, what),
        caption: "What the equations of the reference model leave of the measured accelerations and pressure rates, in windows of \
                  0.1 s of the fitted runs with a free lever in which nothing is switched; mean of each class. The line is what was \
                  added to the model contributes there."
            .into(),
        x_label: x_label.to_string(),
        y_label: quantity.y_label.into(),
        series: vec![series("reference model lacks", Mark::Points, 0, means(&|w| (quantity.of)(&w.lacking)))],
    };
    if subject.after().is_some() && usable.iter().any(|w| (quantity.of)(&w.added) != 0.0) {
        let added = means(&|w| (quantity.of)(&w.added));
        figure.series.push(series(
            format!("{} adds", subject.last_name().trim_start_matches("with ")),
            Mark::Line,
            0,
            added,
        ));
    }
    figure
}

/// Mean abscissa and ordinate of each class of the abscissa.
fn classes(points: impl Iterator<Item = (f64, f64)> + Clone) -> Vec<(f64, f64)> {
    let finite = points.filter(|(x, y)| x.is_finite() && y.is_finite());
    let Some((low, high)) = super::range(finite.clone().map(|p| p.0)) else { return Vec::new() };
    let width = (high - low) / CLASSES as f64;
    let mut sums = vec![(0.0, 0.0, 0usize); CLASSES];
    for (x, y) in finite {
        let n = if width > 0.0 { (((x - low) / width) as usize).min(CLASSES - 1) } else { 0 };
        sums[n].0 += x;
        sums[n].1 += y;
        sums[n].2 += 1;
    }
    let full = sums.into_iter().filter(|s| s.2 >= LEAST_WINDOWS);
    full.map(|(x, y, n)| (x / n as f64, y / n as f64)).collect()
}

/// The windows of a stretch with a free lever in which no input changes, nor did in the window before.
fn windows(s: &Stretch, fit: &Fit, n: usize) -> Vec<Window> {
    let (k, effects) = fit.layout.expand(&fit.point.theta);
    let none = EffectSet::none();
    let none_fitted = vec![0.0; s.initial.len()];
    let initial = fit.point.initial.get(n).unwrap_or(&none_fitted);
    let contributions = if effects.states > 0 || !fit.layout.effects.is_empty() {
        contributions(s, &k, &effects, initial)
    } else {
        Vec::new()
    };
    let mut out = Vec::new();
    let mut first = 0;
    let mut settled = false;
    while first < s.rows() {
        let end = first + s.time_s[first..].partition_point(|t| *t < s.time_s[first] + WINDOW_S);
        let steady = (first..end).all(|i| same_input(s, first, i));
        let same_as_before = first > 0 && same_input(s, first - 1, first);
        if steady && same_as_before && settled && end - first >= 8 {
            let slope_of = |c: Channel| parabola(&s.time_s[first..end], &s.measured[c.index()][first..end]);
            if let (Some(angle), Some(p1), Some(p2)) =
                (slope_of(Channel::Angle), slope_of(Channel::Pressure1), slope_of(Channel::Pressure2))
            {
                let state = [angle[0].to_radians(), angle[1].to_radians(), p1[0], p2[0]];
                let rate = [angle[2].to_radians(), p1[1], p2[1]];
                let input = s.input(first, WINDOW_S);
                let mut x = [0.0; STATES];
                x[..4].copy_from_slice(&state);
                let base = balances(&input, &k, &none, s.time_s[first], &x);
                let capacity = rec::capacity(&k, state[0], [state[2], state[3]]);
                let per_unit = [k[index::J], capacity[0], capacity[1]];
                let added = std::array::from_fn(|j| {
                    let rows = contributions.get(first..end).unwrap_or_default();
                    if rows.is_empty() { 0.0 } else { per_unit[j] * mean(rows.iter().map(|r| r[j])).0 }
                });
                out.push(Window {
                    time_s: 0.5 * (s.time_s[first] + s.time_s[end - 1]),
                    state,
                    lacking: std::array::from_fn(|j| per_unit[j] * (rate[j] - base[j])),
                    added,
                    moving: state[1].abs() > 2.0 * k[index::A],
                });
            }
        }
        settled = steady;
        first = end;
    }
    out
}

fn same_input(s: &Stretch, i: usize, j: usize) -> bool {
    s.voltage_v[i] == s.voltage_v[j] && s.brake_open[i] == s.brake_open[j] && s.bypass_open[i] == s.bypass_open[j]
}

/// Acceleration (rad/s2) and pressure rates (bar/s) by the equations.
fn balances(input: &Input, k: &[f64], effects: &EffectSet<f64>, t: f64, x: &[f64]) -> [f64; 3] {
    let mut dx = vec![0.0; x.len()];
    rec::derivative(input, k, effects, t, x, &mut dx);
    [dx[state::VELOCITY], dx[state::PRESSURE1], dx[state::PRESSURE2]]
}

/// What the effects contribute to acceleration and pressure rates at each row of the model's free run; as far as it goes.
fn contributions(s: &Stretch, k: &[f64], effects: &EffectSet<f64>, initial: &[f64]) -> Vec<[f64; 3]> {
    let none = EffectSet::none();
    let mut x = vec![0.0; STATES + effects.states];
    x[state::ANGLE] = s.initial[0] + initial[0];
    x[state::PRESSURE1] = s.initial[1] + initial[1];
    x[state::PRESSURE2] = s.initial[2] + initial[2];
    let start = s.input(0, STEP_S);
    rec::rest_states(&start, k, effects, &mut x);
    let integrator = Integrator::for_plant(STEP_S, k, effects, &[start], &x);
    let mut out = Vec::with_capacity(s.rows());
    for i in 0..s.rows() {
        let dt = if i + 1 < s.rows() { s.time_s[i + 1] - s.time_s[i] } else { STEP_S };
        let input = s.input(i, dt);
        let with = balances(&input, k, effects, s.time_s[i], &x);
        let without = balances(&input, k, &none, s.time_s[i], &x[..STATES]);
        out.push(std::array::from_fn(|j| with[j] - without[j]));
        if integrator.advance(&input, k, effects, s.time_s[i], dt, &mut x).is_err() {
            break;
        }
    }
    out
}

/// Value, first and second derivative in the window's middle, by least squares; `None` with fewer than half the samples.
fn parabola(time_s: &[f64], values: &[f64]) -> Option<[f64; 3]> {
    let middle = 0.5 * (time_s[0] + time_s[time_s.len() - 1]);
    let half = 0.5 * (time_s[time_s.len() - 1] - time_s[0]);
    let mut m = nalgebra::Matrix3::<f64>::zeros();
    let mut v = nalgebra::Vector3::<f64>::zeros();
    let mut n = 0;
    for (t, y) in time_s.iter().zip(values).filter(|(_, y)| y.is_finite()) {
        let u = (t - middle) / half;
        let row = nalgebra::Vector3::new(1.0, u, u * u);
        m += row * row.transpose();
        v += row * *y;
        n += 1;
    }
    if 2 * n < values.len() || n < 6 {
        return None;
    }
    let c = m.cholesky()?.solve(&v);
    Some([c[0], c[1] / half, 2.0 * c[2] / (half * half)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_gives_its_own_derivatives() {
        let time: Vec<f64> = (0..100).map(|i| 3.0 + f64::from(i) * 1e-3).collect();
        let middle = 0.5 * (time[0] + time[99]);
        let mut values: Vec<f64> =
            time.iter().map(|t| 1.0 + 2.0 * (t - middle) - 30.0 * (t - middle).powi(2)).collect();
        values[7] = f64::NAN;
        let found = parabola(&time, &values).unwrap();
        for (f, expected) in found.iter().zip([1.0, 2.0, -60.0]) {
            assert!((f - expected).abs() < 1e-6, "{found:?}");
        }
        assert!(parabola(&time, &[f64::NAN; 100]).is_none());
    }

    #[test]
    fn classes_are_means_and_small_ones_are_left_out() {
        let points: Vec<(f64, f64)> = (0..400).map(|i| (f64::from(i % 40), f64::from(i % 40) * 2.0)).collect();
        let mut with_stray = points.clone();
        with_stray.push((100.0, 5.0));
        assert!(classes(points.iter().copied()).iter().all(|(x, y)| (y - 2.0 * x).abs() < 1e-9));
        assert!(classes(with_stray.iter().copied()).iter().all(|p| p.0 < 50.0));
        assert!(classes(std::iter::empty()).is_empty());
    }
}
