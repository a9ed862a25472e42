//! Simulations in the steps that identification takes, against far shorter ones: with every effect of the library.

mod common;

use common::{MIDDLE, wave};
use model::Parameters;
use model::effects::{EffectSet, LIBRARY};
use model::integrate::{Integrator, Trail};
use model::rec::{self, STATES, state::*};

const STEP_S: f64 = 1e-3;
/// Rows that far apart let a lever that slides on take steps of up to that.
const GLIDE_S: f64 = 5e-3;
const REFERENCE_S: f64 = 5e-5;
const LENGTH_S: f64 = 3.0;
/// Millionths of a channel's range.
const MOST_ERROR: f64 = 3.0;
/// The same in rows of [`GLIDE_S`].
const MOST_ERROR_GLIDING: f64 = 30.0;
/// The same where contact comes within a step, or a lag of a few milliseconds is set off by one.
const MOST_ERROR_FAST: f64 = 500.0;

/// Angle and pressures at every row.
fn simulated(integrator: &Integrator, row_s: f64, k: &[f64], effects: &EffectSet<f64>, first: &[f64]) -> Vec<[f64; 3]> {
    let (mut x, mut trail) = (first.to_vec(), Trail::new(k));
    let advanced = |i: usize| {
        let t = i as f64 * row_s;
        integrator.advance_along(&mut trail, &wave(t), k, effects, t, row_s, &mut x).expect("in range");
        [x[ANGLE], x[PRESSURE1], x[PRESSURE2]]
    };
    (0..(LENGTH_S / row_s).round() as usize).map(advanced).collect()
}

/// Largest error of each channel, millionths of its range.
fn errors(own: &[[f64; 3]], reference: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|channel| {
        let values = reference.iter().map(|row| row[channel]);
        let range = values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min);
        let off = reference.iter().zip(own).map(|(a, b)| (a[channel] - b[channel]).abs());
        1e6 * off.fold(0.0, f64::max) / range
    })
}

#[test]
fn every_effect_moves_as_in_far_shorter_steps_while_the_lever_slides_creeps_and_rests() {
    let k = Parameters::example().to_vector();
    for effect in LIBRARY {
        let h = effect.header();
        for start in h.starts {
            let effects = EffectSet::new(STATES, [(*effect, start.to_vec())]);
            let mut first = MIDDLE.to_vec();
            first.resize(STATES + effects.states, 0.0);
            rec::rest_states(&wave(0.0), &k, &effects, &mut first);
            let own = || Integrator::for_plant(STEP_S, &k, &effects, &[wave(0.0)], &first).resolving_creep();
            let gliding = own().gliding_up_to(GLIDE_S, &k, &effects, &[wave(0.0)], &first);
            let fast = matches!(h.id, "backlash" | "pump_lag" | "line_inertance");
            for (integrator, row_s, most) in [(own(), STEP_S, MOST_ERROR), (gliding, GLIDE_S, MOST_ERROR_GLIDING)] {
                let most = if fast { MOST_ERROR_FAST } else { most };
                let of = |integrator| simulated(integrator, row_s, &k, &effects, &first);
                let errors = errors(&of(&integrator), &of(&Integrator::new(REFERENCE_S)));
                println!("{} {start:?}, rows of {row_s} s: {errors:.1?} millionths of each channel's range", h.id);
                assert!(errors.iter().all(|e| *e < most), "{} {start:?}, rows of {row_s} s: {errors:.1?}", h.id);
            }
        }
    }
}
