//! What the supervisor enforces. Limits are data: a rig brings its own.

use crate::supervisor::VELOCITY_WINDOW_MAX;
use crate::types::{PERIOD_NS, SafeState};

const PERIOD_MS: f64 = PERIOD_NS as f64 * 1e-6;
/// Ages are counted in ns up to `u32::MAX`: none is above it, and a limit that is no less never trips.
const AGE_MOST_MS: f64 = u32::MAX as f64 * 1e-6;

/// What the supervisor enforces. Limits are data: a rig brings its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest pressure of either chamber, bar absolute.
    pub pressure_min_bar: f64,
    /// Highest pressure of either chamber, bar absolute.
    pub pressure_max_bar: f64,
    /// Largest angle to either side, degrees.
    pub angle_max_deg: f64,
    /// Largest velocity in either direction, degrees per second; judged while the lever is free.
    pub velocity_max_deg_s: f64,
    /// The velocity is the difference of two angles this many ticks apart, 1..=[`VELOCITY_WINDOW_MAX`]: one tick of
    /// an encoder with 0.05 deg of noise would already read as 70 deg/s.
    pub velocity_window_ticks: u32,
    /// Largest torque on the clamp to either side, Nm; judged where it is measured.
    pub torque_max_nm: f64,
    /// A required channel may be missing for this many ticks in a row; one more trips.
    pub missing_max_ticks: u32,
    /// A required channel may be this old, ms; one that is older trips. At least one period, and below 4294.967295 ms, where ages end.
    pub age_max_ms: f64,
    /// The drivers may be silent for this long, ms. Below 4294.967295 ms, where ages end.
    pub heartbeat_max_ms: f64,
    /// Largest command to either side, V; above it trips.
    pub voltage_max_v: f64,
    /// The command follows no faster than this, V/s; infinite = at once. It is held back, not tripped.
    pub slew_max_v_s: f64,
    /// Where the valves go on a trip and at the end of a run.
    pub safe_state: SafeState,
    /// After a trip the run goes on for this many ticks in the safe state, so that the recording holds what followed.
    pub aftermath_ticks: u64,
}

impl Default for Limits {
    /// For an actuator of the paper's size: its chambers work at 1.2..6 bar and its lever at -40..40 degrees.
    fn default() -> Self {
        Limits {
            pressure_min_bar: 0.5,
            pressure_max_bar: 8.0,
            angle_max_deg: 60.0,
            velocity_max_deg_s: 1000.0,
            velocity_window_ticks: 10,
            torque_max_nm: 80.0,
            missing_max_ticks: 20,
            age_max_ms: 20.0,
            heartbeat_max_ms: 100.0,
            voltage_max_v: 48.0,
            slew_max_v_s: f64::INFINITY,
            safe_state: SafeState::default(),
            aftermath_ticks: 500,
        }
    }
}

/// Limits that can't be enforced.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("limits: {field} must be {expected}, got {got}")]
pub struct LimitsError {
    /// Name of the field.
    pub field: &'static str,
    /// What it must be.
    pub expected: String,
    /// What it is.
    pub got: f64,
}

impl Limits {
    /// Whether each limit is a number that can be enforced.
    pub fn validate(&self) -> Result<(), LimitsError> {
        let check = |field, got: f64, valid: bool, expected: &str| {
            if valid { Ok(()) } else { Err(LimitsError { field, expected: expected.to_owned(), got }) }
        };
        let positive = |field, got: f64| check(field, got, got.is_finite() && got > 0.0, "finite and above 0");
        let finite = self.pressure_min_bar.is_finite();
        check("pressure_min_bar", self.pressure_min_bar, finite, "finite")?;
        positive("pressure_max_bar", self.pressure_max_bar)?;
        let ordered = self.pressure_max_bar > self.pressure_min_bar;
        check("pressure_max_bar", self.pressure_max_bar, ordered, "above pressure_min_bar")?;
        positive("angle_max_deg", self.angle_max_deg)?;
        positive("velocity_max_deg_s", self.velocity_max_deg_s)?;
        positive("torque_max_nm", self.torque_max_nm)?;
        let age_ms = self.age_max_ms;
        let expected = format!("at least 1, a period, and below {AGE_MOST_MS:.6}, the largest age that is told");
        check("age_max_ms", age_ms, (PERIOD_MS..AGE_MOST_MS).contains(&age_ms), &expected)?;
        let silent_ms = self.heartbeat_max_ms;
        let expected = format!("above 0 and below {AGE_MOST_MS:.6}, the largest age that is told");
        check("heartbeat_max_ms", silent_ms, silent_ms > 0.0 && silent_ms < AGE_MOST_MS, &expected)?;
        positive("voltage_max_v", self.voltage_max_v)?;
        check("slew_max_v_s", self.slew_max_v_s, self.slew_max_v_s > 0.0, "above 0, infinite for none")?;
        let window = self.velocity_window_ticks;
        let fits = (1..=VELOCITY_WINDOW_MAX as u32).contains(&window);
        check("velocity_window_ticks", f64::from(window), fits, &format!("1..={VELOCITY_WINDOW_MAX}"))
    }
}
