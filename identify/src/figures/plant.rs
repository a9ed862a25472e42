//! The characteristics of a fitted model as an experiment would see them: each with everything that acts on it, effects too.

use model::effects::EffectSet;
use model::parameters::index;
use model::rec::{self, Circuit, Derived, Input, Lever, STATES, state};

use crate::fit::Fit;

/// A fitted model at rest in chosen states.
pub struct Plant {
    k: Vec<f64>,
    effects: EffectSet<f64>,
}

impl Plant {
    /// The fit with its effects.
    pub fn of(fit: &Fit) -> Self {
        let (k, effects) = fit.layout.expand(&fit.point.theta);
        Plant { k, effects }
    }

    /// The parameter vector ([`model::parameters::NAMES`]).
    pub fn parameters(&self) -> &[f64] {
        &self.k
    }

    fn at(
        &self,
        input: &Input,
        angle_deg: f64,
        velocity_rad_s: f64,
        pressure_bar: [f64; 2],
    ) -> (Vec<f64>, Derived<f64>) {
        let mut x = vec![0.0; STATES + self.effects.states];
        x[state::ANGLE] = angle_deg.to_radians();
        x[state::VELOCITY] = velocity_rad_s;
        x[state::PRESSURE1] = pressure_bar[0];
        x[state::PRESSURE2] = pressure_bar[1];
        rec::rest_states(input, &self.k, &self.effects, &mut x);
        let mut dx = vec![0.0; x.len()];
        let derived = rec::derivative(input, &self.k, &self.effects, 0.0, &x, &mut dx);
        (dx, derived)
    }

    /// Torque (Nm) that a clamp at this angle holds; pressures in bar absolute.
    pub fn held_torque_nm(&self, angle_deg: f64, pressure_bar: [f64; 2], vertical: bool) -> f64 {
        let input = Input { vertical, ..clamped(Circuit::Pump) };
        self.at(&input, angle_deg, 0.0, pressure_bar).1.torque_nm
    }

    /// Flow (ml/s) of the pump alone at a constant voltage (V), steady, oil cold.
    pub fn pump_flow_ml_s(&self, voltage_v: f64, dp_bar: f64) -> f64 {
        let input = Input { voltage_v, brake_open: true, ..clamped(Circuit::Bench) };
        // only the difference matters; both pressures stay positive
        let low = 1.0 + (-dp_bar).max(0.0);
        self.at(&input, 0.0, 0.0, [low + dp_bar, low]).1.flow_ml_s
    }

    /// Capacity (ml/bar) of chamber 1 with the lever clamped: what a release of 1 ml/s does to the pressure.
    pub fn capacity_ml_bar(&self, angle_deg: f64, pressure_bar: f64) -> f64 {
        let rate = |release_ml_s: f64| {
            let input = clamped(Circuit::ShutOff { release_ml_s });
            self.at(&input, angle_deg, 0.0, [pressure_bar; 2]).0[state::PRESSURE1]
        };
        1.0 / (rate(0.0) - rate(1.0))
    }

    /// Torque (Nm) that motion at this velocity costs in the horizontal plane, with both pressures at half of `load_bar`.
    pub fn loss_nm(&self, velocity_rad_s: f64, load_bar: f64) -> f64 {
        let input = Input { lever: Lever::Free, brake_open: true, ..clamped(Circuit::Pump) };
        let pressure = [0.5 * load_bar; 2];
        let (dx, _) = self.at(&input, 0.0, velocity_rad_s, pressure);
        self.torque_nm(0.0, 0.0) - self.k[index::J] * dx[state::VELOCITY]
    }

    /// Eq. (2), Nm.
    pub fn torque_nm(&self, angle_deg: f64, dp_bar: f64) -> f64 {
        rec::torque(&self.k, angle_deg.to_radians(), dp_bar)
    }
}

fn clamped(circuit: Circuit) -> Input {
    Input {
        voltage_v: 0.0,
        brake_open: false,
        bypass_open: false,
        vertical: false,
        lever: Lever::Led { velocity_rad_s: 0.0 },
        circuit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Layout;
    use crate::problem::Point;
    use model::Parameters;
    use model::effects;

    fn fit(effects: &[(&str, &[f64])]) -> Fit {
        let mut layout = Layout::base(&Parameters::example());
        let mut theta = layout.vector_of(&Parameters::example());
        for (id, values) in effects {
            layout.effects.push(effects::find(id).unwrap());
            theta.extend_from_slice(values);
        }
        Fit { layout, point: Point { theta, initial: Vec::new() }, cost: 0.0, converged: true }
    }

    #[test]
    fn characteristics_are_the_component_equations() {
        let plant = Plant::of(&fit(&[]));
        let p = Parameters::example();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
        let phi = 20f64.to_radians();
        close(plant.held_torque_nm(20.0, [3.0, 2.0], false), (p.torque.m1 + p.torque.m2) * phi + p.torque.m3);
        close(plant.held_torque_nm(20.0, [2.0, 2.0], true), p.torque.m2 * phi - p.load.G * phi.sin());
        close(plant.pump_flow_ml_s(-12.0, -2.0), -(0.61 * 12.0 - 0.60 + 0.005 * 24.0) + 0.25 * 2.0);
        close(plant.pump_flow_ml_s(0.5, 1.0), -0.25);
        close(plant.capacity_ml_bar(-10.0, 3.0), (0.08f64).exp() * (7.6 * 3f64.powf(-1.5) + 0.9));
        close(plant.loss_nm(0.5, 6.0), 1.2 * 0.25 + 2.4 * 0.5 + 1.1);
        close(plant.loss_nm(-0.01, 6.0), -57.424 * 0.01);
    }

    #[test]
    fn an_effect_shows_in_the_characteristic_that_it_acts_on() {
        let header = effects::find("pressure_friction").unwrap().header();
        let with = Plant::of(&fit(&[("pressure_friction", header.starts[0])]));
        let base = Plant::of(&fit(&[]));
        assert!(with.loss_nm(0.5, 8.0) > base.loss_nm(0.5, 8.0) + 1e-3);
        assert_eq!(with.capacity_ml_bar(0.0, 3.0), base.capacity_ml_bar(0.0, 3.0));
        let cubic = effects::find("torque_cubic").unwrap().header();
        let with = Plant::of(&fit(&[("torque_cubic", cubic.starts[0])]));
        assert_ne!(with.held_torque_nm(40.0, [3.0, 2.0], false), base.held_torque_nm(40.0, [3.0, 2.0], false));
        let air = effects::find("trapped_air").unwrap().header();
        let with = Plant::of(&fit(&[("trapped_air", air.starts[0])]));
        assert!(with.capacity_ml_bar(0.0, 1.5) > base.capacity_ml_bar(0.0, 1.5));
    }
}
