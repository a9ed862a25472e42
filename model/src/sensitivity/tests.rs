use super::*;
use crate::Parameters;
use crate::effects::Effect;
use crate::integrate::Integrator;
use crate::parameters::COUNT;
use crate::rec::{Circuit, Lever, STATES, state};

#[test]
fn wide_vectors_compute_each_lane_as_it_would_be_alone() {
    let known = Parameters::example().to_vector();
    let seeds = Seeds::new(STATES, COUNT, |lane| {
        let dual = |(c, v): (usize, &f64)| lane(c).map_or(Tangent::constant(*v), |l| Tangent::variable(*v, l));
        (known.iter().enumerate().map(dual).collect(), EffectSet::none())
    });
    let (mut wide, mut plain) = (Sensitivity::new(STATES, COUNT + 3), Sensitivity::new(STATES, COUNT + 3));
    for s in [&mut wide, &mut plain] {
        (0..3).for_each(|i| s.set(i, COUNT + i, 1.0));
    }
    for step in 0..200 {
        let (t, swing) = (f64::from(step) * 1e-3, (0.07 * f64::from(step)).sin());
        let input = Input {
            voltage_v: 18.0 * swing.signum(),
            brake_open: true,
            bypass_open: step > 150,
            vertical: true,
            lever: Lever::Free,
            circuit: Circuit::Pump,
        };
        let middle = [0.4 * swing, 1.5 * swing, 2.5 + 0.4 * swing, 2.6 - 0.4 * swing, 0.0];
        wide.advance(&seeds, &input, t, 1e-3, &middle[..STATES]);
        plain.advance_in(&seeds, &input, t, 1e-3, &middle[..STATES]);
        let (mut one, mut other) = (Sensitivity::new(STATES, COUNT + 3), Sensitivity::new(STATES, COUNT + 3));
        linearise_few(&mut one, &seeds, &input, t, &middle[..STATES]);
        other.linearise_in::<FEW_STATES>(&seeds, &input, t, &middle[..STATES]);
        assert!(same(one.a.as_flattened(), other.a.as_flattened()) && same(&one.b, &other.b), "at step {step}");
        for s in [&mut one, &mut other] {
            s.transitions[0].dt = 1e-3;
        }
        transit_few(&mut one, 0);
        other.transit_in::<FEW_STATES>(0);
        let [one, other] = [one, other].map(|s| s.transitions);
        assert!(same(&one[0].drive, &other[0].drive), "drive at step {step}");
        assert!(same(one[0].states.as_flattened(), other[0].states.as_flattened()), "transition at step {step}");
    }
    assert!(wide.s.iter().any(|v| *v != 0.0) && wide.s.iter().all(|v| v.is_finite()));
    assert!(same(&wide.s, &plain.s), "carried along");
}

/// Most steps in a row that share A and B in the first 300 ms from rest at 12 V with these effects, and how many steps there are to each linearisation.
fn shared(effects: &[(&'static dyn Effect, &[f64])]) -> (f64, f64) {
    let known = Parameters::example().to_vector();
    let duals = effects.iter().map(|(e, own)| (*e, own.iter().map(|v| Tangent::constant(*v)).collect()));
    let values = EffectSet::new(STATES, effects.iter().map(|(e, own)| (*e, own.to_vec())));
    let n = STATES + values.states;
    let seeds = Seeds::new(n, COUNT, |lane| {
        let dual = |(c, v): (usize, &f64)| lane(c).map_or(Tangent::constant(*v), |l| Tangent::variable(*v, l));
        (known.iter().enumerate().map(dual).collect(), EffectSet::new(STATES, duals.clone()))
    });
    let input = Input {
        voltage_v: 12.0,
        brake_open: true,
        bypass_open: false,
        vertical: true,
        lever: Lever::Free,
        circuit: Circuit::Pump,
    };
    let mut x = vec![0.0; n];
    (x[state::PRESSURE1], x[state::PRESSURE2]) = (3.5, 3.5);
    rec::rest_states(&input, &known, &values, &mut x);
    let integrator = Integrator::for_plant(1e-3, &known, &values, &[input], &x).resolving_creep();
    let mut s = Sensitivity::new(n, COUNT);
    let (mut most, mut advanced, mut linearised, mut until_s) = (0.0f64, 0.0, 0.0, 0.0);
    for step in 0..300 {
        let advance = |t: f64, dt: f64, middle: &[f64]| {
            s.advance(&seeds, &input, t, dt, middle);
            let shared = s.shared.as_ref().expect("it has advanced");
            most = most.max(shared.steps);
            advanced += 1.0;
            linearised += f64::from(u8::from(shared.until_s != until_s));
            until_s = shared.until_s;
        };
        let t = f64::from(step) * 1e-3;
        integrator.advance_by_pieces(&input, &known, &values, t, 1e-3, &mut x, advance).expect("in range");
    }
    (most, advanced / linearised)
}

#[test]
fn steps_share_derivatives_where_the_equations_are_straight_and_few_beside_effects() {
    let find = |id| crate::effects::find(id).expect("an effect of the library");
    let (most, mean) = shared(&[]);
    assert!(most == MOST_SHARED && mean > 3.0, "{most} {mean}");
    let (most, mean) = shared(&[(find("angle_offset"), &[0.1])]);
    assert!(most == MOST_SHARED && mean > 3.0, "the plant is left alone: {most} {mean}");
    let (most, mean) = shared(&[(find("tilt"), &[0.1, 0.1])]);
    assert!(most == MOST_SHARED_PUSHED && mean > 1.5, "{most} {mean}");
    let (most, mean) = shared(&[(find("pump_lag"), &[0.01])]);
    assert!(most == 2.0 && mean > 1.5, "{most} {mean}");
}

fn same(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}
