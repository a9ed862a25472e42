//! Derivatives by dual numbers against differences, and at the sizes' zero.

use super::*;
use crate::effects::empirical::{EMPIRICAL, is_nameless};
use crate::scalar::LANES;

/// `f` and its slopes along every variable, by dual numbers as `dual` has them, against differences; counts variables where a kink is too near to tell.
fn check_slopes(
    name: &str,
    at: &[f64],
    scale: &[f64],
    f: impl Fn(&[f64]) -> Vec<f64>,
    dual: impl Fn(&[Tangent]) -> Vec<Tangent>,
) -> (usize, usize) {
    let (mut compared, mut near_kinks) = (0, 0);
    let centre = f(at);
    for first in (0..at.len()).step_by(LANES) {
        // as many variables in one pass as there are lanes
        let seeded = |(i, v): (usize, &f64)| match i.checked_sub(first).filter(|lane| *lane < LANES) {
            Some(lane) => Tangent::variable(*v, lane),
            None => Tangent::constant(*v),
        };
        let slopes = dual(&at.iter().enumerate().map(seeded).collect::<Vec<_>>());
        for (lane, (v, scale)) in at.iter().zip(scale).skip(first).take(LANES).enumerate() {
            let moved = |by: f64| {
                let mut at = at.to_vec();
                at[first + lane] = v + by;
                f(&at)
            };
            let h = 1e-5 * scale;
            let (up, down, up2, down2) = (moved(h), moved(-h), moved(2.0 * h), moved(-2.0 * h));
            for (i, slope) in slopes.iter().enumerate() {
                let central = (8.0 * (up[i] - down[i]) - (up2[i] - down2[i])) / (12.0 * h);
                // the second difference of a smooth function is of the order h; across a kink it is of the order 1
                let bend = ((up[i] - centre[i]) - (centre[i] - down[i])).abs() / h;
                let size = central.abs() + slopes[i].value.abs().max(1e-3) / scale;
                if bend > 0.02 * size {
                    near_kinks += 1;
                    continue;
                }
                compared += 1;
                assert!(
                    (slope.slope[lane] - central).abs() < 2e-5 * size,
                    "{name}: output {i} by variable {}: {} but differences say {central} (at {at:?})",
                    first + lane,
                    slope.slope[lane]
                );
            }
        }
    }
    (compared, near_kinks)
}

#[test]
fn tangents_agree_with_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let base = Parameters::example().to_vector();
    // the terms without a name all at once
    let starts = |e: &'static dyn Effect| if is_nameless(e) { &e.header().starts[..1] } else { e.header().starts };
    for effect in all().chain(&EMPIRICAL) {
        let h = effect.header();
        let (mut compared, mut near_kinks) = (0, 0);
        for start in starts(*effect) {
            // inside the bounds, not at them
            let vector: Vec<f64> = h
                .parameters
                .iter()
                .zip(*start)
                .map(|(p, v)| {
                    let room = 1e-3 * p.typical.abs();
                    let v = if *v == 0.0 { 0.3 * p.typical } else { *v };
                    (v * rng.random_range(0.7..1.4)).clamp(p.lower + room, p.upper - room)
                })
                .collect();
            for input in inputs(&mut rng) {
                let plant = state(&mut rng);
                let t = rng.random_range(1.0..60.0);
                let n = STATES + h.states;
                let own: Vec<f64> = (0..h.states).map(|_| rng.random_range(-0.9..0.9)).collect();
                let constants: Vec<Tangent> = base.iter().map(|v| Tangent::constant(*v)).collect();
                // first the states and the effect's parameters, then the plant's parameters
                let first: Vec<f64> = plant.iter().chain(&own).chain(&vector).copied().collect();
                let scale: Vec<f64> = (0..n)
                    .map(|_| 1.0)
                    .chain(vector.iter().zip(h.parameters).map(|(v, p)| v.abs().max(0.1 * p.typical.abs())))
                    .collect();
                let f = |v: &[f64]| everything(&input, &base, &set(*effect, &v[n..]), t, &v[..n]);
                let dual = |v: &[Tangent]| {
                    let effects = EffectSet::new(STATES, [(*effect, v[n..].to_vec())]);
                    everything_tangent(&input, &constants, &effects, t, &v[..n])
                };
                let (c, s) = check_slopes(h.id, &first, &scale, f, dual);
                (compared, near_kinks) = (compared + c, near_kinks + s);

                let fixed = |v: &f64| Tangent::constant(*v);
                let x: Vec<Tangent> = first[..n].iter().map(fixed).collect();
                let scale: Vec<f64> = base.iter().map(|v| v.abs().max(0.1)).collect();
                let f = |k: &[f64]| everything(&input, k, &set(*effect, &vector), t, &first[..n]);
                let dual = |k: &[Tangent]| {
                    let effects = EffectSet::new(STATES, [(*effect, vector.iter().map(fixed).collect())]);
                    everything_tangent(&input, k, &effects, t, &x)
                };
                let (c, s) = check_slopes(h.id, &base, &scale, f, dual);
                (compared, near_kinks) = (compared + c, near_kinks + s);
            }
        }
        assert!(near_kinks * 50 < compared, "{}: {near_kinks} of {compared} beside kinks", h.id);
    }
}

#[test]
fn the_derivative_by_size_exists_at_zero() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let base = Parameters::example().to_vector();
    let constants: Vec<Tangent> = base.iter().map(|v| Tangent::constant(*v)).collect();
    for effect in all().chain(&EMPIRICAL) {
        let h = effect.header();
        let zero = h.scaled(h.starts[0], 0.0);
        for input in inputs(&mut rng) {
            let plant = state(&mut rng);
            let own: Vec<f64> = (0..h.states).map(|_| rng.random_range(0.1..0.9)).collect();
            let x: Vec<f64> = plant.iter().chain(&own).copied().collect();
            let tangent_x: Vec<Tangent> = x.iter().map(|v| Tangent::constant(*v)).collect();
            let along = |entry: usize| {
                let seeded =
                    |(i, v): (usize, &f64)| if i == entry { Tangent::variable(*v, 0) } else { Tangent::constant(*v) };
                let effects = EffectSet::new(STATES, [(*effect, zero.iter().enumerate().map(seeded).collect())]);
                everything_tangent(&input, &constants, &effects, 9.0, &tangent_x)
            };
            let at_zero = everything(&input, &base, &set(*effect, &zero), 9.0, &x);
            for (entry, p) in h.parameters.iter().enumerate().filter(|(_, p)| p.size) {
                let slopes = along(entry);
                for sign in [1.0, -1.0] {
                    let step = sign * 1e-6 * p.typical.abs();
                    if step < p.lower {
                        continue;
                    }
                    let mut moved = zero.clone();
                    moved[entry] = step;
                    let moved = everything(&input, &base, &set(*effect, &moved), 9.0, &x);
                    for (i, slope) in slopes.iter().enumerate() {
                        let change = moved[i] - at_zero[i];
                        let expected = slope.slope[0] * step;
                        let rounding = 1e-14 * (1.0 + at_zero[i].abs());
                        assert!(
                            (change - expected).abs() <= 1e-3 * expected.abs() + rounding,
                            "{} {}: output {i} changes by {change}, its slope says {expected}",
                            h.id,
                            p.name
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn rest_states_have_the_slopes_of_differences_and_stay_put() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let base = Parameters::example().to_vector();
    let constants: Vec<Tangent> = base.iter().map(|v| Tangent::constant(*v)).collect();
    for effect in all().filter(|e| e.header().states > 0) {
        let h = effect.header();
        for start in h.starts {
            for input in inputs(&mut rng).into_iter().filter(|i| i.circuit == Circuit::Pump) {
                let mut plant = state(&mut rng);
                plant[rec::state::VELOCITY] = 0.0;
                let way_rad = [-0.4, 0.3, plant[rec::state::ANGLE]];
                let ran = [Ran { for_s: 20.0, voltage_v: 0.0 }, Ran { for_s: 9.0, voltage_v: 14.0 }];
                let held = crate::port::Held { torque_nm: 0.4, pressure_bar: [2.9, 2.8] };
                let held = rng.random_bool(0.5).then_some(held);
                let before = Before { way_rad: &way_rad, held, ran: &ran };
                let at: Vec<f64> = plant.iter().chain(*start).copied().collect();
                let f = |v: &[f64]| {
                    let effects = set(*effect, &v[STATES..]);
                    let mut x = v[..STATES].to_vec();
                    x.resize(STATES + h.states, 0.0);
                    rec::rest_states_after(before, &input, &base, &effects, &mut x);
                    x[STATES..].to_vec()
                };
                let dual = |v: &[Tangent]| {
                    let effects = EffectSet::new(STATES, [(*effect, v[STATES..].to_vec())]);
                    let mut x = v[..STATES].to_vec();
                    x.resize(STATES + h.states, Tangent::constant(0.0));
                    rec::rest_states_after(before, &input, &constants, &effects, &mut x);
                    x[STATES..].to_vec()
                };
                check_slopes(h.id, &at, &vec![1.0; at.len()], f, dual);
                // the line's flow is not at rest where oil slips; a play's side is open where the torque is as small as noise; a pump that is
                // driven goes on warming
                if !["line_inertance", "backlash", "pump_warming"].contains(&h.id) {
                    let effects = set(*effect, start);
                    let x = with_rest_states(&input, &base, &effects, &plant);
                    let still = Input { lever: Lever::Led { velocity_rad_s: 0.0 }, ..input };
                    let mut dx = vec![0.0; x.len()];
                    rec::derivative(&still, &base, &effects, 0.0, &x, &mut dx);
                    assert!(dx[STATES..].iter().all(|d| d.abs() < 1e-12), "{}: {:?}", h.id, &dx[STATES..]);
                }
            }
        }
    }
}
