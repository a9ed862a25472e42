//! The quantities that a script can ask the controller to reach.

use crate::script::{ANGLE_LIMIT_DEG, PRESSURE_LIMIT_BAR};
use rt_core::{ControlledPressure, Measurement, Target};
use serde::Deserialize;

/// Lowest absolute pressure that a script may ask for, bar: next to vacuum.
pub(crate) const PRESSURE_LEAST_BAR: f64 = 0.1;

/// A controlled quantity, as a script names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Controlled {
    VoltageV,
    VoltageUMax,
    FlowMlS,
    #[serde(rename = "pressure1_bar")]
    Pressure1Bar,
    #[serde(rename = "pressure2_bar")]
    Pressure2Bar,
    PressureDifferenceBar,
    AngleDeg,
}

impl Controlled {
    #[cfg(test)]
    pub const ALL: [Controlled; 7] = [
        Controlled::VoltageV,
        Controlled::VoltageUMax,
        Controlled::FlowMlS,
        Controlled::Pressure1Bar,
        Controlled::Pressure2Bar,
        Controlled::PressureDifferenceBar,
        Controlled::AngleDeg,
    ];

    pub fn as_str(self) -> &'static str {
        match self {
            Controlled::VoltageV => "voltage_v",
            Controlled::VoltageUMax => "voltage_u_max",
            Controlled::FlowMlS => "flow_ml_s",
            Controlled::Pressure1Bar => "pressure1_bar",
            Controlled::Pressure2Bar => "pressure2_bar",
            Controlled::PressureDifferenceBar => "pressure_difference_bar",
            Controlled::AngleDeg => "angle_deg",
        }
    }

    /// What a script may ask for on any rig. The limit of `voltage_v` is the rig's own; the flow has none but the pump's.
    pub fn bounds(self) -> (f64, f64) {
        match self {
            Controlled::VoltageV | Controlled::FlowMlS => (f64::MIN, f64::MAX),
            Controlled::VoltageUMax => (-1.0, 1.0),
            Controlled::Pressure1Bar | Controlled::Pressure2Bar => (PRESSURE_LEAST_BAR, PRESSURE_LIMIT_BAR),
            Controlled::PressureDifferenceBar => {
                (PRESSURE_LEAST_BAR - PRESSURE_LIMIT_BAR, PRESSURE_LIMIT_BAR - PRESSURE_LEAST_BAR)
            }
            Controlled::AngleDeg => (-ANGLE_LIMIT_DEG, ANGLE_LIMIT_DEG),
        }
    }

    /// The loop's target with this value and its rate per second; a fraction of u_max has become volts.
    pub fn target(self, value: f64, rate_per_s: f64) -> Target {
        let pressure = |of| Target::PressureBar { of, bar: value };
        match self {
            Controlled::VoltageV | Controlled::VoltageUMax => Target::VoltageV(value),
            Controlled::FlowMlS => Target::FlowMlS(value),
            Controlled::Pressure1Bar => pressure(ControlledPressure::Chamber1),
            Controlled::Pressure2Bar => pressure(ControlledPressure::Chamber2),
            Controlled::PressureDifferenceBar => pressure(ControlledPressure::Difference),
            Controlled::AngleDeg => Target::AngleDeg { angle_deg: value, velocity_deg_s: rate_per_s },
        }
    }

    /// Where a ramp of this quantity begins: at the target in force where that is of the same kind, otherwise at what is
    /// measured, or, as nothing measures voltage and flow, at rest. `None` where the measurement is missing.
    pub fn begin(self, in_force: Target, measured: &Measurement) -> Option<f64> {
        let same_kind = match (self, in_force) {
            (Controlled::VoltageV | Controlled::VoltageUMax, Target::VoltageV(value)) => Some(value),
            (Controlled::FlowMlS, Target::FlowMlS(value)) => Some(value),
            (Controlled::AngleDeg, Target::AngleDeg { angle_deg, .. }) => Some(angle_deg),
            (_, Target::PressureBar { bar, .. }) if self.target(bar, 0.0) == in_force => Some(bar),
            _ => None,
        };
        let actual = match self {
            Controlled::VoltageV | Controlled::VoltageUMax | Controlled::FlowMlS => 0.0,
            Controlled::Pressure1Bar => measured.pressure1_bar,
            Controlled::Pressure2Bar => measured.pressure2_bar,
            Controlled::PressureDifferenceBar => measured.pressure1_bar - measured.pressure2_bar,
            Controlled::AngleDeg => measured.angle_deg,
        };
        let (low, high) = self.bounds();
        // A rig beyond the range is led back into it, not along with it.
        same_kind.or(actual.is_finite().then(|| actual.clamp(low, high)))
    }
}
