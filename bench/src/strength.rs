//! How much an effect changes what the sensors show: the yardstick by which the demo draws its effect neither too weak to
//! matter nor absurdly gross.

use model::Parameters;
use model::effects::{Effect, EffectSet};
use model::integrate::Integrator;
use model::rec::{self, Circuit, Input, Lever, STATES, state};

/// Noise floors of the emulated rig's sensors: angle (deg, encoder step included), pressures (bar).
const FLOOR: [f64; 3] = [0.0118, 0.006, 0.006];
const TICKS: usize = 20_000;

/// RMS difference that these effect parameters make over 20 s of a square wave with the brake closed now and then, from the
/// reference model with the same base parameters, in noise floors of the channel where it is largest. `None` where either
/// can't be simulated.
pub fn strength(base: &Parameters, effect: &'static dyn Effect, values: &[f64]) -> Option<f64> {
    let without = trajectory(base, &EffectSet::none())?;
    let with = trajectory(base, &EffectSet::new(STATES, [(effect, values.to_vec())]))?;
    let mut square = [0.0; 3];
    for (a, b) in without.iter().zip(&with) {
        for c in 0..3 {
            square[c] += ((a[c] - b[c]) / FLOOR[c]).powi(2);
        }
    }
    Some(square.iter().map(|s| (s / TICKS as f64).sqrt()).fold(0.0, f64::max))
}

/// What the sensors show at each tick.
fn trajectory(base: &Parameters, effects: &EffectSet<f64>) -> Option<Vec<[f64; 3]>> {
    let k = base.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    x[state::PRESSURE1] = 2.8;
    x[state::PRESSURE2] = 2.8;
    rec::rest_states(&input(base, 0), &k, effects, &mut x);
    let integrator = Integrator::for_plant(1e-3, &k, effects, &[input(base, 0)], &x);
    let mut scratch = x.clone();
    let mut out = Vec::with_capacity(TICKS);
    for tick in 0..TICKS {
        let t = tick as f64 * 1e-3;
        out.push(rec::shown(effects, t, &x, &mut scratch));
        integrator.advance(&input(base, tick), &k, effects, t, 1e-3, &mut x).ok()?;
    }
    Some(out)
}

/// Rest for 1 s, then 0.9 u_max in turns of 4.5 s; every 2 s the brake is closed for 0.4 s.
fn input(base: &Parameters, tick: usize) -> Input {
    let level = 0.9 * base.pump.u_max;
    let voltage_v = match tick {
        0..1000 => 0.0,
        _ if ((tick - 1000 + 2250) / 4500).is_multiple_of(2) => level,
        _ => -level,
    };
    Input {
        voltage_v,
        brake_open: tick < 1000 || tick % 2000 > 400,
        bypass_open: false,
        vertical: false,
        lever: Lever::Free,
        circuit: Circuit::Pump,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grows_with_the_effect_and_is_zero_without() {
        let base = Parameters::example();
        let lag = model::effects::find("pump_lag").unwrap();
        // not 0: the plant with the effect has a step length of its own
        let none = strength(&base, lag, &[0.0]).unwrap();
        assert!(none < 1e-6, "{none}");
        let small = strength(&base, lag, &[0.005]).unwrap();
        let large = strength(&base, lag, &[0.02]).unwrap();
        assert!(small > 0.5 && large > 2.0 * small, "{small} {large}");
    }
}
