//! The oil in chamber 1 after a filling, from the plant's own displacement and capacity.

use super::settings::Settings;
use model::effects::EffectSet;
use model::integrate::MOST_STATES;
use model::rec::{self, Circuit, Input, Lever, state};

/// Points of the quadrature along the angle, and along the pressure: Simpson's rule, odd.
const POINTS: usize = 65;

/// Oil in chamber 1 (ml) in state `x`: from the setting's amount along the angle at its pressure, then along the pressure at the
/// angle. The plant, effects included, says dV/dphi and dV/dp itself: with chambers whose pressures are given, what
/// must leave chamber 1 for a unit of velocity or of pressure rate.
pub(super) fn in_chamber1_ml(k: &[f64], effects: &EffectSet<f64>, settings: &Settings, x: &[f64]) -> f64 {
    let input = Input {
        voltage_v: 0.0,
        brake_open: false,
        bypass_open: false,
        vertical: settings.vertical,
        lever: Lever::Led { velocity_rad_s: 0.0 },
        circuit: Circuit::Measured { rate1_bar_s: 0.0, rate2_bar_s: 0.0 },
    };
    let taken_up = |angle_rad: f64, pressure_bar: f64, velocity_rad_s: f64, rate1_bar_s: f64| {
        let mut at = [0.0; MOST_STATES];
        at[..x.len()].copy_from_slice(x);
        at[state::ANGLE] = angle_rad;
        at[state::PRESSURE1] = pressure_bar;
        let leaves_ml_s = |input: &Input| {
            let mut dx = [0.0; MOST_STATES];
            rec::derivative(input, k, effects, 0.0, &at[..x.len()], &mut dx[..x.len()]);
            dx[state::VOLUME]
        };
        let moved = Input {
            lever: Lever::Led { velocity_rad_s },
            circuit: Circuit::Measured { rate1_bar_s, rate2_bar_s: 0.0 },
            ..input
        };
        leaves_ml_s(&input) - leaves_ml_s(&moved)
    };
    let (angle, pressure) = (x[state::ANGLE], x[state::PRESSURE1]);
    settings.oil_ml
        + integral(0.0, angle, |phi| taken_up(phi, settings.oil_at_bar, 1.0, 0.0))
        + integral(settings.oil_at_bar, pressure, |p| taken_up(angle, p, 0.0, 1.0))
}

fn integral(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
    let step = (to - from) / (POINTS - 1) as f64;
    let weight = |i: usize| {
        if i == 0 || i == POINTS - 1 {
            1.0
        } else if i % 2 == 1 {
            4.0
        } else {
            2.0
        }
    };
    (0..POINTS).map(|i| weight(i) * f(from + i as f64 * step)).sum::<f64>() * step / 3.0
}
