//! Physics of the reference model: what must hold whatever the parameters, and where the model ends.

mod common;

use common::{DEGREES, MIDDLE, RIG_STEP_S, input, run, square_wave};
use model::Parameters;
use model::effects::EffectSet;
use model::integrate::{Integrator, LEAST_PRESSURE_BAR, SimulationError};
use model::parameters::index::*;
use model::rec::{self, Circuit, Input, Lever, STATES, state::*};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn flows_into_the_chambers_balance_with_valves_in_every_state() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let k = Parameters::example().to_vector();
    for valves in 0..4 {
        for _ in 0..500 {
            let x = [
                rng.random_range(-0.7..0.7),
                rng.random_range(-3.0..3.0),
                rng.random_range(1.1..6.0),
                rng.random_range(1.1..6.0),
                0.0,
            ];
            let lever = if rng.random() { Lever::Free } else { Lever::Led { velocity_rad_s: x[VELOCITY] } };
            let input = Input {
                brake_open: valves & 1 != 0,
                bypass_open: valves & 2 != 0,
                vertical: rng.random(),
                lever,
                ..input(rng.random_range(-24.0..24.0))
            };
            let mut dx = [0.0; STATES];
            let derived = rec::derivative(&input, &k, &EffectSet::none(), 0.0, &x, &mut dx);
            let c = rec::capacity(&k, x[ANGLE], [x[PRESSURE1], x[PRESSURE2]]);
            let v = rec::displacement(&k, x[ANGLE]);
            let into1 = c[0] * dx[PRESSURE1] + v[0] * x[VELOCITY];
            let into2 = c[1] * dx[PRESSURE2] + v[1] * x[VELOCITY];
            let scale = 1.0 + (v[0] * x[VELOCITY]).abs() + derived.flow_ml_s.abs();
            assert!((into1 + into2).abs() < 1e-12 * scale, "{input:?} {x:?}: {into1} and {into2} ml/s");
            assert!((into1 - derived.flow_ml_s).abs() < 1e-12 * scale);
            if valves == 0 {
                assert_eq!(derived.flow_ml_s, 0.0, "oil passes closed valves");
            }
        }
    }
}

/// Kinetic, gravity's and elastic energy of the lossless case, J; 1 bar ml = 0.1 J.
fn energy(k: &[f64], vertical: bool, x: &[f64; STATES]) -> f64 {
    let stored = |p: f64| k[H1] * p.powf(k[H2] + 2.0) / (k[H2] + 2.0) + 0.5 * k[H3] * p * p;
    let weight = if vertical { k[G] * (1.0 - x[ANGLE].cos()) } else { 0.0 };
    0.5 * k[J] * x[VELOCITY].powi(2) + weight + 0.1 * (stored(x[PRESSURE1]) + stored(x[PRESSURE2]))
}

#[test]
fn without_losses_the_energy_stays() {
    let mut k = Parameters::example().to_vector();
    for zero in [A1, V1, M1, M2, L1, L2, L3, L4] {
        k[zero] = 0.0;
    }
    k[M3] = 0.1 * k[V2];
    let start = [0.05, 1.5, 3.0, 2.0, 0.0];
    for vertical in [false, true] {
        let drift = |step_s: f64| {
            let closed = Input { brake_open: false, vertical, ..input(0.0) };
            let path = run(step_s, 10.0, &k, &EffectSet::none(), start, |_| closed);
            let at_start = energy(&k, vertical, &path[0]);
            let kinetic = path.iter().map(|x| 0.5 * k[J] * x[VELOCITY].powi(2)).fold(0.0, f64::max);
            assert!(path.iter().any(|x| x[VELOCITY] < -0.5), "it swings");
            path.iter().map(|x| (energy(&k, vertical, x) - at_start).abs()).fold(0.0, f64::max) / kinetic
        };
        let (coarse, fine) = (drift(1e-3), drift(RIG_STEP_S));
        println!("energy drift in 10 s, share of the kinetic energy: {fine:.1e} at 0.25 ms, {coarse:.1e} at 1 ms");
        assert!(fine < 1e-7, "{fine:.1e}");
        // a fourth-order step loses energy as the fifth power of its length over a given time
        assert!(coarse > 200.0 * fine, "{coarse:.1e} at 1 ms, {fine:.1e} at 0.25 ms");
    }
}

#[test]
fn seen_from_the_other_chamber_the_motion_is_the_same() {
    let k = Parameters::example().to_vector();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let steps: Vec<Input> = (0..20)
        .map(|i| Input {
            brake_open: rng.random_bool(0.8),
            bypass_open: rng.random_bool(0.2),
            vertical: i % 2 == 0,
            ..input(rng.random_range(-15.0..15.0))
        })
        .collect();
    let at = |t: f64| steps[(t / 0.5 + 1e-9) as usize];
    let start = [0.1, -0.3, 4.0, 3.0, 0.0];
    let mirrored = |x: &[f64; STATES]| [-x[0], -x[1], x[3], x[2], x[4]];
    let one = run(RIG_STEP_S, 10.0, &k, &EffectSet::none(), start, at);
    let turned = |t: f64| Input { voltage_v: -at(t).voltage_v, ..at(t) };
    let two = run(RIG_STEP_S, 10.0, &k, &EffectSet::none(), mirrored(&start), turned);
    for (a, b) in one.iter().zip(&two) {
        for (a, b) in a.iter().zip(mirrored(b)) {
            assert!((a - b).abs() < 1e-8, "{a} and {b}");
        }
    }
}

/// Largest difference of two runs by state, as a share of the state's range.
fn difference(a: &[[f64; STATES]], b: &[[f64; STATES]]) -> [f64; 4] {
    std::array::from_fn(|i| {
        let values = || a.iter().map(|x| x[i]);
        let range = values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min);
        a.iter().zip(b).map(|(a, b)| (a[i] - b[i]).abs()).fold(0.0, f64::max) / range
    })
}

#[test]
fn half_the_step_changes_a_square_wave_by_less_than_a_millionth() {
    let k = Parameters::example().to_vector();
    for vertical in [false, true] {
        let wave = |t: f64| Input { vertical, ..input(square_wave(t)) };
        let at = |step_s: f64| run(step_s, 60.0, &k, &EffectSet::none(), MIDDLE, wave);
        let runs = [1e-3, 0.5e-3, RIG_STEP_S, 0.5 * RIG_STEP_S].map(at);
        for (i, step_ms) in [1.0, 0.5, 0.25].into_iter().enumerate() {
            println!("{step_ms} ms and half of it: {:?} of the range", difference(&runs[i], &runs[i + 1]));
        }
        let change = difference(&runs[2], &runs[3]);
        assert!(change.iter().all(|d| *d < 1e-6), "{change:?}");
    }
}

#[test]
fn in_the_dead_zone_the_pump_only_slips_and_leaves_it_without_a_jump() {
    let k = Parameters::example().to_vector();
    for dp in [-4.0, -0.7, 0.0, 1.3, 5.0] {
        for u in [-0.9, -0.3, 0.0, 0.4, 0.9] {
            assert_eq!(rec::pump_flow(&k, u, dp), (k[F3] * dp, false), "u = {u}, dp = {dp}");
        }
        for direction in [1.0, -1.0] {
            // f1 |u| + f4 + f2 u dp = 0
            let edge = direction * -k[F4] / (k[F1] + direction * k[F2] * dp);
            let (before, delivers) = rec::pump_flow(&k, edge * (1.0 - 1e-9), dp);
            assert!(!delivers);
            let (beyond, delivers) = rec::pump_flow(&k, edge * (1.0 + 1e-9), dp);
            assert!(delivers && (beyond - before).abs() < 1e-8, "{before} and {beyond} at {edge} V");
            assert!(direction * (beyond - before) > 0.0, "leaving the dead zone it drives the way of u");
            let there = rec::pump_flow(&k, 20.0 * direction, dp).0;
            let back = rec::pump_flow(&k, -20.0 * direction, -dp).0;
            assert!((there + back).abs() < 1e-14, "{there} and {back}");
        }
    }
}

#[test]
fn a_clamped_lever_stays_and_its_pump_stalls() {
    let k = Parameters::example().to_vector();
    for (angle_deg, vertical) in [(-30.0, false), (20.0, true)] {
        let clamped = Input { lever: Lever::Led { velocity_rad_s: 0.0 }, vertical, ..input(1.5) };
        let start = [angle_deg / DEGREES, 0.0, 3.0, 3.0, 0.0];
        let path = run(1e-3, 120.0, &k, &EffectSet::none(), start, |_| clamped);
        let end = path[path.len() - 1];
        assert!(path.iter().all(|x| x[ANGLE] == start[ANGLE] && x[VELOCITY] == 0.0));
        let dp = end[PRESSURE1] - end[PRESSURE2];
        let stall = (k[F1] * 1.5 + k[F4]) / -(k[F3] + k[F2] * 1.5);
        assert!((dp - stall).abs() < 1e-6, "{dp} bar, stall at {stall}");
        let mut dx = [0.0; STATES];
        let held = rec::derivative(&clamped, &k, &EffectSet::none(), 0.0, &end, &mut dx).torque_nm;
        let weight = if vertical { k[G] * end[ANGLE].sin() } else { 0.0 };
        let expected = (k[M1] * dp.abs() + k[M2]) * end[ANGLE] + k[M3] * dp - weight;
        assert!((held - expected).abs() < 1e-12, "{held} Nm, expected {expected}");
    }
}

#[test]
fn a_led_lever_goes_where_it_is_led() {
    let k = Parameters::example().to_vector();
    let led = Input {
        lever: Lever::Led { velocity_rad_s: 0.02 },
        circuit: Circuit::ShutOff { release_ml_s: 0.0 },
        ..input(20.0)
    };
    let path = run(RIG_STEP_S, 2.0, &k, &EffectSet::none(), MIDDLE, |_| led);
    let end = path[path.len() - 1];
    assert!((end[ANGLE] - 0.04).abs() < 1e-12);
    assert!(end[PRESSURE1] < 3.5 && end[PRESSURE2] > 3.5, "chamber 1 expands, chamber 2 is squeezed: {end:?}");
}

#[test]
fn pressures_stay_positive_or_the_run_stops() {
    let k = Parameters::example().to_vector();
    let integrator = Integrator::new(RIG_STEP_S);
    let clamped = Lever::Led { velocity_rad_s: 0.0 };
    let drained = Input { lever: clamped, circuit: Circuit::ShutOff { release_ml_s: 15.0 }, ..input(0.0) };
    let pumped = Input { lever: clamped, ..input(24.0) };
    let torn = Input { lever: Lever::Led { velocity_rad_s: 3.0 }, brake_open: false, ..input(0.0) };
    // (what is done, bar at first, chamber that runs empty)
    for (input, fill_bar, empty) in [(drained, 1.5, 1), (pumped, 0.05, 2), (torn, 1.5, 1)] {
        let mut x = [0.0, 0.0, fill_bar, fill_bar, 0.0];
        let mut t = 0.0;
        let error = loop {
            match integrator.advance(&input, &k, &EffectSet::none(), t, 1e-3, &mut x) {
                Ok(()) => assert!(x[PRESSURE1] > 0.0 && x[PRESSURE2] > 0.0),
                Err(error) => break error,
            }
            t += 1e-3;
            assert!(t < 60.0, "it runs on: {x:?}");
        };
        match error {
            SimulationError::Pressure { time_s, chamber, pressure_bar } => {
                assert!((time_s - t - 1e-3).abs() < 1e-9);
                assert_eq!(chamber, empty, "{input:?}");
                assert!(pressure_bar <= LEAST_PRESSURE_BAR);
            }
            other => panic!("{input:?}: {other}"),
        }
        assert!(error.to_string().contains(&format!("pressure {empty}")), "{error}");
    }
}

#[test]
fn a_chamber_emptied_within_one_step_is_an_error_too() {
    let k = Parameters::example().to_vector();
    let burst = Input { circuit: Circuit::ShutOff { release_ml_s: 1e6 }, ..input(0.0) };
    let mut x = MIDDLE;
    let result = Integrator::new(RIG_STEP_S).advance(&burst, &k, &EffectSet::none(), 0.0, 1e-3, &mut x);
    assert!(result.is_err(), "{x:?}");
}
