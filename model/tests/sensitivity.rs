//! Sensitivities carried along a trajectory against differences of the integrator itself.

mod common;

use common::{MIDDLE, wave};
use model::Parameters;
use model::effects::{Effect, EffectSet, LIBRARY};
use model::integrate::{Integrator, Seeds, Sensitivity};
use model::parameters::{COUNT, NAMES};
use model::rec::{self, STATES, state::*};
use model::scalar::{Scalar, Tangent};

const STEP_S: f64 = 1e-3;
const STEPS: usize = 3000;
/// Steps from row to row: each, or the first row, the middle one and the last of blocks of ten, between which a lever that slides on takes long ones.
const ROWS: [&[usize]; 2] = [&[1], &[5, 4, 1]];
/// The states that a campaign measures.
const MEASURED: [usize; 3] = [ANGLE, PRESSURE1, PRESSURE2];
/// Of a column's largest value. The step in which the lever reverses takes the branch of its middle for the whole
/// millisecond, which the losses' time constant of 1.5 ms near rest feels.
const MOST_ERROR: f64 = 0.05;

/// States after each step, from `start` with the effect's states at rest.
fn simulate(k: &[f64], effects: &EffectSet<f64>, start: &[f64]) -> Vec<Vec<f64>> {
    let integrator = Integrator::new(0.25e-3);
    let mut x = start.to_vec();
    x.resize(STATES + effects.states, 0.0);
    rec::rest_states(&wave(0.0), k, effects, &mut x);
    (0..STEPS)
        .map(|i| {
            let t = i as f64 * STEP_S;
            integrator.advance(&wave(t), k, effects, t, STEP_S, &mut x).expect("in range");
            x.clone()
        })
        .collect()
}

/// Largest error of each column of the sensitivities, as a share of the column's largest value in the same state: `k` the
/// plant's parameters, `own` the effect's; columns: those parameters, then the initial states of the plant. `rows`: steps from one to the next, in turn.
fn errors(k: &[f64], effect: Option<(&'static dyn Effect, &[f64])>, rows: &[usize]) -> Vec<f64> {
    let own: Vec<f64> = effect.map_or(Vec::new(), |(_, own)| own.to_vec());
    let set = |own: &[f64]| match effect {
        Some((effect, _)) => EffectSet::new(STATES, [(effect, own.to_vec())]),
        None => EffectSet::none(),
    };
    let n = STATES + set(&own).states;
    let seeded = COUNT + own.len();
    let seeds = Seeds::new(n, seeded, |lane| {
        let dual = |column: usize, value: f64| match lane(column) {
            Some(lane) => Tangent::variable(value, lane),
            None => Tangent::constant(value),
        };
        let plant = k.iter().enumerate().map(|(i, v)| dual(i, *v)).collect();
        let own: Vec<Tangent> = own.iter().enumerate().map(|(i, v)| dual(COUNT + i, *v)).collect();
        let effects = match effect {
            Some((effect, _)) => EffectSet::new(STATES, [(effect, own)]),
            None => EffectSet::none(),
        };
        (plant, effects)
    });
    let columns = seeded + 4;
    let mut s = Sensitivity::new(n, columns);
    for i in 0..4 {
        s.set(i, seeded + i, 1.0);
    }
    // the effects' states at rest depend on parameters and initial states
    seeds.each_pass(|k, effects, first, count| {
        let mut x: Vec<Tangent> = MIDDLE.iter().enumerate().map(|(i, v)| Tangent::variable(*v, i)).collect();
        x.resize(n, Tangent::constant(0.0));
        rec::rest_states(&wave(0.0), k, effects, &mut x);
        for (i, own) in x.iter().enumerate().skip(STATES) {
            for c in 0..count {
                s.set(i, first + c, own.slope[n + c]);
            }
            for c in 0..4 {
                s.set(i, seeded + c, own.slope[c]);
            }
        }
    });
    let effects = set(&own);
    let mut x = MIDDLE.to_vec();
    x.resize(n, 0.0);
    rec::rest_states(&wave(0.0), k, &effects, &mut x);
    // as identification does it
    let integrator = Integrator::for_plant(STEP_S, k, &effects, &[wave(0.0)], &x).resolving_creep();
    let longest_s = *rows.iter().max().expect("rows") as f64 * STEP_S;
    let integrator = integrator.gliding_up_to(longest_s, k, &effects, &[wave(0.0)], &x);
    let mut carried = Vec::with_capacity(STEPS);
    let mut at = 0;
    for steps in rows.iter().cycle().take_while(|steps| {
        at += **steps;
        at <= STEPS
    }) {
        let from = carried.last().map_or(0, |(row, _)| row + 1);
        let t = from as f64 * STEP_S;
        let input = wave(t);
        integrator
            .advance_by_pieces(&input, k, &effects, t, *steps as f64 * STEP_S, &mut x, |t, dt, middle| {
                s.advance(&seeds, &input, t, dt, middle);
            })
            .expect("in range");
        carried.push((from + steps - 1, [0, 1, 2, 3].map(|state| s.row(state).to_vec())));
    }
    (0..columns)
        .map(|column| {
            let moved = |by: f64| {
                let (mut k, mut own, mut start) = (k.to_vec(), own.clone(), MIDDLE.to_vec());
                if column < COUNT {
                    k[column] += by;
                } else if column < seeded {
                    own[column - COUNT] += by;
                } else {
                    start[column - seeded] += by;
                }
                simulate(&k, &set(&own), &start)
            };
            let value = if column < COUNT {
                k[column]
            } else if column < seeded {
                own[column - COUNT]
            } else {
                0.0
            };
            // far above the integrator's own noise where it locates kinks
            let h = 1e-4 * value.abs().max(0.01);
            let (up, down) = (moved(h), moved(-h));
            let mut worst: f64 = 0.0;
            for state in MEASURED {
                let (mut error, mut largest): (f64, f64) = (0.0, 0.0);
                for (i, s) in &carried {
                    let difference = (up[*i][state] - down[*i][state]) / (2.0 * h);
                    error = error.max((s[state][column] - difference).abs());
                    largest = largest.max(difference.abs());
                }
                // a parameter that moves nothing by a millibar has no scale
                if largest * value.abs().max(0.01) > 1e-3 {
                    worst = worst.max(error / largest);
                }
            }
            worst
        })
        .collect()
}

#[test]
fn every_parameter_of_the_reference_model() {
    for rows in ROWS {
        let errors = errors(&Parameters::example().to_vector(), None, rows);
        let names = NAMES.iter().copied().chain(["angle0", "velocity0", "pressure1_0", "pressure2_0"]);
        for (name, error) in names.zip(&errors) {
            println!("{rows:?} {name}: {error:.1e}");
            assert!(*error < MOST_ERROR, "{rows:?} {name}: {error:.1e} of its largest value");
        }
    }
}

#[test]
fn every_parameter_of_every_effect() {
    let k = Parameters::example().to_vector();
    for (effect, rows) in LIBRARY.iter().flat_map(|effect| ROWS.map(|rows| (effect, rows))) {
        let h = effect.header();
        let start = h.starts[h.starts.len() - 1];
        let errors = errors(&k, Some((*effect, start)), rows);
        let of_plant = NAMES.iter().zip(&errors).max_by(|a, b| a.1.total_cmp(b.1)).expect("a plant has parameters");
        println!("{rows:?} {} beside {}: {:.1e}", h.id, of_plant.0, of_plant.1);
        for (p, error) in h.parameters.iter().zip(&errors[COUNT..]) {
            println!("{rows:?} {} {}: {error:.1e}", h.id, p.name);
            // play: contact comes within 2 ms
            let most = if h.id == "backlash" { 4.0 * MOST_ERROR } else { MOST_ERROR };
            assert!(*error < most, "{rows:?} {} {}: {error:.1e} of its largest value", h.id, p.name);
        }
    }
}
