//! The rig of a case: parameters, sensors, rates and lengths are drawn anew each time, so that nothing that is learnt of one rig holds for
//! the next.

use super::plan::{Stream, chance};
use super::sensors::{Errors, in_log};
use model::Parameters;
use model::effects::{Effect, EffectSet};
use model::parameters::{close_losses, index};
use model::rec::STATES;
use rand::Rng;
use serde::{Deserialize, Serialize};

/// What acts: parameters of the reference model, and effects with their values.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Of the reference model.
    pub parameters: Parameters,
    /// Effects with values in the order of their headers.
    pub effects: Vec<(&'static dyn Effect, Vec<f64>)>,
}

impl Truth {
    /// For a simulation.
    pub fn effect_set(&self) -> EffectSet<f64> {
        EffectSet::new(STATES, self.effects.iter().map(|(e, v)| (*e, v.clone())))
    }
}

/// Everything about a case's rig but its effects.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Rig {
    /// Temperature of the oil, degrees Celsius: warm oil slips more and brakes less. The parameters hold it already.
    pub oil_c: f64,
    /// Parameters of the reference model.
    pub parameters: Parameters,
    /// The sensors.
    pub errors: Errors,
    /// Ticks (ms) from a row to the next, of runs with a free lever: 1, 2 or 4.
    pub free_every: u64,
    /// The same of the bench experiments.
    pub bench_every: u64,
    /// Lengths of the experiments: 0 the shortest that determine the model, 1 the usual ones.
    pub length: f64,
    /// Pressure of both chambers before the runs with a free lever, bar absolute.
    pub fill_bar: f64,
}

/// Temperature at which the drawn parameters hold, degrees Celsius.
const USUAL_C: f64 = 30.0;
/// Oil of 46 mm2/s at 40 degrees is thinner by this share a degree around there.
const THINNER_A_DEGREE: f64 = 0.035;

/// Draws the rig of a case; `attempt` counts the rigs that could not run the experiments.
pub fn draw(seed: u64, case: usize, attempt: u64) -> Rig {
    let mut rng = chance(seed, Stream::Rig, (attempt << 40) + case as u64);
    let example = Parameters::example();
    let mut k = example.to_vector();
    for (i, value) in k.iter_mut().enumerate() {
        let spread = match i {
            index::A2 => 0.0,
            // exponents and the angle's share of the capacity decide whether the chambers work at all
            index::H2 | index::A1 => 0.12,
            _ => 0.18,
        };
        *value *= 1.0 + spread * rng.random_range(-1.0..1.0f64);
    }
    let u_max = [12.0, 24.0, 24.0, 48.0][rng.random_range(0..4usize)];
    for i in [index::F1, index::F2] {
        k[i] *= example.pump.u_max / u_max;
    }
    let oil_c = rng.random_range(18.0..42.0);
    let thin = (THINNER_A_DEGREE * (oil_c - USUAL_C)).exp();
    // a part of the slip and of the losses goes with the oil's thickness
    k[index::F3] *= 1.0 + 0.5 * (thin - 1.0);
    k[index::L2] *= 1.0 + 0.5 * (1.0 / thin - 1.0);
    close_losses(&mut k);
    Rig {
        oil_c,
        parameters: Parameters::from_vector(&k, u_max),
        errors: Errors::draw(&mut rng),
        free_every: [1, 1, 2, 4][rng.random_range(0..4usize)],
        bench_every: [1, 2, 4][rng.random_range(0..3usize)],
        length: rng.random_range(0.0..0.6),
        fill_bar: rng.random_range(2.6..3.2),
    }
}

/// One of an effect's usual shapes and signs, somewhat changed; sizes as the library has them, to be scaled.
pub fn shape(seed: u64, case: usize, number: usize, turn: usize, effect: &dyn Effect) -> Vec<f64> {
    let header = effect.header();
    let mut rng = chance(seed, Stream::Sizes, (16 * case + 4 * turn + number) as u64);
    let mut values = header.starts[rng.random_range(0..header.starts.len())].to_vec();
    let sizes = header.parameters.iter().filter(|p| p.size).count();
    for (p, v) in header.parameters.iter().zip(&mut values) {
        if !p.size {
            *v = (*v * in_log(&mut rng, 0.7, 1.4)).clamp(p.lower, p.upper);
        } else if sizes > 1 && *v == 0.0 && rng.random_bool(0.3) {
            // effects of several sizes do not show one alone each time
            let sign = if p.lower < 0.0 && rng.random_bool(0.5) { -1.0 } else { 1.0 };
            *v = sign * p.typical * in_log(&mut rng, 0.2, 1.0);
        } else {
            *v *= in_log(&mut rng, 0.7, 1.4);
        }
    }
    values
}
