//! Walls that remember: what the sensors show at a clamped angle depends on the way on which the lever was led there, and on the pressures until then.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use identify::layout::Layout;
use identify::predict::{linearise, predict, predict_rows};
use identify::prepare::{Channel, Stretch, stretches};
use model::Parameters;
use model::effects::{EffectSet, find};
use model::integrate::Integrator;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use recordings::{Plane, Protocol, Recording};

const STEP_S: f64 = 0.01;
/// Id and values of an effect.
type Walls = (&'static str, &'static [f64]);
/// Nm, rad.
const HYSTERESIS: Walls = ("elastic_hysteresis", &[0.6, 0.08]);
/// ml/bar, s. It settles over several dwells.
const CREEP: Walls = ("wall_creep", &[1.5, 3.0]);

/// A part of a torque map: seconds, degrees a second, voltage, clamped.
type Part = (f64, f64, f64, bool);

/// A lever that is led from dwell to dwell of a torque map, once beyond the angle and back.
fn torque_map(truth: &Parameters, walls: Walls) -> Recording {
    let plan = [
        (1.0, 0.0, 1.5, true),
        (1.0, 0.0, -1.5, true),
        (2.0, 6.0, 0.0, false),
        (1.0, 0.0, 1.5, true),
        (2.0, 6.0, 0.0, false),
        (0.5, -5.0, 0.0, false),
        (1.0, 0.0, -1.5, true),
    ];
    torque_map_of(truth, walls, &plan)
}

/// A torque map of these parts.
fn torque_map_of(truth: &Parameters, (id, values): Walls, plan: &[Part]) -> Recording {
    let effects = EffectSet::new(STATES, [(find(id).unwrap(), values.to_vec())]);
    let k = truth.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    x[state::ANGLE] = (-20f64).to_radians();
    x[state::PRESSURE1] = 2.6;
    x[state::PRESSURE2] = 2.6;
    let input = Input {
        voltage_v: 0.0,
        brake_open: true,
        bypass_open: true,
        vertical: false,
        lever: Lever::Led { velocity_rad_s: 0.0 },
        circuit: Circuit::Pump,
    };
    rec::rest_states(&input, &k, &effects, &mut x);
    let mut r = Recording::default();
    let integrator = Integrator::new(1e-3);
    let mut dx = x.clone();
    for (segment, (seconds, rate_deg_s, voltage_v, clamped)) in plan.iter().copied().enumerate() {
        let input = Input {
            voltage_v,
            bypass_open: !clamped,
            lever: Lever::Led { velocity_rad_s: f64::to_radians(rate_deg_s) },
            ..input
        };
        for _ in 0..(seconds / STEP_S) as usize {
            let t = r.time_s.len() as f64 * STEP_S;
            let torque = rec::derivative(&input, &k, &effects, t, &x, &mut dx).torque_nm;
            r.time_s.push(t);
            r.voltage_v.push(voltage_v);
            r.angle_deg.push(x[state::ANGLE].to_degrees());
            r.pressure1_bar.push(x[state::PRESSURE1]);
            r.pressure2_bar.push(x[state::PRESSURE2]);
            r.torque_nm.push(if clamped { torque } else { f64::NAN });
            r.volume_ml.push(f64::NAN);
            r.brake_open.push(true);
            r.bypass_open.push(!clamped);
            r.segment.push(segment as i64);
            integrator.advance(&input, &k, &effects, t, STEP_S, &mut x).unwrap();
        }
    }
    r
}

fn model(truth: &Parameters, (id, values): Walls) -> (Layout, Vec<f64>) {
    let layout = Layout::base(truth).with(find(id).unwrap());
    let mut theta = layout.vector_of(truth);
    theta.extend(values);
    (layout, theta)
}

/// Largest error of what is predicted of a channel, in its unit.
fn largest_error(truth: &Parameters, walls: Walls, stretches: &[Stretch], channel: Channel) -> f64 {
    let (layout, theta) = model(truth, walls);
    let errors = stretches.iter().flat_map(|s| {
        let shown = predict(s, &layout, &theta, &[0.0; 3]).unwrap();
        let own = s.targets.iter().zip(shown).filter(|(t, _)| t.channel == channel);
        own.map(|(t, y)| (t.measured - y).abs()).collect::<Vec<_>>()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_torque_map_is_predicted_from_the_way_between_its_angles() {
    let truth = Parameters::example();
    let mut cut =
        stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &torque_map(&truth, HYSTERESIS)).unwrap();
    assert_eq!(cut.len(), 3, "a stretch an angle");
    let turns: Vec<usize> = cut.iter().map(|s| s.way_rad.len()).collect();
    assert_eq!(turns, [2, 2, 3], "the last dwell lies behind a reversal");
    // what is left is the mean of the first 50 ms as the initial pressure, which no fit has refined here
    let error = |cut: &[Stretch]| largest_error(&truth, HYSTERESIS, cut, Channel::Torque) / HYSTERESIS.1[0];
    assert!(error(&cut) < 0.1, "{}", error(&cut));
    cut.iter_mut().for_each(|s| s.way_rad.clear());
    assert!(error(&cut) > 0.9, "without the way they would seem fresh");
}

#[test]
fn a_torque_map_is_predicted_from_the_pressures_between_its_angles() {
    let truth = Parameters::example();
    let map = torque_map(&truth, CREEP);
    let mut cut = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &map).unwrap();
    assert!(cut[0].past.is_none() && cut[1..].iter().all(|s| s.past.is_some()), "before the first nothing is known");
    let error = |cut: &[Stretch]| largest_error(&truth, CREEP, cut, Channel::Pressure1);
    let with = error(&cut);
    cut.iter_mut().for_each(|s| s.past = None);
    // the rest is the mean of the first 50 ms as the initial pressure, as above
    assert!(with < 0.3 * error(&cut), "{with} bar, and {} where the walls would seem settled", error(&cut));
    // a pause of which nothing was recorded
    let mut paused = map;
    let behind = paused.time_s.iter().position(|t| *t > 3.0).unwrap();
    paused.time_s[behind..].iter_mut().for_each(|t| *t += 5.0);
    let cut = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &paused).unwrap();
    let first = cut[1].past.as_ref().unwrap().time_s[0];
    assert!(first > 8.0, "{first} s: what was before the pause counts");
}

#[test]
fn means_of_few_rows_are_those_of_all() {
    let truth = Parameters::example();
    // those of the sensors carry the lever to a true angle that is not what is shown
    let sensors: [Walls; 2] = [("angle_offset", &[0.5]), ("pressure_lag", &[0.05, 0.02])];
    for walls in [HYSTERESIS, CREEP, ("cross_leakage", &[0.05, 0.5]), ("pump_lag", &[0.05])].into_iter().chain(sensors)
    {
        let map = torque_map_of(&truth, walls, &[(6.0, 0.0, 1.5, true), (6.0, 0.0, -1.5, true)]);
        let cut = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &map).unwrap();
        let (layout, theta) = model(&truth, walls);
        let s = &cut[0];
        let means = predict(s, &layout, &theta, &[0.0; 3]).unwrap();
        let rows = predict_rows(s, &layout, &theta, &[0.0; 3]).unwrap();
        let starts = s.targets.iter().map(|t| s.blocks.partition_point(|b| *b <= t.middle));
        for ((target, mean), block) in s.targets.iter().zip(means).zip(starts) {
            let own = &rows[s.blocks[block - 1]..s.blocks[block]];
            let of_all = own.iter().map(|y| y[target.channel.index()]).sum::<f64>() / own.len() as f64;
            // the torque has a kink where the pressures are equal: the one block that holds it errs by a third of what the noise leaves of its mean (0.03 Nm, ten
            // rows). Where the oil is still the middle is taken, which is within a hundredth of a pressure's noise
            let most = if target.channel == Channel::Torque { 3e-3 } else { 2e-5 };
            assert!((mean - of_all).abs() < most, "{}: {mean} {of_all} at {} s", walls.0, target.time_s);
        }
    }
}

#[test]
fn what_a_past_leaves_has_its_derivatives() {
    let truth = Parameters::example();
    let cut = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &torque_map(&truth, CREEP)).unwrap();
    let (layout, theta) = model(&truth, CREEP);
    let linear = linearise(&cut[2], &layout, &theta, &[0.0; 3]).unwrap();
    let columns = theta.len() + 3;
    for entry in theta.len() - 2..theta.len() {
        let step = 1e-4 * theta[entry];
        let moved = |by: f64| {
            let mut theta = theta.clone();
            theta[entry] += by;
            predict(&cut[2], &layout, &theta, &[0.0; 3]).unwrap()
        };
        let (up, down) = (moved(step), moved(-step));
        let slopes: Vec<f64> = up.iter().zip(&down).map(|(u, d)| (u - d) / (2.0 * step)).collect();
        let largest = slopes.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
        assert!(largest > 0.0);
        for (t, slope) in slopes.iter().enumerate() {
            let told = linear.slope[t * columns + entry];
            // that of a mean is taken at its middle
            assert!((told - slope).abs() < 0.02 * largest, "entry {entry}, target {t}: {told} {slope}");
        }
    }
}

#[test]
fn a_dwell_without_an_angle_is_passed_over_and_a_map_without_any_is_refused() {
    let truth = Parameters::example();
    let mut silent = torque_map(&truth, HYSTERESIS);
    let whole = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &silent).unwrap();
    let lost = &whole[1].time_s;
    let (from, to) = (lost[0], lost[lost.len() - 1]);
    for (angle, t) in silent.angle_deg.iter_mut().zip(&silent.time_s) {
        if (from..=to).contains(t) {
            *angle = f64::NAN;
        }
    }
    let left = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &silent).unwrap();
    assert_eq!(left.len(), 2, "the others stay");
    assert!(left.iter().all(|s| s.angle_rad.iter().chain(&s.initial).all(|v| v.is_finite())));
    silent.angle_deg.fill(f64::NAN);
    assert!(stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &silent).is_err());
}
