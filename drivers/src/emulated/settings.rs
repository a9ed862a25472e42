//! What an emulated rig is made with, and what it can't be.

use rt_core::{Command, Fixture};

/// Everything about the emulated rig but its plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// What is in force before the first tick. A free lever stands in its equilibrium, a held one at its angle.
    pub start: Command,
    /// Pressure of both chambers before the first tick, bar absolute.
    pub fill_bar: f64,
    /// Gravity acts on the lever.
    pub vertical: bool,
    /// Seed of the sensors' noise and the operator's hand. Two runs of a campaign need two seeds.
    pub seed: u64,
    /// The sensors.
    pub noise: Noise,
    /// Relative standard deviation of a released amount: an operator's hand.
    pub release_spread: f64,
    /// Oil in chamber 1 at angle 0 and `oil_at_bar`, ml.
    pub oil_ml: f64,
    /// Pressure to which `oil_ml` refers, bar absolute.
    pub oil_at_bar: f64,
    /// Fastest motion of a led lever, degrees a second.
    pub lever_speed_deg_s: f64,
    /// Longest inner step of the integration while the lever is free, s.
    pub step_s: f64,
}

impl Default for Settings {
    /// A free horizontal lever with a bare minimum of everything said: fill, start and seed are the run's to choose.
    fn default() -> Self {
        Settings {
            start: Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 },
            fill_bar: 2.8,
            vertical: false,
            seed: 0,
            noise: Noise::default(),
            release_spread: 0.08,
            oil_ml: 100.0,
            oil_at_bar: 2.75,
            lever_speed_deg_s: 30.0,
            step_s: 5e-4,
        }
    }
}

/// The sensors' errors; each is a standard deviation of white noise unless it says otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Step of the encoder, degrees; 0 = none. 14 bit a turn by default.
    pub encoder_step_deg: f64,
    /// Encoder, before its steps, degrees.
    pub angle_deg: f64,
    /// Each pressure sensor, bar.
    pub pressure_bar: f64,
    /// Force sensor, Nm.
    pub torque_nm: f64,
    /// One reading of the measuring cylinder, ml.
    pub volume_ml: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Noise {
            encoder_step_deg: 360.0 / 16384.0,
            angle_deg: 0.01,
            pressure_bar: 0.006,
            torque_nm: 0.05,
            volume_ml: 0.05,
        }
    }
}

impl Noise {
    /// Perfect sensors.
    pub const NONE: Noise =
        Noise { encoder_step_deg: 0.0, angle_deg: 0.0, pressure_bar: 0.0, torque_nm: 0.0, volume_ml: 0.0 };
}

/// Why an emulated rig can't be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EmulatedError {
    /// A setting is out of range.
    #[error("emulated rig: `{setting}` must lie within {low} .. {high}, got {got}")]
    Setting {
        /// Field of the settings.
        setting: &'static str,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
        /// What came.
        got: f64,
    },
    /// The state before the first tick is none that the rig could be told.
    #[error("emulated rig: `start`: {what}")]
    Start {
        /// Expected and got.
        what: String,
    },
    /// Too many effects with states.
    #[error("emulated rig: expected at most {most} states of plant and effects, got {states}: take fewer effects")]
    States {
        /// What came.
        states: usize,
        /// What the integrator holds.
        most: usize,
    },
    /// A free lever would run away.
    #[error(
        "emulated rig: a free lever has no equilibrium within {range_deg:.0} degrees either way: expected a torque that drives it back, got {at_low:.3} Nm at the low end and {at_high:.3} Nm at the high end"
    )]
    NoEquilibrium {
        /// Searched on both sides, degrees.
        range_deg: f64,
        /// Torque at the low end, Nm.
        at_low: f64,
        /// Torque at the high end, Nm.
        at_high: f64,
    },
}

impl Settings {
    /// Checks every range.
    pub(super) fn check(&self, u_max_v: f64) -> Result<(), EmulatedError> {
        let Noise { encoder_step_deg, angle_deg, pressure_bar, torque_nm, volume_ml } = self.noise;
        let checks = [
            ("u_max of the pump", u_max_v, 1e-3, 1e4),
            ("fill_bar", self.fill_bar, 0.1, 20.0),
            ("noise.encoder_step_deg", encoder_step_deg, 0.0, 90.0),
            ("noise.angle_deg", angle_deg, 0.0, 90.0),
            ("noise.pressure_bar", pressure_bar, 0.0, 10.0),
            ("noise.torque_nm", torque_nm, 0.0, 1e3),
            ("noise.volume_ml", volume_ml, 0.0, 1e3),
            ("release_spread", self.release_spread, 0.0, 0.3),
            ("oil_ml", self.oil_ml, 0.0, 1e4),
            ("oil_at_bar", self.oil_at_bar, 0.1, 20.0),
            ("lever_speed_deg_s", self.lever_speed_deg_s, 0.1, 1e3),
            ("step_s", self.step_s, 1e-6, 1e-3),
        ];
        for (setting, got, low, high) in checks {
            if !(low..=high).contains(&got) {
                return Err(EmulatedError::Setting { setting, low, high, got });
            }
        }
        check_command(&self.start, u_max_v).map_err(|what| EmulatedError::Start { what })
    }
}

/// Largest angle at which a lever can be held, degrees either way.
const MOST_DEG: f64 = 60.0;
/// Range of pressures that an operator can set, bar absolute.
const PRESSURES_BAR: std::ops::RangeInclusive<f64> = 0.1..=20.0;

/// What no rig could be told; says expected and got.
pub(super) fn check_command(command: &Command, u_max_v: f64) -> Result<(), String> {
    let Command { voltage_v, brake_open, bypass_open, fixture, .. } = *command;
    // The last digits are those of a fraction times u_max.
    if voltage_v.is_nan() || voltage_v.abs() > u_max_v * (1.0 + 1e-12) {
        return Err(format!("expected a voltage within +-{u_max_v} V, got {voltage_v} V"));
    }
    let angle = |angle_deg: f64| {
        if angle_deg.abs() <= MOST_DEG {
            Ok(())
        } else {
            Err(format!("expected the lever to be held within +-{MOST_DEG} degrees, got {angle_deg}"))
        }
    };
    let pressure = |name: &str, pressure_bar: f64| {
        if PRESSURES_BAR.contains(&pressure_bar) {
            Ok(())
        } else {
            let (low, high) = (PRESSURES_BAR.start(), PRESSURES_BAR.end());
            Err(format!("expected {name} within {low} .. {high} bar absolute, got {pressure_bar}"))
        }
    };
    match fixture {
        Fixture::Free => Ok(()),
        Fixture::Clamped { angle_deg } | Fixture::Driven { angle_deg } => angle(angle_deg),
        Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } => {
            angle(angle_deg)?;
            pressure("pressure 1", pressure1_bar)?;
            pressure("pressure 2", pressure2_bar)
        }
        Fixture::Released { angle_deg, flow_ml_s } => {
            angle(angle_deg)?;
            if !(0.0..=1e3).contains(&flow_ml_s) {
                return Err(format!("expected a release of 0 .. 1000 ml/s out of chamber 1, got {flow_ml_s}"));
            }
            if brake_open || bypass_open {
                return Err("expected brake and bypass closed while oil is released, got an open valve".to_owned());
            }
            Ok(())
        }
        Fixture::PumpBench { pressure1_bar, pressure2_bar } => {
            pressure("the reservoir at port 1", pressure1_bar)?;
            pressure("the reservoir at port 2", pressure2_bar)
        }
    }
}
