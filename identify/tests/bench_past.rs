//! A pump on its bench that is late, or whose line holds oil with inertia: a point of the map begins with what the point before has left.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use identify::layout::Layout;
use identify::predict::{linearise, predict};
use identify::prepare::{Channel, Stretch, stretches};
use model::Parameters;
use model::effects::{Effect, EffectSet, find};
use model::integrate::Integrator;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use recordings::{Plane, Protocol, Recording};

const STEP_S: f64 = 0.005;
/// Id and values of an effect.
type Memory = (&'static str, &'static [f64]);
/// s.
const LATE: Memory = ("pump_lag", &[0.06]);
/// bar s2/ml.
const INERT: Memory = ("line_inertance", &[0.5]);

/// A pump that is started at the first point and runs on from point to point, V and bar at its first port.
fn pump_map(truth: &Parameters, (id, values): Memory, points: &[(f64, f64)]) -> Recording {
    pump_map_of(truth, find(id).unwrap(), values, points)
}

fn pump_map_of(truth: &Parameters, effect: &'static dyn Effect, values: &[f64], points: &[(f64, f64)]) -> Recording {
    let effects = EffectSet::new(STATES, [(effect, values.to_vec())]);
    let k = truth.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    let input = Input {
        voltage_v: 0.0,
        brake_open: true,
        bypass_open: false,
        vertical: false,
        lever: Lever::Led { velocity_rad_s: 0.0 },
        circuit: Circuit::Bench,
    };
    x[state::PRESSURE1..=state::PRESSURE2].fill(1.5);
    rec::rest_states(&input, &k, &effects, &mut x);
    let mut r = Recording::default();
    let integrator = Integrator::new(1e-3);
    for (segment, (voltage_v, pressure1_bar)) in points.iter().copied().enumerate() {
        x[state::VOLUME] = 0.0;
        x[state::PRESSURE1] = pressure1_bar;
        let input = Input { voltage_v, ..input };
        for tick in 0..(1.5 / STEP_S) as usize {
            let t = r.time_s.len() as f64 * STEP_S;
            r.time_s.push(t);
            r.voltage_v.push(voltage_v);
            r.angle_deg.push(f64::NAN);
            r.pressure1_bar.push(x[state::PRESSURE1]);
            r.pressure2_bar.push(x[state::PRESSURE2]);
            r.torque_nm.push(f64::NAN);
            r.volume_ml.push(if tick % 40 == 20 { x[state::VOLUME] } else { f64::NAN });
            r.brake_open.push(true);
            r.bypass_open.push(false);
            r.segment.push(segment as i64);
            integrator.advance(&input, &k, &effects, t, STEP_S, &mut x).unwrap();
        }
    }
    r
}

const POINTS: [(f64, f64); 5] = [(4.0, 1.5), (12.0, 1.5), (24.0, 1.5), (-24.0, 1.5), (-24.0, 4.0)];

fn cut(r: &Recording) -> Vec<Stretch> {
    stretches(0, "pump_map.csv", Protocol::PumpMap, Plane::Horizontal, r).unwrap()
}

fn model(truth: &Parameters, (id, values): Memory) -> (Layout, Vec<f64>) {
    let layout = Layout::base(truth).with(find(id).unwrap());
    let mut theta = layout.vector_of(truth);
    theta.extend(values);
    (layout, theta)
}

/// Largest error of a predicted volume, ml.
fn largest_error_ml(truth: &Parameters, memory: Memory, stretches: &[Stretch]) -> f64 {
    let (layout, theta) = model(truth, memory);
    let errors = stretches.iter().flat_map(|s| {
        let shown = predict(s, &layout, &theta, &[0.0; 3]).unwrap();
        let own = s.targets.iter().zip(shown).filter(|(t, _)| t.channel == Channel::Volume);
        own.map(|(t, y)| (t.measured - y).abs()).collect::<Vec<_>>()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_point_begins_with_what_the_one_before_has_left() {
    let truth = Parameters::example();
    for memory in [LATE, INERT] {
        let mut cut = cut(&pump_map(&truth, memory, &POINTS));
        assert!(
            cut[0].past.is_none() && cut[1..].iter().all(|s| s.past.is_some()),
            "before the first nothing is known"
        );
        let with = largest_error_ml(&truth, memory, &cut);
        cut.iter_mut().for_each(|s| s.past = None);
        let without = largest_error_ml(&truth, memory, &cut);
        assert!(with < 0.002 && without > 0.1, "{memory:?}: {with} ml, and {without} from standstill");
    }
}

/// Largest error of a predicted volume, ml, where the pump warms by its general form.
fn largest_error_of_a_warming_pump_ml(truth: &Parameters, stretches: &[Stretch], values: &[f64]) -> f64 {
    let layout = Layout::base(truth).with(find("pump_warming").unwrap().refined().unwrap().effect);
    let theta = [layout.vector_of(truth), values.to_vec()].concat();
    let errors = stretches.iter().flat_map(|s| {
        let shown = predict(s, &layout, &theta, &[0.0; 3]).unwrap();
        s.targets.iter().zip(shown).map(|(t, y)| (t.measured - y).abs()).collect::<Vec<_>>()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_point_begins_as_warm_as_all_points_before_have_left_the_pump() {
    let (truth, values) = (Parameters::example(), [2.0, 40.0, 0.0, 1.0, 0.0]);
    let general = find("pump_warming").unwrap().refined().unwrap().effect;
    // far longer than the seconds that motor and line remember
    let mut cut = cut(&pump_map_of(&truth, general, &values, &POINTS.repeat(3)));
    let with = largest_error_of_a_warming_pump_ml(&truth, &cut, &values);
    for s in &mut cut {
        s.ran.clear();
        s.past.iter_mut().for_each(|past| past.ran.clear());
    }
    let without = largest_error_of_a_warming_pump_ml(&truth, &cut, &values);
    assert!(with < 1e-6 && without > 0.1, "{with} ml, and {without} from cold");
}

#[test]
fn without_a_memory_a_past_says_nothing() {
    let truth = Parameters::example();
    let memory = ("pump_asymmetry", &[0.1, 0.2, 0.01][..]);
    let mut cut = cut(&pump_map(&truth, memory, &POINTS));
    let with = largest_error_ml(&truth, memory, &cut);
    cut.iter_mut().for_each(|s| s.past = None);
    assert_eq!(with, largest_error_ml(&truth, memory, &cut));
}

#[test]
fn after_a_pause_of_which_nothing_was_recorded_a_pump_starts_from_standstill() {
    let truth = Parameters::example();
    let mut paused = pump_map(&truth, LATE, &POINTS);
    let third = paused.segment.iter().position(|s| *s == 2).unwrap();
    paused.time_s[third..].iter_mut().for_each(|t| *t += 5.0);
    let cut = cut(&paused);
    let known: Vec<bool> = cut.iter().map(|s| s.past.is_some()).collect();
    assert_eq!(known, [false, true, false, true, true]);
}

#[test]
fn what_a_point_before_leaves_has_its_derivatives() {
    let truth = Parameters::example();
    for memory in [LATE, INERT] {
        let cut = cut(&pump_map(&truth, memory, &POINTS));
        let (layout, theta) = model(&truth, memory);
        let columns = theta.len() + 3;
        let entry = theta.len() - 1;
        for s in &cut {
            let linear = linearise(s, &layout, &theta, &[0.0; 3]).unwrap();
            let step = 1e-4 * theta[entry];
            let moved = |by: f64| {
                let mut theta = theta.clone();
                theta[entry] += by;
                predict(s, &layout, &theta, &[0.0; 3]).unwrap()
            };
            let moved = moved(step).into_iter().zip(moved(-step));
            let slopes: Vec<f64> = moved.map(|(up, down)| (up - down) / (2.0 * step)).collect();
            let largest = slopes.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
            for (t, slope) in slopes.iter().enumerate() {
                let told = linear.slope[t * columns + entry];
                // a motor that reverses passes a step of the flow, which the derivatives do not follow
                assert!((told - slope).abs() < 0.07 * largest + 1e-3, "{memory:?}, target {t}: {told} {slope}");
            }
        }
    }
}

/// A campaign whose pressures are stepped up point by point and let go at once offers a slow sensor as well as any other effect.
#[test]
fn pressures_that_jump_between_points_do_not_keep_a_slow_sensor_from_being_tried() {
    let truth = Parameters::example();
    let points = [(12.0, 1.5), (12.0, 4.5), (18.0, 1.5), (18.0, 4.5), (-12.0, 1.5)];
    let cut = cut(&pump_map(&truth, LATE, &points));
    let (alone, mut theta) = model(&truth, LATE);
    let volumes = |layout: &Layout, theta: &[f64]| -> Vec<f64> {
        cut.iter().flat_map(|s| predict(s, layout, theta, &[0.0; 3]).unwrap()).collect()
    };
    let expected = volumes(&alone, &theta);
    let slow = alone.with(find("pressure_lag").unwrap());
    theta.extend([0.5, 0.05]);
    for (got, expected) in volumes(&slow, &theta).into_iter().zip(expected) {
        assert!((got - expected).abs() < 1e-6, "{got} ml, expected {expected}");
    }
    for s in &cut {
        assert!(linearise(s, &slow, &theta, &[0.0; 3]).unwrap().slope.iter().all(|v| v.is_finite()));
    }
}
