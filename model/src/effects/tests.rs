//! What every effect of the library must hold to.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

mod energy;
mod forms;
mod pairs;
mod slopes;

use super::empirical::EMPIRICAL;
use super::*;
use crate::parameters::Parameters;
use crate::port::{
    AMBIENT_BAR, ActuatorPort, Arrival, Before, HydraulicPort, LinePort, MechanicalPort, Ran, Rest, SensorPort,
};
use crate::rec::{self, Circuit, Input, Lever, STATES};
use crate::scalar::Tangent;

/// A plant state in the envelope of the paper's figures.
fn state(rng: &mut ChaCha8Rng) -> [f64; STATES] {
    [
        rng.random_range(-0.7..0.7),
        rng.random_range(-3.0..3.0),
        rng.random_range(1.1..6.0),
        rng.random_range(1.1..6.0),
        rng.random_range(0.0..20.0),
    ]
}

fn circuits() -> [Circuit; 4] {
    [
        Circuit::Pump,
        Circuit::ShutOff { release_ml_s: 0.5 },
        Circuit::Measured { rate1_bar_s: 0.3, rate2_bar_s: -0.2 },
        Circuit::Bench,
    ]
}

/// Every combination of valves, plane, lever and circuit, each with a random voltage.
fn inputs(rng: &mut ChaCha8Rng) -> Vec<Input> {
    let mut all = Vec::new();
    for circuit in circuits() {
        for bits in 0..16 {
            all.push(Input {
                voltage_v: rng.random_range(-24.0..24.0),
                brake_open: bits & 1 != 0,
                bypass_open: bits & 2 != 0,
                vertical: bits & 4 != 0,
                lever: if bits & 8 != 0 { Lever::Free } else { Lever::Led { velocity_rad_s: 0.07 } },
                circuit,
            });
        }
    }
    all
}

/// Both lists: the rig fills every port, so that it can carry the general effects as well.
fn listed() -> impl Iterator<Item = &'static &'static dyn Effect> {
    LIBRARY.iter().chain(MECHANICAL)
}

/// Those and their refined forms, which the same rules hold for.
fn all() -> impl Iterator<Item = &'static &'static dyn Effect> {
    listed().flat_map(|e| std::iter::once(e).chain(e.refined().map(|r| &r.effect)))
}

fn set(effect: &'static dyn Effect, k: &[f64]) -> EffectSet<f64> {
    EffectSet::new(STATES, [(effect, k.to_vec())])
}

/// The pump at 12 V against this pressure, its way open.
fn line(time_s: f64, dp_bar: f64) -> LinePort<f64> {
    LinePort { slip_ml_s_bar: 0.25, drive_ml_s: 7.0, ..LinePort::open(time_s, 12.0, dp_bar) }
}

/// Derivatives of all states, the torque, the flow and what the sensors show.
fn everything(input: &Input, k: &[f64], effects: &EffectSet<f64>, t: f64, x: &[f64]) -> Vec<f64> {
    let mut dx = vec![0.0; x.len()];
    let derived = rec::derivative(input, k, effects, t, x, &mut dx);
    let mut scratch = vec![0.0; x.len() - STATES];
    scratch.resize(x.len(), 0.0);
    let shown = rec::shown(effects, t, x, &mut scratch);
    dx.extend([derived.torque_nm, derived.flow_ml_s]);
    dx.extend(shown);
    dx
}

fn everything_tangent(
    input: &Input,
    k: &[Tangent],
    effects: &EffectSet<Tangent>,
    t: f64,
    x: &[Tangent],
) -> Vec<Tangent> {
    let mut dx = vec![Tangent::constant(0.0); x.len()];
    let derived = rec::derivative(input, k, effects, t, x, &mut dx);
    let mut scratch = vec![Tangent::constant(0.0); x.len()];
    let shown = rec::shown(effects, t, x, &mut scratch);
    dx.extend([derived.torque_nm, derived.flow_ml_s]);
    dx.extend(shown);
    dx
}

/// The plant state followed by the effect's states at rest there.
fn with_rest_states(input: &Input, k: &[f64], effects: &EffectSet<f64>, plant: &[f64; STATES]) -> Vec<f64> {
    let mut x = plant.to_vec();
    x.resize(STATES + effects.states, 0.0);
    rec::rest_states(input, k, effects, &mut x);
    x
}

/// Starts, the typical values, and every corner of the bounds.
fn parameter_vectors(header: &Header) -> Vec<Vec<f64>> {
    let mut all: Vec<Vec<f64>> = header.starts.iter().map(|s| s.to_vec()).collect();
    all.push(header.parameters.iter().map(|p| p.typical).collect());
    for corner in 0..1u32 << header.parameters.len() {
        let at = |(i, p): (usize, &Parameter)| if corner >> i & 1 == 0 { p.lower } else { p.upper };
        all.push(header.parameters.iter().enumerate().map(at).collect());
    }
    all
}

#[test]
fn headers_are_complete_and_ids_unique() {
    let mut ids: Vec<&str> = listed().map(|e| e.header().id).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), LIBRARY.len() + MECHANICAL.len(), "two effects share an id");
    for effect in all() {
        let h = effect.header();
        assert!(h.id.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{}", h.id);
        for text in [h.summary, h.equation, h.validity, h.measure, h.literature] {
            assert!(text.len() > 8, "{}: a text of the header is missing", h.id);
        }
        assert!(!h.ports.is_empty() && !h.parameters.is_empty() && !h.starts.is_empty(), "{}", h.id);
        assert!(h.parameters.iter().any(|p| p.size), "{}: nothing says how strong it is", h.id);
        for p in h.parameters {
            assert!(!p.name.is_empty() && !p.unit.is_empty(), "{}", h.id);
            assert!(p.lower <= p.typical && p.typical <= p.upper && p.lower < p.upper, "{} {}", h.id, p.name);
            assert!(p.typical != 0.0, "{} {}: typical is a scale", h.id, p.name);
            assert!(!p.size || (p.lower <= 0.0 && 0.0 <= p.upper), "{} {}: a size may vanish", h.id, p.name);
        }
        for start in h.starts {
            assert_eq!(start.len(), h.parameters.len(), "{}", h.id);
            assert!(
                start.iter().zip(h.parameters).any(|(v, p)| p.size && *v != 0.0),
                "{}: a start without any effect",
                h.id
            );
            for (v, p) in start.iter().zip(h.parameters) {
                assert!(p.lower <= *v && *v <= p.upper, "{} {}: start {v} out of bounds", h.id, p.name);
            }
        }
    }
}

#[test]
fn the_contracts_ids_are_there_with_their_balances() {
    use Balance::*;
    for (balance, id) in [
        (Torque, "torque_cubic"),
        (Torque, "pressure_friction"),
        (Torque, "stribeck_friction"),
        (Torque, "elastic_hysteresis"),
        (Torque, "tilt"),
        (Torque, "end_stop"),
        (Torque, "backlash"),
        (Flow, "external_leakage"),
        (Flow, "cross_leakage"),
        (Flow, "chamber_asymmetry"),
        (Flow, "wall_creep"),
        (Flow, "trapped_air"),
        (Flow, "displacement_pressure"),
        (Pump, "pump_lag"),
        (Pump, "pump_asymmetry"),
        (Pump, "pump_warming"),
        (Pump, "line_inertance"),
        (Pump, "brake_valve_lag"),
        (Sensor, "pressure_drift"),
        (Sensor, "pressure_lag"),
        (Sensor, "angle_offset"),
    ] {
        let effect = find(id).unwrap_or_else(|| panic!("{id} is not in the library"));
        assert_eq!(effect.header().balance, balance, "{id}");
    }
}

#[test]
fn effects_are_themselves_at_their_starts_and_what_a_form_only_imitates_at_its_bounds_is_not() {
    for effect in listed() {
        for start in effect.header().starts {
            assert!(effect.is_itself(start), "{} at {start:?}", effect.header().id);
        }
    }
    let stop = super::find("end_stop").unwrap();
    let general = stop.refined().unwrap().effect;
    for (phi_c_deg, is_stop) in [(15.0, false), (15.02, false), (20.0, true)] {
        assert_eq!(stop.is_itself(&[1.0, 1.0, phi_c_deg]), is_stop, "{phi_c_deg}");
        assert_eq!(general.is_itself(&[1.0, 1.0, phi_c_deg, 10.0, 0.0, 0.0, 0.1]), is_stop, "{phi_c_deg}");
    }
    let leak = super::find("external_leakage").unwrap().refined().unwrap().effect;
    for (power, is_gap) in [(0.5, true), (1.0, true), (1.1, true), (1.199, false), (1.2, false)] {
        assert_eq!(leak.is_itself(&[0.02, 0.02, power, 0.25, 2.0, 1.7]), is_gap, "a valve that opens is none: {power}");
    }
    // its ends are phi_c + e and phi_c - e, and where one alone presses only that one is known
    for (k1, k2, phi_c_deg, e_deg, is_stop) in [
        (1.0, 0.0, 16.9, -13.1, false),
        (1.0, 0.0, 15.0, 9.0, true),
        (0.0, 1.0, 20.0, 15.0, false),
        (1.0, 1.0, 25.0, 6.0, true),
        (1.0, 1.0, 18.0, 6.0, false),
    ] {
        let k = [k1, k2, phi_c_deg, 2.0, e_deg, 0.0, 0.01];
        assert_eq!(general.is_itself(&k), is_stop, "{k:?}");
    }
}

#[test]
fn without_size_an_effect_leaves_the_base_model_to_the_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let k = Parameters::example().to_vector();
    for effect in all().chain(&EMPIRICAL) {
        let h = effect.header();
        for start in h.starts {
            let effects = set(*effect, &h.scaled(start, 0.0));
            for input in inputs(&mut rng) {
                let plant = state(&mut rng);
                let t = rng.random_range(0.0..60.0);
                let x = with_rest_states(&input, &k, &effects, &plant);
                let got = everything(&input, &k, &effects, t, &x);
                let base = everything(&input, &k, &EffectSet::none(), t, &plant);
                assert_eq!(got[..STATES], base[..STATES], "{} {input:?} {plant:?}", h.id);
                assert_eq!(got[x.len()..], base[STATES..], "{} {input:?} {plant:?}", h.id);
            }
        }
    }
}

#[test]
fn with_size_an_effect_changes_something() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let k = Parameters::example().to_vector();
    for effect in all().chain(&EMPIRICAL) {
        let h = effect.header();
        for start in h.starts {
            let effects = set(*effect, start);
            let inputs = inputs(&mut rng);
            let changed = inputs.iter().any(|input| {
                let plant = state(&mut rng);
                let mut x = with_rest_states(input, &k, &effects, &plant);
                for own in &mut x[STATES..] {
                    *own += rng.random_range(-0.5..0.5);
                }
                let got = everything(input, &k, &effects, 20.0, &x);
                let base = everything(input, &k, &EffectSet::none(), 20.0, &plant);
                got[..STATES] != base[..STATES] || got[x.len()..] != base[STATES..]
            });
            assert!(changed, "{} {start:?}", h.id);
        }
    }
}

#[test]
fn finite_in_the_envelope_at_starts_and_bounds() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let base = Parameters::example().to_vector();
    let k: Vec<Tangent> = base.iter().map(|v| Tangent::constant(*v)).collect();
    for effect in all() {
        let h = effect.header();
        for vector in parameter_vectors(h) {
            let seeded = |(i, v): (usize, &f64)| Tangent::variable(*v, i);
            let tangents: Vec<Tangent> = vector.iter().enumerate().map(seeded).collect();
            let effects = EffectSet::new(STATES, [(*effect, tangents)]);
            for input in inputs(&mut rng) {
                let plant = state(&mut rng);
                let variable = |(i, v): (usize, &f64)| Tangent::variable(*v, 8 + i);
                let mut x: Vec<Tangent> = plant.iter().enumerate().map(variable).collect();
                x.resize(STATES + effects.states, Tangent::constant(0.0));
                rec::rest_states(&input, &k, &effects, &mut x);
                for at_rest in [true, false] {
                    if !at_rest {
                        for own in &mut x[STATES..] {
                            *own = Tangent::constant(rng.random_range(-1.0..1.0));
                        }
                    }
                    let t = rng.random_range(0.0..600.0);
                    for v in everything_tangent(&input, &k, &effects, t, &x) {
                        assert!(
                            v.value.is_finite() && v.slope.iter().all(|s| s.is_finite()),
                            "{} {vector:?} {input:?} {plant:?}",
                            h.id
                        );
                    }
                }
            }
        }
    }
}

/// The parameters of the mirrored effect: what chamber 1 had, chamber 2 has, and directions are reversed.
fn mirrored(id: &str, k: &[f64]) -> Option<Vec<f64>> {
    Some(match id {
        // the first two are one chamber's and the other's; a form's own parameters hold for both
        "external_leakage" | "trapped_air" | "pressure_lag" => [&[k[1], k[0]], &k[2..]].concat(),
        "pressure_drift" => [&[k[2], k[3], k[0], k[1]], &k[4..]].concat(),
        "end_stop" => {
            let mut turned = [&[k[1], k[0]], &k[2..]].concat();
            turned.iter_mut().skip(4).take(1).for_each(|e| *e = -*e);
            turned
        }
        "tilt" => vec![k[0], -k[1]],
        "angle_offset" | "quadratic_stiffness" | "force_offset" | "asymmetric_coulomb" => vec![-k[0]],
        "pump_asymmetry" => k.iter().map(|v| -v).collect(),
        // it names chamber 2 as the one that differs
        "chamber_asymmetry" => return None,
        _ => k.to_vec(),
    })
}

/// The plant seen from its other chamber.
fn mirror(x: &[f64]) -> [f64; 4] {
    [-x[0], -x[1], x[3], x[2]]
}

#[test]
fn both_chambers_are_treated_alike() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let k = Parameters::example().to_vector();
    for effect in all() {
        let h = effect.header();
        for start in h.starts {
            let Some(other) = mirrored(h.id, start) else { continue };
            for input in inputs(&mut rng) {
                // shutting off is done to chamber 1
                if !matches!(input.circuit, Circuit::Pump) {
                    continue;
                }
                let plant = state(&mut rng);
                let reflected: [f64; STATES] = {
                    let m = mirror(&plant);
                    [m[0], m[1], m[2], m[3], plant[4]]
                };
                let turned = Input {
                    voltage_v: -input.voltage_v,
                    lever: match input.lever {
                        other @ (Lever::Free | Lever::Carried) => other,
                        Lever::Led { velocity_rad_s } => Lever::Led { velocity_rad_s: -velocity_rad_s },
                    },
                    ..input
                };
                let (a, b) = (set(*effect, start), set(*effect, &other));
                let one = everything(&input, &k, &a, 9.0, &with_rest_states(&input, &k, &a, &plant));
                let two = everything(&turned, &k, &b, 9.0, &with_rest_states(&turned, &k, &b, &reflected));
                let n = STATES + h.states;
                let shown = |v: &[f64]| [-v[n + 2], v[n + 4], v[n + 3]];
                let expected = mirror(&two);
                for i in 0..4 {
                    let error = (one[i] - expected[i]).abs();
                    assert!(error < 1e-9 * (1.0 + one[i].abs()), "{} {start:?}: state {i}, {input:?}", h.id);
                }
                for (a, b) in [one[n + 2], one[n + 3], one[n + 4]].iter().zip(shown(&two)) {
                    assert!((a - b).abs() < 1e-9, "{} {start:?}: sensors", h.id);
                }
            }
        }
    }
}
