//! Steps that cross kinks of the piecewise equations, against steps so short that no kink matters.

mod common;

use common::{MIDDLE, input};
use model::Parameters;
use model::effects::{EffectSet, find};
use model::integrate::{Integrator, Trail};
use model::parameters::index::A;
use model::rec::{Circuit, Input, Lever, STATES, state::*};

const STEP_S: f64 = 0.5e-3;
const PERIOD_S: f64 = 1e-3;

fn lag(tau_s: f64) -> EffectSet<f64> {
    EffectSet::new(STATES, [(find("pump_lag").expect("in the library"), vec![tau_s])])
}

/// The state a millisecond later, and the lengths of the smooth pieces.
fn advanced(step_s: f64, input: &Input, effects: &EffectSet<f64>, start: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let k = Parameters::example().to_vector();
    let (mut x, mut pieces) = (start.to_vec(), Vec::new());
    Integrator::new(step_s)
        .advance_by_pieces(input, &k, effects, 0.0, PERIOD_S, &mut x, |_, length, _| pieces.push(length))
        .expect("in range");
    (x, pieces)
}

#[test]
fn a_step_ends_where_the_losses_change_their_branch() {
    let a = Parameters::example().to_vector()[A];
    // a bar of pressure difference accelerates the lever by 0.033 rad/s in the first step
    for early in [0.1, 0.3, 0.7] {
        let start = [0.0, a - early * 0.033, 4.0, 3.0, 0.0];
        let (x, pieces) = advanced(STEP_S, &input(20.0), &EffectSet::none(), &start);
        assert!(x[VELOCITY] > a, "it crosses: {} rad/s", x[VELOCITY]);
        assert!((3..=4).contains(&pieces.len()), "two steps, one of them split: {pieces:?}");
        assert!((pieces.iter().sum::<f64>() - PERIOD_S).abs() < 1e-12);
        let fine = advanced(2e-6, &input(20.0), &EffectSet::none(), &start).0;
        let error = (x[VELOCITY] - fine[VELOCITY]).abs();
        println!("{early}: {error:.1e} rad/s, {pieces:?}");
        assert!(error < 2e-5, "{early}: {error:.1e} rad/s");
    }
}

#[test]
fn a_lever_at_rest_takes_whole_steps_and_one_that_comes_to_rest_quarters() {
    let k = Parameters::example().to_vector();
    let resolving = || Integrator::new(PERIOD_S).resolving_creep();
    let pieces = |velocity_rad_s: f64, dp_bar: f64| {
        let (mut x, mut pieces) = ([0.0, velocity_rad_s, 3.0 + dp_bar, 3.0, 0.0], 0);
        let advanced =
            resolving().advance_by_pieces(&input(0.0), &k, &EffectSet::none(), 0.0, PERIOD_S, &mut x, |_, _, _| {
                pieces += 1;
            });
        advanced.expect("in range");
        pieces
    };
    assert_eq!(pieces(0.0, 0.0), 1, "nothing moves");
    assert_eq!(pieces(0.5 * k[A], 0.0), 4, "the losses brake it");
    assert_eq!(pieces(0.0, 0.2), 4, "the pressures set it in motion");

    // strokes with rests between them, the brake closed in every other one
    let at = |i: usize| match i / 400 % 4 {
        0 => input(18.0),
        2 => input(-18.0),
        n => Input { brake_open: n == 1, ..input(0.0) },
    };
    let (mut coarse, mut fine, mut steps) = (MIDDLE, MIDDLE, 0);
    for i in 0..4800 {
        let t = i as f64 * PERIOD_S;
        let by_pieces =
            resolving()
                .advance_by_pieces(&at(i), &k, &EffectSet::none(), t, PERIOD_S, &mut coarse, |_, _, _| steps += 1);
        by_pieces.expect("in range");
        Integrator::new(0.05e-3).advance(&at(i), &k, &EffectSet::none(), t, PERIOD_S, &mut fine).expect("in range");
        assert!((coarse[ANGLE] - fine[ANGLE]).abs() < 1e-6, "{t} s: {coarse:?} and {fine:?}");
        assert!((coarse[PRESSURE1] - fine[PRESSURE1]).abs() < 3e-4, "{t} s: {coarse:?} and {fine:?}");
    }
    assert!(steps < 4800 * 3 / 2, "{steps} steps in 4800 ms, half of which the lever is at rest");
}

#[test]
fn a_lever_that_slides_on_takes_one_step_and_one_that_is_braked_many() {
    let (k, none) = (Parameters::example().to_vector(), EffectSet::none());
    let gliding = || {
        let own = Integrator::new(PERIOD_S).resolving_creep();
        own.gliding_up_to(5.0 * PERIOD_S, &k, &none, &[input(18.0)], &MIDDLE)
    };
    let pieces = |from: &[f64], volts: f64| {
        let (mut x, mut pieces) = (from.to_vec(), 0);
        let advanced =
            gliding().advance_by_pieces(&input(volts), &k, &none, 0.0, 5.0 * PERIOD_S, &mut x, |_, _, _| pieces += 1);
        advanced.expect("in range");
        pieces
    };
    let mut sliding = MIDDLE;
    for i in 0..600 {
        let t = i as f64 * PERIOD_S;
        gliding().advance(&input(18.0), &k, &none, t, PERIOD_S, &mut sliding).expect("in range");
    }
    assert!(sliding[VELOCITY] > 2.0 * k[A], "{sliding:?}");
    assert_eq!(pieces(&sliding, 18.0), 1, "it slides on");
    let mut parted = sliding;
    parted[PRESSURE1] += 0.3;
    assert_eq!(pieces(&parted, 18.0), 5, "it is accelerated");
    assert!(pieces(&MIDDLE, 0.0) == 5 && pieces(&MIDDLE, 18.0) >= 5, "at rest, and setting out");
    let reversed: Vec<f64> = sliding.iter().enumerate().map(|(i, v)| if i == VELOCITY { -v } else { *v }).collect();
    assert!(pieces(&reversed, 18.0) >= 5, "driven against");

    // an elastic friction whose own time constant falls with the speed is followed in its own steps
    let stiff = EffectSet::new(STATES, [(find("elastic_hysteresis").expect("an effect"), vec![1.0, 1e-3])]);
    let mut x = MIDDLE.to_vec();
    x.resize(STATES + stiff.states, 0.0);
    let own = Integrator::for_plant(PERIOD_S, &k, &stiff, &[input(18.0)], &x);
    let gliding = own.gliding_up_to(5.0 * PERIOD_S, &k, &stiff, &[input(18.0)], &x);
    let mut pieces = 0;
    x[VELOCITY] = sliding[VELOCITY];
    gliding
        .advance_by_pieces(&input(18.0), &k, &stiff, 0.0, 5.0 * PERIOD_S, &mut x, |_, _, _| pieces += 1)
        .expect("in range");
    assert!(pieces >= 5, "{pieces}");
}

#[test]
fn two_kinks_at_one_instant_are_found() {
    // From rest at equal pressures the lagging pump leaves its dead zone, and only then the pressures part.
    for volts in [-13.84, -6.0, 5.84, 8.35, 24.0] {
        for (tau_s, bypass_open) in [(0.004, false), (0.005, true), (0.02, false)] {
            let input = Input { bypass_open, ..input(volts) };
            for before_v in [0.0, 1e-9, -1e-9, -0.4 * volts] {
                let start = [0.0, 0.0, 2.8, 2.8, 0.0, before_v];
                let (x, pieces) = advanced(STEP_S, &input, &lag(tau_s), &start);
                let fine = advanced(2e-6, &input, &lag(tau_s), &start).0;
                let error = (x[PRESSURE1] - fine[PRESSURE1]).abs();
                assert!(error < 2e-7, "{volts} V, {tau_s} s, from {before_v} V: {error:.1e} bar, pieces {pieces:?}");
            }
        }
    }
}

#[test]
fn a_trail_changes_no_more_than_the_last_digits() {
    let k = Parameters::example().to_vector();
    let at = |i: usize| Input {
        voltage_v: if (i / 130).is_multiple_of(2) { 18.0 } else { -15.0 },
        brake_open: (i / 170) % 4 != 3,
        bypass_open: (i / 190) % 5 == 4,
        vertical: true,
        lever: if (i / 400) % 3 == 2 { Lever::Led { velocity_rad_s: 0.2 } } else { Lever::Free },
        circuit: if (i / 600) % 4 == 3 { Circuit::ShutOff { release_ml_s: 0.1 } } else { Circuit::Pump },
    };
    for effects in [EffectSet::none(), lag(0.02)] {
        let integrator = Integrator::new(STEP_S);
        let mut x = MIDDLE.to_vec();
        x.resize(STATES + effects.states, 0.0);
        let mut along = x.clone();
        let mut trail = Trail::new(&k);
        for i in 0..3000 {
            if i % 500 == 499 {
                // an operator puts the lever somewhere else
                x[ANGLE] -= 0.1;
                along[ANGLE] -= 0.1;
            }
            let t = i as f64 * PERIOD_S;
            integrator.advance(&at(i), &k, &effects, t, PERIOD_S, &mut x).expect("in range");
            integrator.advance_along(&mut trail, &at(i), &k, &effects, t, PERIOD_S, &mut along).expect("in range");
            for (a, b) in x.iter().zip(&along) {
                assert!((a - b).abs() < 1e-9, "after {i} ms: {x:?} and {along:?}");
            }
        }
    }
}
