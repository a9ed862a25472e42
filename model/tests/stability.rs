//! Every effect can be simulated at the step that identification takes, wherever a search within its bounds may go.

mod common;

use common::{MIDDLE, input};
use model::Parameters;
use model::effects::{Effect, EffectSet, LIBRARY, Parameter};
use model::integrate::{Integrator, SimulationError};
use model::rec::{self, Input, STATES, state::*};

/// Reversals twice a second, the brake closed and the bypass open for a moment.
fn wave(t: f64) -> Input {
    let half = (t / 0.5 + 1e-9) as usize;
    Input {
        brake_open: !(0.8..0.9).contains(&t),
        bypass_open: (1.6..1.7).contains(&t),
        ..input(if half.is_multiple_of(2) { 21.6 } else { -21.6 })
    }
}

/// The library and its refined forms.
fn all() -> impl Iterator<Item = &'static dyn Effect> {
    LIBRARY.iter().flat_map(|e| std::iter::once(*e).chain(e.refined().map(|r| r.effect)))
}

#[test]
fn every_effect_with_a_millisecond_step() {
    let k = Parameters::example().to_vector();
    for effect in all() {
        let h = effect.header();
        for start in h.starts {
            let effects = EffectSet::new(STATES, [(effect, start.to_vec())]);
            let mut coarse = MIDDLE.to_vec();
            coarse.resize(STATES + h.states, 0.0);
            rec::rest_states(&wave(0.0), &k, &effects, &mut coarse);
            let mut fine = coarse.clone();
            let steps = [Integrator::for_plant(1e-3, &k, &effects, &[wave(0.0)], &coarse), Integrator::new(0.1e-3)];
            let mut worst: [f64; 3] = [0.0; 3];
            for i in 0..3000 {
                let t = i as f64 * 1e-3;
                for (step, x) in steps.iter().zip([&mut coarse, &mut fine]) {
                    step.advance(&wave(t), &k, &effects, t, 1e-3, x).expect("in range");
                }
                for (w, i) in worst.iter_mut().zip([ANGLE, PRESSURE1, PRESSURE2]) {
                    *w = w.max((coarse[i] - fine[i]).abs());
                }
            }
            // far below any sensor's noise; a dead time of milliseconds, and a ramp's corner, want more of a step
            let most_rad = if h.id == "pump_lag" && h.parameters.len() > 1 { 2e-5 } else { 1e-6 };
            assert!(worst[0] < most_rad && worst[1] < 3e-4 && worst[2] < 3e-4, "{} {start:?}: {worst:?}", h.id);
        }
    }
}

#[test]
fn every_effect_in_the_long_steps_of_a_lever_that_slides_on() {
    let k = Parameters::example().to_vector();
    for effect in all() {
        let h = effect.header();
        for start in h.starts {
            let effects = EffectSet::new(STATES, [(effect, start.to_vec())]);
            let mut x = MIDDLE.to_vec();
            x.resize(STATES + h.states, 0.0);
            rec::rest_states(&wave(0.0), &k, &effects, &mut x);
            let own = || Integrator::for_plant(1e-3, &k, &effects, &[wave(0.0)], &x).resolving_creep();
            let gliding = own().gliding_up_to(5e-3, &k, &effects, &[wave(0.0)], &x);
            let (mut long, mut short) = (x.clone(), x.clone());
            let mut worst: [f64; 3] = [0.0; 3];
            for i in 0..600 {
                let t = i as f64 * 5e-3;
                gliding.advance(&wave(t), &k, &effects, t, 5e-3, &mut long).expect("in range");
                own().advance(&wave(t), &k, &effects, t, 5e-3, &mut short).expect("in range");
                for (w, i) in worst.iter_mut().zip([ANGLE, PRESSURE1, PRESSURE2]) {
                    *w = w.max((long[i] - short[i]).abs());
                }
            }
            // beside steps of a millisecond: a dead time, or a valve that comes to its end, within a step; a thousandth of a degree
            let most_rad =
                if matches!(h.id, "pump_lag" | "brake_valve_lag" | "bypass_valve_lag") { 2e-5 } else { 1e-6 };
            assert!(worst[0] < most_rad && worst[1] < 3e-4 && worst[2] < 3e-4, "{} {start:?}: {worst:?}", h.id);
        }
    }
}

#[test]
fn no_start_of_an_effect_breaks_a_led_lever() {
    let k = Parameters::example().to_vector();
    for effect in all() {
        let h = effect.header();
        for start in h.starts {
            let led = |t: f64| Input { lever: rec::Lever::Led { velocity_rad_s: 0.0 }, ..wave(t) };
            let effects = EffectSet::new(STATES, [(effect, start.to_vec())]);
            let mut x = MIDDLE.to_vec();
            x.resize(STATES + h.states, 0.0);
            rec::rest_states(&led(0.0), &k, &effects, &mut x);
            // the step of slow experiments: a play that is in contact later must not surprise it
            let step = Integrator::for_plant(1e-2, &k, &effects, &[led(0.0), led(0.85), led(1.65)], &x);
            for i in 0..300 {
                let t = i as f64 * 1e-2;
                let done = step.advance(&led(t), &k, &effects, t, 1e-2, &mut x);
                assert!(done.is_ok(), "{} {start:?} at {t} s: {done:?}", h.id);
            }
        }
    }
}

#[test]
fn no_bound_of_an_effect_breaks_the_simulation() {
    let k = Parameters::example().to_vector();
    for effect in all() {
        let h = effect.header();
        for corner in 0..1u32 << h.parameters.len() {
            let at = |(i, p): (usize, &Parameter)| if corner >> i & 1 == 0 { p.lower } else { p.upper };
            let parameters: Vec<f64> = h.parameters.iter().enumerate().map(at).collect();
            let effects = EffectSet::new(STATES, [(effect, parameters.clone())]);
            let mut x = MIDDLE.to_vec();
            x.resize(STATES + h.states, 0.0);
            rec::rest_states(&wave(0.0), &k, &effects, &mut x);
            let step = Integrator::for_plant(1e-3, &k, &effects, &[wave(0.0)], &x);
            let gliding = Integrator::for_plant(1e-3, &k, &effects, &[wave(0.0)], &x).resolving_creep();
            let gliding = gliding.gliding_up_to(5e-3, &k, &effects, &[wave(0.0)], &x);
            for (step, row_s) in [(step, 1e-3), (gliding, 5e-3)] {
                let mut x = x.clone();
                for i in 0..(2.0 / row_s) as usize {
                    let t = i as f64 * row_s;
                    match step.advance(&wave(t), &k, &effects, t, row_s, &mut x) {
                        Ok(()) => {}
                        // a gross leak may empty a chamber
                        Err(SimulationError::Pressure { .. }) => break,
                        Err(other) => panic!("{} {parameters:?}, rows of {row_s} s: {other}", h.id),
                    }
                }
            }
        }
    }
}
