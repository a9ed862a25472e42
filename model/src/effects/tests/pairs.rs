//! What a set of effects does, whatever the order in which they are given.

use super::*;

/// A set of effects with their last starts.
fn carried(effects: &[&'static dyn Effect]) -> EffectSet<f64> {
    EffectSet::new(STATES, effects.iter().map(|e| (*e, e.header().starts[e.header().starts.len() - 1].to_vec())))
}

/// What a plant does with two effects, the states of the one whose id is first in the alphabet before those of the other.
fn done(pair: [&'static dyn Effect; 2], input: &Input, plant: &[f64; STATES], moved: f64) -> Vec<f64> {
    let k = Parameters::example().to_vector();
    let effects = carried(&pair);
    let mut x = with_rest_states(input, &k, &effects, plant);
    let at_rest = x.clone();
    x[STATES..].iter_mut().for_each(|own| *own += moved);
    let all = everything(input, &k, &effects, 20.0, &x);
    let first = STATES + pair[0].header().states;
    let parts =
        [&at_rest[STATES..first], &at_rest[first..]].into_iter().zip([&all[STATES..first], &all[first..x.len()]]);
    let mut own: Vec<(&str, Vec<f64>)> =
        pair.iter().zip(parts).map(|(e, (rest, rate))| (e.header().id, [rest, rate].concat())).collect();
    own.sort_by_key(|(id, _)| *id);
    own.into_iter().flat_map(|(_, own)| own).chain(all[..STATES].iter().chain(&all[x.len()..]).copied()).collect()
}

#[test]
fn every_pair_does_the_same_in_both_orders() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let library: Vec<&'static dyn Effect> =
        LIBRARY.iter().flat_map(|e| std::iter::once(*e).chain(e.refined().map(|r| r.effect))).collect();
    for (n, one) in library.iter().enumerate() {
        for other in &library[n + 1..] {
            if one.header().id == other.header().id {
                continue;
            }
            for input in inputs(&mut rng) {
                let (plant, moved) = (state(&mut rng), rng.random_range(-0.3..0.3));
                let [there, back] = [[*one, *other], [*other, *one]].map(|pair| done(pair, &input, &plant, moved));
                assert_eq!(there, back, "{one:?} and {other:?}, {input:?}");
            }
        }
    }
}

#[test]
fn states_follow_in_the_order_given() {
    let effects = carried(&["backlash", "pressure_lag", "wall_creep"].map(|id| find(id).unwrap()));
    assert_eq!(effects.states, 5);
    let mut at_chambers: Vec<_> = effects.at_chambers().collect();
    at_chambers.sort_by_key(|own| own.start);
    assert_eq!(at_chambers, [STATES..STATES + 1, STATES + 3..STATES + 5]);
    let k = Parameters::example().to_vector();
    let input = Input {
        voltage_v: 6.0,
        brake_open: true,
        bypass_open: false,
        vertical: true,
        lever: Lever::Free,
        circuit: Circuit::Pump,
    };
    let x = with_rest_states(&input, &k, &effects, &[0.2, 0.0, 2.0, 3.0, 0.0]);
    assert_eq!(x[STATES + 1..STATES + 3], [2.0, 3.0], "what the sensors show");
    assert!((x[STATES + 4] / x[STATES + 3] - 2.0).abs() < 1e-12, "walls under gauge pressures of 1 and 2 bar");
}

#[test]
fn a_sensor_s_zero_is_off_in_what_it_shows_and_not_in_what_it_follows() {
    let (lag, zero) = (find("pressure_lag").unwrap(), find("pressure_drift").unwrap());
    let effects = EffectSet::new(STATES, [(zero, vec![0.3, 0.0, 0.0, 0.0, 40.0]), (lag, vec![0.05, 0.0])]);
    let x = [0.0, 0.0, 2.0, 3.0, 0.0, 2.0, 3.0];
    let mut rates = [0.0; 7];
    assert_eq!(rec::shown(&effects, 1.0, &x, &mut rates), [0.0, 2.3, 3.0]);
    assert_eq!(rates[STATES..], [0.0; 2], "at rest");
}
