//! `[limits]` and `[safe_state]` as they are written, in a rig file and in a recording's notes.

use rt_core::{Limits, SafeState};
use serde::{Deserialize, Serialize};

/// The limits as they are written; what is left out stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawLimits {
    pressure_min_bar: Option<f64>,
    pressure_max_bar: Option<f64>,
    angle_max_deg: Option<f64>,
    velocity_max_deg_s: Option<f64>,
    velocity_window_ticks: Option<u32>,
    torque_max_nm: Option<f64>,
    missing_max_ticks: Option<u32>,
    age_max_ms: Option<f64>,
    heartbeat_max_ms: Option<f64>,
    voltage_max_v: Option<f64>,
    slew_max_v_s: Option<f64>,
    aftermath_ticks: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawSafeState {
    brake: Option<Valve>,
    bypass: Option<Valve>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Valve {
    Open,
    Closed,
}

impl From<bool> for Valve {
    fn from(open: bool) -> Self {
        if open { Valve::Open } else { Valve::Closed }
    }
}

impl RawLimits {
    /// Everything that is enforced, spelled out.
    pub(crate) fn of(limits: &Limits) -> Self {
        RawLimits {
            pressure_min_bar: Some(limits.pressure_min_bar),
            pressure_max_bar: Some(limits.pressure_max_bar),
            angle_max_deg: Some(limits.angle_max_deg),
            velocity_max_deg_s: Some(limits.velocity_max_deg_s),
            velocity_window_ticks: Some(limits.velocity_window_ticks),
            torque_max_nm: Some(limits.torque_max_nm),
            missing_max_ticks: Some(limits.missing_max_ticks),
            age_max_ms: Some(limits.age_max_ms),
            heartbeat_max_ms: Some(limits.heartbeat_max_ms),
            voltage_max_v: Some(limits.voltage_max_v),
            slew_max_v_s: Some(limits.slew_max_v_s),
            aftermath_ticks: Some(limits.aftermath_ticks),
        }
    }

    /// These limits over `defaults`.
    pub(crate) fn over(self, defaults: Limits) -> Limits {
        Limits {
            pressure_min_bar: self.pressure_min_bar.unwrap_or(defaults.pressure_min_bar),
            pressure_max_bar: self.pressure_max_bar.unwrap_or(defaults.pressure_max_bar),
            angle_max_deg: self.angle_max_deg.unwrap_or(defaults.angle_max_deg),
            velocity_max_deg_s: self.velocity_max_deg_s.unwrap_or(defaults.velocity_max_deg_s),
            velocity_window_ticks: self.velocity_window_ticks.unwrap_or(defaults.velocity_window_ticks),
            torque_max_nm: self.torque_max_nm.unwrap_or(defaults.torque_max_nm),
            missing_max_ticks: self.missing_max_ticks.unwrap_or(defaults.missing_max_ticks),
            age_max_ms: self.age_max_ms.unwrap_or(defaults.age_max_ms),
            heartbeat_max_ms: self.heartbeat_max_ms.unwrap_or(defaults.heartbeat_max_ms),
            voltage_max_v: self.voltage_max_v.unwrap_or(defaults.voltage_max_v),
            slew_max_v_s: self.slew_max_v_s.unwrap_or(defaults.slew_max_v_s),
            aftermath_ticks: self.aftermath_ticks.unwrap_or(defaults.aftermath_ticks),
            safe_state: defaults.safe_state,
        }
    }
}

impl RawSafeState {
    pub(crate) fn of(state: SafeState) -> Self {
        RawSafeState { brake: Some(state.brake_open.into()), bypass: Some(state.bypass_open.into()) }
    }

    pub(crate) fn over(self, defaults: SafeState) -> SafeState {
        let open = |valve: Option<Valve>, default| valve.map_or(default, |valve| valve == Valve::Open);
        SafeState {
            brake_open: open(self.brake, defaults.brake_open),
            bypass_open: open(self.bypass, defaults.bypass_open),
        }
    }
}
