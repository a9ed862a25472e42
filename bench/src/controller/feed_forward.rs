//! What the identified model, with its effects, says about the rig: how much oil a motion takes, which pressures an angle asks for.

use super::effects::{Chambers, KnownEffects};
use super::seen::Seen;
use super::settings::ControllerError;
use model::Parameters;
use model::parameters::COUNT;
use model::parameters::index::{G, J, M1, M2, M3};
use model::rec::{STORED_FROM_BAR, capacity, displacement, losses, torque};
use rt_core::Tick;

/// The power law of the capacity, eq. (13), has no meaning at 0 bar and below.
const PRESSURE_FLOOR_BAR: f64 = 0.1;

/// Angles and pressures over which the model must make sense: what the supervisor lets happen by default.
const CHECKED_DEG: [f64; 3] = [-60.0, 0.0, 60.0];
const CHECKED_BAR: [f64; 3] = [0.5, STORED_FROM_BAR, 8.0];

/// Oil that the pump has to move for a unit of something, at one angle and one pair of pressures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oil {
    /// For 1 bar in chamber 1 or 2 while the lever stands, ml/bar.
    pub chambers_ml_bar: [f64; 2],
    /// For 1 bar of pressure difference while the lever stands, ml/bar: both chambers in series.
    pub series_ml_bar: f64,
    /// For 1 degree of the lever at a constant pressure difference, ml/deg.
    pub angle_ml_deg: f64,
    /// Leaks into chamber 1 or 2 (negative out of it), ml/s.
    pub leaks_ml_s: [f64; 2],
}

impl Oil {
    /// Flow that holds the pressure difference of a lever that stands against the leaks, ml/s.
    pub fn holding_ml_s(&self) -> f64 {
        let ([c1, c2], [q1, q2]) = (self.chambers_ml_bar, self.leaks_ml_s);
        (q2 * c1 - q1 * c2) / (c1 + c2)
    }
}

/// Rounds in which the torque of effects at the equilibrium is found; it depends on the pressure difference by a small share.
const ROUNDS: usize = 3;

/// The identified model: the reference model with those of its effects that have no memory. The others are left to the integrators.
#[derive(Clone, Debug)]
pub struct Plant {
    k: [f64; COUNT],
    /// Largest voltage either way, V.
    u_max_v: f64,
    vertical: bool,
    effects: KnownEffects,
}

impl Plant {
    /// The model of a rig with the lever's plane.
    ///
    /// # Errors
    /// A model that can't be inverted somewhere within +-60 degrees and 0.5..8 bar.
    pub fn new(parameters: &Parameters, effects: KnownEffects, vertical: bool) -> Result<Self, ControllerError> {
        let plant = Plant { k: parameters.to_vector(), u_max_v: parameters.pump.u_max, vertical, effects };
        let positive = |what, got: f64, at: &dyn Fn() -> String| {
            if got.is_finite() && got > 0.0 { Ok(()) } else { Err(ControllerError::Model { what, at: at(), got }) }
        };
        let everywhere = || "everywhere".to_owned();
        positive("largest voltage u_max, V,", plant.u_max_v, &everywhere)?;
        positive("gain f1 of the pump, ml/(s V),", parameters.pump.f1, &everywhere)?;
        positive("flow at u_max, ml/s,", plant.most_flow_ml_s(), &|| "at equal pressures".to_owned())?;
        positive("inertia J, kg m2,", parameters.load.J, &everywhere)?;
        for angle_deg in CHECKED_DEG {
            for pressure1_bar in CHECKED_BAR {
                for pressure2_bar in CHECKED_BAR {
                    let seen = Seen { angle_deg, pressure1_bar, pressure2_bar };
                    let at = || format!("at {angle_deg} deg, {pressure1_bar} bar and {pressure2_bar} bar");
                    let Oil { chambers_ml_bar: [chamber1, chamber2], angle_ml_deg, .. } = plant.oil(0.0, &seen);
                    positive("capacity of chamber 1, ml/bar,", chamber1, &at)?;
                    positive("capacity of chamber 2, ml/bar,", chamber2, &at)?;
                    positive("displacement, ml/deg,", angle_ml_deg, &at)?;
                }
            }
            for sign in [-1.0, 1.0] {
                let gain = plant.torque_gain_nm_bar(angle_deg.to_radians(), sign);
                positive("torque per pressure difference, Nm/bar,", gain, &|| format!("at {angle_deg} deg"))?;
            }
        }
        positive("stiffness of the lever on the oil, Nm/rad,", plant.stiffness_nm_rad(), &|| {
            format!("at 0 deg and {STORED_FROM_BAR} bar")
        })?;
        Ok(plant)
    }

    /// Flow at a time of the run (s), voltage (V) and pressures p1 and p2 (bar absolute), eq. (10) with its effects, ml/s.
    pub fn flow_ml_s(&self, time_s: f64, voltage_v: f64, pressure_bar: [f64; 2]) -> f64 {
        self.effects.flow_ml_s(&self.k, time_s, voltage_v, pressure_bar)
    }

    /// Voltage (V) for a flow at pressures p1 and p2 (bar absolute); `inverse` is that of eq. (10).
    pub fn voltage_v(&self, time_s: f64, flow_ml_s: f64, pressure_bar: [f64; 2], inverse: impl Fn(f64) -> f64) -> f64 {
        self.effects.voltage_v(&self.k, time_s, flow_ml_s, pressure_bar, inverse)
    }

    /// The pump's largest flow at equal pressures in the middle of their range, ml/s.
    pub fn most_flow_ml_s(&self) -> f64 {
        self.flow_ml_s(0.0, self.u_max_v, [STORED_FROM_BAR; 2])
    }

    /// How much oil a motion takes here, eqs. (7), (8), (13), (14) with the effects on them.
    pub fn oil(&self, time_s: f64, seen: &Seen) -> Oil {
        let angle_rad = seen.angle_deg.to_radians();
        let pressure_bar = [seen.pressure1_bar, seen.pressure2_bar].map(|p| p.max(PRESSURE_FLOOR_BAR));
        let own = (capacity(&self.k, angle_rad, pressure_bar), displacement(&self.k, angle_rad));
        let Chambers { capacity_ml_bar: chambers_ml_bar, displacement_ml_rad: [v1, v2], flow_ml_s: leaks_ml_s } =
            self.effects.chambers(&self.k, time_s, angle_rad, pressure_bar, own.0, own.1);
        let [c1, c2] = chambers_ml_bar;
        Oil {
            chambers_ml_bar,
            series_ml_bar: c1 * c2 / (c1 + c2),
            // What one chamber takes more than the other gives goes into both capacities.
            angle_ml_deg: ((v1 * c2 - v2 * c1) / (c1 + c2)).to_radians(),
            leaks_ml_s,
        }
    }

    /// Pressure difference at which the lever moves through this angle (degrees) at this velocity (degrees/s): eq. (2)
    /// against gravity, the losses (16) and the effects' torque, bar. `sum_bar`: p1 + p2.
    pub fn equilibrium_dp_bar(&self, time_s: f64, angle_deg: f64, velocity_deg_s: f64, sum_bar: f64) -> f64 {
        let angle_rad = angle_deg.to_radians();
        let weight_nm = if self.vertical { self.k[G] * angle_rad.sin() } else { 0.0 };
        let velocity_rad_s = velocity_deg_s.to_radians();
        let needed_nm = weight_nm + losses(&self.k, velocity_rad_s).0 - torque(&self.k, angle_rad, 0.0);
        let against = |needed_nm: f64| needed_nm / self.torque_gain_nm_bar(angle_rad, needed_nm.signum());
        let mut dp_bar = against(needed_nm);
        for _ in 0..ROUNDS {
            let motion = [angle_rad, velocity_rad_s];
            dp_bar = against(needed_nm - self.effects.torque_nm(time_s, motion, dp_bar, sum_bar, self.vertical));
        }
        dp_bar
    }

    /// Slope of eq. (2) over a pressure difference of this sign.
    fn torque_gain_nm_bar(&self, angle_rad: f64, sign: f64) -> f64 {
        self.k[M3] + sign * self.k[M1] * angle_rad
    }

    /// How hard the shut-in oil holds the lever in the middle of its range.
    fn stiffness_nm_rad(&self) -> f64 {
        let middle = Seen { angle_deg: 0.0, pressure1_bar: STORED_FROM_BAR, pressure2_bar: STORED_FROM_BAR };
        let Oil { angle_ml_deg, series_ml_bar, .. } = self.oil(0.0, &middle);
        let bar_per_rad = (angle_ml_deg / series_ml_bar).to_degrees();
        self.k[M3] * bar_per_rad - self.k[M2]
    }

    /// Frequency at which the lever swings on the oil in the middle of its range, Hz.
    pub fn lever_frequency_hz(&self) -> f64 {
        (self.stiffness_nm_rad() / self.k[J]).sqrt() / std::f64::consts::TAU
    }
}

/// Rate of a reference of which only the values are told.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rate {
    last: Option<(Tick, f64)>,
}

impl Rate {
    /// Change per second since the last call; 0 at the first. A change faster than `most` is a step and has no rate.
    pub fn per_s(&mut self, now: Tick, value: f64, most: f64) -> f64 {
        let Some((then, before)) = self.last.replace((now, value)) else { return 0.0 };
        let elapsed_s = now.scheduled_ns.saturating_sub(then.scheduled_ns) as f64 * 1e-9;
        let rate = (value - before) / elapsed_s;
        if rate.abs() <= most { rate } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plant(vertical: bool) -> Plant {
        Plant::new(&Parameters::example(), KnownEffects::none(), vertical).expect("a sound model")
    }

    proptest! {
        #[test]
        fn a_lever_at_its_equilibrium_pressure_does_not_accelerate(
            angle_deg in -60.0..60.0_f64, velocity_deg_s in -30.0..30.0_f64, vertical: bool,
        ) {
            let plant = plant(vertical);
            let dp_bar = plant.equilibrium_dp_bar(0.0, angle_deg, velocity_deg_s, 5.0);
            let k = Parameters::example().to_vector();
            let (phi, w) = (angle_deg.to_radians(), velocity_deg_s.to_radians());
            let weight = if vertical { 4.0 * phi.sin() } else { 0.0 };
            prop_assert!((torque(&k, phi, dp_bar) - weight - losses(&k, w).0).abs() < 1e-9);
            let mirrored = plant.equilibrium_dp_bar(0.0, -angle_deg, -velocity_deg_s, 5.0);
            prop_assert!((dp_bar + mirrored).abs() < 1e-12);
        }

        #[test]
        fn the_oil_for_a_motion_keeps_the_pressure_difference_and_that_for_a_bar_makes_a_bar(
            angle_deg in -60.0..60.0_f64, pressure1_bar in 0.5..8.0_f64, pressure2_bar in 0.5..8.0_f64,
        ) {
            let plant = plant(false);
            let seen = Seen { angle_deg, pressure1_bar, pressure2_bar };
            let Oil { chambers_ml_bar: [c1, c2], angle_ml_deg, series_ml_bar, .. } = plant.oil(0.0, &seen);
            let [v1, v2] = displacement(&Parameters::example().to_vector(), angle_deg.to_radians());
            // 1 degree a second, eqs. (7) and (8)
            let rates = |flow: f64, w: f64| [(flow - v1 * w) / c1, (-flow - v2 * w) / c2];
            let moving = rates(angle_ml_deg, 1.0_f64.to_radians());
            prop_assert!((moving[0] - moving[1]).abs() < 1e-9, "{moving:?}");
            let held = rates(series_ml_bar, 0.0);
            prop_assert!((held[0] - held[1] - 1.0).abs() < 1e-9, "{held:?}");
        }
    }

    #[test]
    fn the_lever_swings_at_10_hz() {
        let hz = plant(false).lever_frequency_hz();
        assert!((9.0..12.0).contains(&hz), "{hz}");
    }

    #[test]
    fn a_model_that_cannot_be_inverted_is_refused_by_name() {
        for (change, expected) in [
            ((|p| p.pump.f1 = 0.0) as fn(&mut Parameters), "f1"),
            (|p| p.torque.m3 = 1.0, "torque per pressure difference"),
            (|p| p.displacement.v2 = -68.0, "displacement"),
            (|p| p.capacity.h3 = -1.0, "capacity of chamber"),
            (|p| p.load.J = f64::NAN, "inertia"),
            (|p| p.pump.u_max = 0.5, "flow at u_max"),
        ] {
            let mut parameters = Parameters::example();
            change(&mut parameters);
            let error = Plant::new(&parameters, KnownEffects::none(), false).expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_reference_has_a_rate_over_skipped_ticks_and_a_step_has_none() {
        let mut rate = Rate::default();
        assert_eq!(rate.per_s(Tick::at(5), 2.0, 10.0), 0.0);
        assert!((rate.per_s(Tick::at(6), 2.001, 10.0) - 1.0).abs() < 1e-9);
        assert!((rate.per_s(Tick::at(16), 2.011, 10.0) - 1.0).abs() < 1e-9);
        assert_eq!(rate.per_s(Tick::at(17), 3.0, 10.0), 0.0, "989 a second");
        assert_eq!(rate.per_s(Tick::at(17), 3.5, 10.0), 0.0, "no time has passed");
    }
}
