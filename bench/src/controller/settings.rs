//! How fast and how calm the closed loops are.

use super::feed_forward::Plant;
use serde::{Deserialize, Serialize};

/// Settings of the closed loops. Gains are no settings: they follow from the identified model by the rule in
/// [`super::pi`], and from the bandwidths here.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Bandwidth of the angle, Hz: an error falls by 1/e in 1/(2 pi f). At most a quarter of the frequency at which the
    /// lever swings on the oil, by the model.
    pub angle_bandwidth_hz: f64,
    /// How fast the integrator of the angle learns what the model is wrong about, Hz; 0 = no integrator.
    pub angle_integral_hz: f64,
    /// An angle this close is reached, degrees. Keeps the encoder's steps from the pump.
    pub angle_deadband_deg: f64,
    /// Bandwidth of a pressure, Hz. At most [`PRESSURE_BANDWIDTH_MAX_HZ`].
    pub pressure_bandwidth_hz: f64,
    /// How fast the integrator of a pressure learns, Hz; 0 = no integrator.
    pub pressure_integral_hz: f64,
    /// A pressure this close is reached, bar. Keeps the sensors' noise from the pump.
    pub pressure_deadband_bar: f64,
    /// The pump rests where its gears would have to deliver less than this, ml/s: around rest it would otherwise jump from one
    /// end of its dead zone to the other with every bit of noise.
    pub rest_flow_ml_s: f64,
    /// Flow for the reference's own motion, from the model.
    pub feed_forward: bool,
    /// The integrator looks at the flow that the clamped voltage gives. Without, it takes the flow that it asked for as
    /// given, and winds up: for comparison.
    pub anti_windup: bool,
    /// Gravity acts on the lever.
    pub vertical: bool,
}

/// The pump lags by up to 10 ms (section 4.1 of the paper); a loop through it keeps its damping up to 1/(4 * 10 ms) =
/// 25 rad/s.
pub const PRESSURE_BANDWIDTH_MAX_HZ: f64 = 4.0;

/// Largest bandwidth of the angle, as a share of the lever's own frequency.
pub const ANGLE_BANDWIDTH_MAX_SHARE: f64 = 0.25;

/// An integrator learns at most this much faster than its loop corrects.
const INTEGRAL_MAX_SHARE: f64 = 0.5;

impl Default for Settings {
    fn default() -> Self {
        Settings {
            angle_bandwidth_hz: 1.0,
            angle_integral_hz: 0.25,
            angle_deadband_deg: 0.05,
            pressure_bandwidth_hz: 3.0,
            pressure_integral_hz: 1.0,
            pressure_deadband_bar: 0.01,
            rest_flow_ml_s: 0.1,
            feed_forward: true,
            anti_windup: true,
            vertical: false,
        }
    }
}

/// Why there is no controller for a model and settings.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ControllerError {
    /// A setting is out of range.
    #[error("controller: `{setting}` must be {expected}, got {got}")]
    Setting {
        /// Field of [`Settings`].
        setting: &'static str,
        /// What it must be.
        expected: String,
        /// What it is.
        got: f64,
    },
    /// The model can't be inverted.
    #[error(
        "controller: the model's {what} must be above 0 {at}, got {got}; identify the rig again or correct the file"
    )]
    Model {
        /// The quantity with its unit.
        what: &'static str,
        /// Where in the range of the rig.
        at: String,
        /// What the model says.
        got: f64,
    },
}

impl Settings {
    /// Whether loops with these settings work on this plant.
    pub(super) fn validate(&self, plant: &Plant) -> Result<(), ControllerError> {
        let check = |setting, got: f64, valid: bool, expected: String| {
            if valid { Ok(()) } else { Err(ControllerError::Setting { setting, expected, got }) }
        };
        let within = |setting, got: f64, low: f64, high: f64, why: &str| {
            let valid = got.is_finite() && got >= low && got <= high;
            check(setting, got, valid, format!("a finite number within {low} .. {high:.3}{why}"))
        };
        let own_hz = plant.lever_frequency_hz();
        let angle_max_hz = ANGLE_BANDWIDTH_MAX_SHARE * own_hz;
        let why = format!(" (a quarter of the lever's {own_hz:.1} Hz on the oil)");
        within("angle_bandwidth_hz", self.angle_bandwidth_hz, 0.01, angle_max_hz, &why)?;
        let why = " (the pump's lag)";
        within("pressure_bandwidth_hz", self.pressure_bandwidth_hz, 0.01, PRESSURE_BANDWIDTH_MAX_HZ, why)?;
        let why = " (half of the bandwidth)";
        let most = |bandwidth_hz: f64| INTEGRAL_MAX_SHARE * bandwidth_hz;
        within("angle_integral_hz", self.angle_integral_hz, 0.0, most(self.angle_bandwidth_hz), why)?;
        within("pressure_integral_hz", self.pressure_integral_hz, 0.0, most(self.pressure_bandwidth_hz), why)?;
        within("angle_deadband_deg", self.angle_deadband_deg, 0.0, 5.0, "")?;
        within("pressure_deadband_bar", self.pressure_deadband_bar, 0.0, 1.0, "")?;
        within("rest_flow_ml_s", self.rest_flow_ml_s, 0.0, 1.0, "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::effects::KnownEffects;
    use model::Parameters;

    fn refusal(change: impl Fn(&mut Settings)) -> String {
        let plant = Plant::new(&Parameters::example(), KnownEffects::none(), false).expect("a sound model");
        let mut settings = Settings::default();
        settings.validate(&plant).expect("the defaults are sound");
        change(&mut settings);
        settings.validate(&plant).expect_err("out of range").to_string()
    }

    #[test]
    fn settings_out_of_range_are_named_with_what_is_expected() {
        let text = refusal(|s| s.angle_bandwidth_hz = 3.0);
        assert!(
            text.contains("`angle_bandwidth_hz`") && text.contains("a quarter") && text.contains("got 3"),
            "{text}"
        );
        for (field, text) in [
            ("pressure_bandwidth_hz", refusal(|s| s.pressure_bandwidth_hz = 5.0)),
            ("pressure_bandwidth_hz", refusal(|s| s.pressure_bandwidth_hz = 0.0)),
            ("angle_integral_hz", refusal(|s| s.angle_integral_hz = 0.6)),
            ("pressure_integral_hz", refusal(|s| s.pressure_integral_hz = -1.0)),
            ("angle_deadband_deg", refusal(|s| s.angle_deadband_deg = f64::NAN)),
            ("pressure_deadband_bar", refusal(|s| s.pressure_deadband_bar = f64::INFINITY)),
            ("rest_flow_ml_s", refusal(|s| s.rest_flow_ml_s = -0.1)),
        ] {
            assert!(text.contains(&format!("`{field}`")), "{field}: {text}");
        }
    }

    #[test]
    fn a_softer_rig_allows_less() {
        let mut soft = Parameters::example();
        soft.load.J *= 16.0;
        let plant = Plant::new(&soft, KnownEffects::none(), false).expect("a sound model");
        assert!(Settings::default().validate(&plant).is_err(), "1 Hz on a lever of 2.6 Hz");
        Settings { angle_bandwidth_hz: 0.6, ..Settings::default() }
            .validate(&plant)
            .expect("0.6 Hz is a quarter of it");
    }
}
