//! Walls that remember: what the force sensor shows at a clamped angle depends on the way on which the lever was led there.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use identify::layout::Layout;
use identify::predict::predict;
use identify::prepare::{Channel, Stretch, stretches};
use model::Parameters;
use model::effects::{EffectSet, find};
use model::integrate::Integrator;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use recordings::{Plane, Protocol, Recording};

const STEP_S: f64 = 0.01;
/// Hysteresis: Nm, rad.
const WALLS: [f64; 2] = [0.6, 0.08];

/// A lever that is led from dwell to dwell of a torque map, once beyond the angle and back.
fn torque_map(truth: &Parameters) -> Recording {
    let effects = EffectSet::new(STATES, [(find("elastic_hysteresis").unwrap(), WALLS.to_vec())]);
    let k = truth.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    x[state::ANGLE] = (-20f64).to_radians();
    x[state::PRESSURE1] = 2.6;
    x[state::PRESSURE2] = 2.6;
    // seconds, degrees a second, voltage, clamped
    let plan = [
        (1.0, 0.0, 1.5, true),
        (1.0, 0.0, -1.5, true),
        (2.0, 6.0, 0.0, false),
        (1.0, 0.0, 1.5, true),
        (2.0, 6.0, 0.0, false),
        (0.5, -5.0, 0.0, false),
        (1.0, 0.0, -1.5, true),
    ];
    let mut r = Recording::default();
    let integrator = Integrator::new(1e-3);
    let mut dx = x.clone();
    for (segment, (seconds, rate_deg_s, voltage_v, clamped)) in plan.into_iter().enumerate() {
        let input = Input {
            voltage_v,
            brake_open: true,
            bypass_open: !clamped,
            vertical: false,
            lever: Lever::Led { velocity_rad_s: f64::to_radians(rate_deg_s) },
            circuit: Circuit::Pump,
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

/// Largest error of the predicted torques, Nm.
fn torque_error(truth: &Parameters, stretches: &[Stretch]) -> f64 {
    let layout = Layout::base(truth).with(find("elastic_hysteresis").unwrap());
    let mut theta = layout.vector_of(truth);
    theta.extend(WALLS);
    let errors = stretches.iter().flat_map(|s| {
        let shown = predict(s, &layout, &theta, &[0.0; 3]).unwrap();
        let torques = s.targets.iter().zip(shown).filter(|(t, _)| t.channel == Channel::Torque);
        torques.map(|(t, y)| (t.measured - y).abs()).collect::<Vec<_>>()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_torque_map_is_predicted_from_the_way_between_its_angles() {
    let truth = Parameters::example();
    let mut cut = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &torque_map(&truth)).unwrap();
    assert_eq!(cut.len(), 3, "a stretch an angle");
    let turns: Vec<usize> = cut.iter().map(|s| s.way_rad.len()).collect();
    assert_eq!(turns, [2, 2, 3], "the last dwell lies behind a reversal");
    // what is left is the mean of the first 50 ms as the initial pressure, which no fit has refined here
    assert!(torque_error(&truth, &cut) < 0.1 * WALLS[0], "{}", torque_error(&truth, &cut));
    cut.iter_mut().for_each(|s| s.way_rad.clear());
    assert!(torque_error(&truth, &cut) > 0.9 * WALLS[0], "without the way they would seem fresh");
}

#[test]
fn a_dwell_without_an_angle_is_passed_over_and_a_map_without_any_is_refused() {
    let truth = Parameters::example();
    let mut silent = torque_map(&truth);
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
