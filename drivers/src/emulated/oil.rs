//! The oil in chamber 1 after a filling, from the plant's own displacement and capacity.

use super::settings::Settings;
use model::effects::EffectSet;
use model::integrate::MOST_STATES;
use model::rec::{self, Circuit, Input, Lever, state};

/// Gauss's rule of 12 points on -1 .. 1, along the angle and along the pressure: positive abscissae and weights. A filling happens
/// within a tick, so it takes few points; between 0.5 and 2.75 bar their error is below 1e-8 of the amount.
const GAUSS: [(f64, f64); 6] = [
    (0.1252334085114689, 0.2491470458134028),
    (0.3678314989981802, 0.2334925365383548),
    (0.5873179542866175, 0.2031674267230659),
    (0.7699026741943047, 0.1600783285433462),
    (0.904117256370475, 0.1069393259953184),
    (0.9815606342467193, 0.0471753363865118),
];

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
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    GAUSS.iter().map(|(at, weight)| weight * (f(middle - half * at) + f(middle + half * at))).sum::<f64>() * half
}

#[cfg(test)]
mod tests {
    use super::integral;

    #[test]
    fn the_quadrature_holds_where_the_capacity_is_steepest() {
        // h1 p^-1.5 over pressure, and a polynomial of the highest degree that the rule takes exactly
        let (low, high) = (0.5_f64, 2.75_f64);
        let exact = 2.0 * (1.0 / low.sqrt() - 1.0 / high.sqrt());
        assert!((integral(low, high, |p| p.powf(-1.5)) / exact - 1.0).abs() < 1e-8);
        assert!((integral(high, low, |p| p.powf(-1.5)) / exact + 1.0).abs() < 1e-8);
        assert!((integral(0.0, 2.0, |x| x.powi(23)) / (2.0_f64.powi(24) / 24.0) - 1.0).abs() < 1e-13);
        assert_eq!(integral(1.5, 1.5, |_| 1.0), 0.0);
    }
}
