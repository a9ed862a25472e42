//! Simulations in the steps that identification takes, against far shorter ones: with every effect of the library.

mod common;

use common::{MIDDLE, wave};
use model::Parameters;
use model::effects::{EffectSet, LIBRARY};
use model::integrate::{Integrator, Trail};
use model::rec::{self, STATES, state::*};

const STEP_S: f64 = 1e-3;
const REFERENCE_S: f64 = 5e-5;
const STEPS: usize = 3000;
/// Of a channel's range.
const MOST_ERROR: f64 = 3e-6;
/// The same where contact comes within a step, or a lag of a few milliseconds is set off by one.
const MOST_ERROR_FAST: f64 = 5e-4;

#[test]
fn every_effect_moves_as_in_far_shorter_steps_while_the_lever_moves_creeps_and_rests() {
    let k = Parameters::example().to_vector();
    for effect in LIBRARY {
        let h = effect.header();
        for start in h.starts {
            let effects = EffectSet::new(STATES, [(*effect, start.to_vec())]);
            let mut first = MIDDLE.to_vec();
            first.resize(STATES + effects.states, 0.0);
            rec::rest_states(&wave(0.0), &k, &effects, &mut first);
            let simulated = |integrator: &Integrator| -> Vec<[f64; 3]> {
                let (mut x, mut trail) = (first.clone(), Trail::new(&k));
                let advanced = |i: usize| {
                    let t = i as f64 * STEP_S;
                    integrator.advance_along(&mut trail, &wave(t), &k, &effects, t, STEP_S, &mut x).expect("in range");
                    [x[ANGLE], x[PRESSURE1], x[PRESSURE2]]
                };
                (0..STEPS).map(advanced).collect()
            };
            let reference = simulated(&Integrator::new(REFERENCE_S));
            let own = Integrator::for_plant(STEP_S, &k, &effects, &[wave(0.0)], &first).resolving_creep();
            let own = simulated(&own);
            let most = match h.id {
                "backlash" | "pump_lag" | "line_inertance" => MOST_ERROR_FAST,
                _ => MOST_ERROR,
            };
            for channel in 0..3 {
                let values = reference.iter().map(|row| row[channel]);
                let range = values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min);
                let error =
                    reference.iter().zip(&own).map(|(a, b)| (a[channel] - b[channel]).abs()).fold(0.0, f64::max);
                println!("{} {start:?}, channel {channel}: {:.1e} of its range", h.id, error / range);
                assert!(
                    error < most * range,
                    "{} {start:?}, channel {channel}: {:.1e} of its range",
                    h.id,
                    error / range
                );
            }
        }
    }
}
