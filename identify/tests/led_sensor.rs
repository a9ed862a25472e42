//! A lever that is led: its angle is an input, and what is known of it is what a sensor with errors shows.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use identify::layout::Layout;
use identify::predict::{linearise, predict};
use identify::prepare::{Channel, Stretch, stretches};
use model::Parameters;
use model::effects::empirical::EMPIRICAL;
use model::effects::{Effect, EffectSet, find};
use model::integrate::Integrator;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use recordings::{Plane, Protocol, Recording};

const STEP_S: f64 = 0.01;
/// The lever is led from then on.
const BEGINS_S: f64 = 0.5;
/// Terms of the sensor and their sizes: a gain, a bend, a memory of 20 ms.
const ERRORS: [(&str, f64); 3] = [("angle_gain", 0.06), ("angle_cubic", -1.5), ("angle_past", 0.2)];

fn sensor() -> (&'static dyn Effect, Vec<f64>) {
    let effect = *EMPIRICAL.iter().find(|e| e.header().id == "empirical_sensor").unwrap();
    let size = |name: &str| ERRORS.iter().find(|(term, _)| *term == name).map_or(0.0, |(_, size)| *size);
    let values: Vec<f64> = effect.header().parameters.iter().map(|p| size(p.name)).collect();
    assert_eq!(values.iter().filter(|v| **v != 0.0).count(), ERRORS.len());
    (effect, values)
}

/// A sweep with both chambers shut off, as this sensor shows it.
fn sweep(truth: &Parameters, sensor: (&'static dyn Effect, Vec<f64>)) -> Vec<Stretch> {
    let effects = EffectSet::new(STATES, [sensor]);
    let k = truth.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    (x[state::ANGLE], x[state::PRESSURE1], x[state::PRESSURE2]) = ((-30f64).to_radians(), 2.6, 2.6);
    let input = |rate_deg_s: f64| Input {
        voltage_v: 0.0,
        brake_open: false,
        bypass_open: false,
        vertical: false,
        lever: Lever::Led { velocity_rad_s: rate_deg_s.to_radians() },
        circuit: Circuit::ShutOff { release_ml_s: 0.0 },
    };
    rec::rest_states(&input(0.0), &k, &effects, &mut x);
    let mut scratch = x.clone();
    let mut r = Recording::default();
    let integrator = Integrator::new(1e-3);
    for row in 0..1000 {
        let t = row as f64 * STEP_S;
        let shown = rec::shown(&effects, t, &x, &mut scratch);
        r.time_s.push(t);
        r.voltage_v.push(0.0);
        r.angle_deg.push(shown[0]);
        r.pressure1_bar.push(shown[1]);
        r.pressure2_bar.push(shown[2]);
        r.torque_nm.push(f64::NAN);
        r.volume_ml.push(if row == 0 { 0.0 } else { f64::NAN });
        r.brake_open.push(false);
        r.bypass_open.push(false);
        r.segment.push(0);
        let rate_deg_s = if t < BEGINS_S { 0.0 } else { 6.0 };
        integrator.advance(&input(rate_deg_s), &k, &effects, t, STEP_S, &mut x).unwrap();
    }
    stretches(0, "v.csv", Protocol::VolumeMap, Plane::Horizontal, &r).unwrap()
}

/// Largest error of the predicted pressures, bar.
fn pressure_error(layout: &Layout, theta: &[f64], stretches: &[Stretch]) -> f64 {
    let errors = stretches.iter().flat_map(|s| {
        let shown = predict(s, layout, theta, &[0.0; 3]).unwrap();
        let pressures = s.targets.iter().zip(shown);
        let pressures = pressures.filter(|(t, _)| [Channel::Pressure1, Channel::Pressure2].contains(&t.channel));
        pressures.map(|(t, y)| (t.measured - y).abs()).collect::<Vec<_>>()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn what_moves_the_oil_is_the_true_angle() {
    let truth = Parameters::example();
    let (effect, values) = sensor();
    let cut = sweep(&truth, (effect, values.clone()));
    assert_eq!(cut.len(), 1);
    let layout = Layout::base(&truth).with(effect);
    let base = layout.vector_of(&truth);
    let with = |values: &[f64]| base.iter().chain(values).copied().collect::<Vec<f64>>();
    let unaware = pressure_error(&layout, &with(&vec![0.0; values.len()]), &cut);
    let aware = pressure_error(&layout, &with(&values), &cut);
    assert!(unaware > 0.05, "the errors matter: {unaware}");
    assert!(aware < 0.02 * unaware, "{aware} bar of {unaware} are left");
}

#[test]
fn derivatives_by_the_sensor_s_errors_are_those_of_finite_differences() {
    let truth = Parameters::example();
    let (effect, values) = sensor();
    let cut = sweep(&truth, (effect, values.clone())).remove(0);
    let layout = Layout::base(&truth).with(effect);
    let mut theta = layout.vector_of(&truth);
    let first = theta.len();
    theta.extend(&values);
    let linear = linearise(&cut, &layout, &theta, &[0.0; 3]).unwrap();
    let columns = layout.len() + 3;
    for (c, parameter) in (first..).zip(effect.header().parameters).filter(|(_, p)| p.name.starts_with("angle")) {
        let step = 0.1 * parameter.typical;
        let side = |sign: f64| {
            let mut moved = theta.clone();
            moved[c] += sign * step;
            predict(&cut, &layout, &moved, &[0.0; 3]).unwrap()
        };
        let (up, down) = (side(1.0), side(-1.0));
        let expected: Vec<f64> = up.iter().zip(&down).map(|(u, d)| (u - d) / (2.0 * step)).collect();
        let most = expected.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        // a block's derivative is that of its middle row, which says little of the block in which the sweep begins
        let steady = |n: usize| (cut.targets[n].time_s - BEGINS_S).abs() > 0.1;
        for (n, e) in expected.iter().enumerate().filter(|(n, _)| steady(*n)) {
            let got = linear.slope[n * columns + c];
            assert!((got - e).abs() <= 0.03 * most, "{} at target {n}: {got} for {e}", parameter.name);
        }
    }
}

/// Releases of 1 ml from chamber 1 of a clamped lever, as pressure sensors show them that take `late_s` seconds.
fn releases(truth: &Parameters, late_s: f64) -> Vec<Stretch> {
    let lag = find("pressure_lag").unwrap();
    let effects = EffectSet::new(STATES, [(lag, vec![late_s; 2])]);
    let k = truth.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    (x[state::PRESSURE1], x[state::PRESSURE2]) = (5.0, 2.8);
    let input = |release_ml_s: f64| Input {
        voltage_v: 0.0,
        brake_open: false,
        bypass_open: false,
        vertical: false,
        lever: Lever::Led { velocity_rad_s: 0.0 },
        circuit: Circuit::ShutOff { release_ml_s },
    };
    rec::rest_states(&input(0.0), &k, &effects, &mut x);
    let mut scratch = x.clone();
    let mut r = Recording::default();
    let integrator = Integrator::new(1e-3);
    for row in 0..1200 {
        let (t, step) = (row as f64 * STEP_S, row / 200);
        let releasing = step > 0 && row % 200 < 30;
        let shown = rec::shown(&effects, t, &x, &mut scratch);
        r.time_s.push(t);
        r.voltage_v.push(0.0);
        r.angle_deg.push(shown[0]);
        r.pressure1_bar.push(shown[1]);
        r.pressure2_bar.push(shown[2]);
        r.torque_nm.push(f64::NAN);
        r.volume_ml.push(if releasing { f64::NAN } else { x[state::VOLUME] });
        r.brake_open.push(false);
        r.bypass_open.push(false);
        r.segment.push(step);
        integrator.advance(&input(if releasing { 1.0 / 0.3 } else { 0.0 }), &k, &effects, t, STEP_S, &mut x).unwrap();
    }
    stretches(0, "c.csv", Protocol::ClampSteps, Plane::Horizontal, &r).unwrap()
}

#[test]
fn pressures_that_a_slow_sensor_shows_are_inputs_all_the_same() {
    let truth = Parameters::example();
    let layout = Layout::base(&truth).with(find("pressure_lag").unwrap());
    for late_s in [0.0, 0.02, 0.06] {
        let mut theta = layout.vector_of(&truth);
        theta.extend([late_s; 2]);
        let cut = releases(&truth, late_s);
        assert!(!cut.is_empty());
        for s in &cut {
            let volumes = s.targets.iter().zip(predict(s, &layout, &theta, &[0.0; 3]).unwrap());
            let volumes: Vec<(f64, f64)> =
                volumes.filter(|(t, _)| t.channel == Channel::Volume).map(|(t, y)| (t.measured, y)).collect();
            assert!(volumes.iter().any(|(measured, _)| *measured > 3.0), "{volumes:?}");
            assert!(volumes.iter().all(|(measured, y)| (measured - y).abs() < 0.05), "{late_s}: {volumes:?}");
        }
    }
}
