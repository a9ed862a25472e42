//! `[envelope]`: limits of one script, narrower than those of the rig that it runs on.

use crate::error::ScriptError;
use crate::raw::{Quantity, RawEnvelope};
use crate::values::Reader;
use rt_core::Limits;
use toml::Spanned;

/// Largest angle that an envelope may name, degrees: the lever can't turn further.
const ANGLE_MOST_DEG: f64 = 90.0;
/// Fastest velocity that an envelope may name, degrees a second.
const VELOCITY_MOST_DEG_S: f64 = 10_000.0;
/// Largest torque that an envelope may name, Nm.
const TORQUE_MOST_NM: f64 = 1_000.0;
/// Largest voltage that an envelope may name, V.
const VOLTAGE_MOST_V: f64 = 1_000.0;

/// What the supervisor enforces in the runs of one script beside the rig's own limits. `None` = the rig's limit alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Envelope {
    /// Lowest pressure of either chamber, bar absolute.
    pub pressure_min_bar: Option<f64>,
    /// Highest pressure of either chamber, bar absolute.
    pub pressure_max_bar: Option<f64>,
    /// Largest angle to either side, degrees.
    pub angle_max_deg: Option<f64>,
    /// Largest velocity of the free lever in either direction, degrees a second.
    pub velocity_max_deg_s: Option<f64>,
    /// Largest torque on the clamp to either side, Nm.
    pub torque_max_nm: Option<f64>,
    /// Largest command to either side, V.
    pub voltage_max_v: Option<f64>,
}

/// An envelope that reaches beyond the rig's limits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "[envelope] {key} = {script} is wider than the rig's own limit of {rig}: an envelope can only narrow, set it to {rig} or remove it"
)]
pub struct EnvelopeError {
    /// The key that both have.
    pub key: &'static str,
    /// What the script says, in the key's unit.
    pub script: f64,
    /// What the rig's limits say.
    pub rig: f64,
}

impl Envelope {
    /// Whether the script narrows nothing.
    pub fn is_empty(&self) -> bool {
        *self == Envelope::default()
    }

    /// The rig's limits with those of the script in their place, for the runs of that script.
    ///
    /// # Errors
    /// The first limit of the script that is wider than the rig's.
    pub fn narrow(&self, rig: &Limits) -> Result<Limits, EnvelopeError> {
        let lower = |key, script: Option<f64>, rig: f64| match script {
            Some(script) if script > rig => Err(EnvelopeError { key, script, rig }),
            script => Ok(script.unwrap_or(rig)),
        };
        let pressure_min_bar = match self.pressure_min_bar {
            Some(script) if script < rig.pressure_min_bar => {
                return Err(EnvelopeError { key: "pressure_min_bar", script, rig: rig.pressure_min_bar });
            }
            script => script.unwrap_or(rig.pressure_min_bar),
        };
        Ok(Limits {
            pressure_min_bar,
            pressure_max_bar: lower("pressure_max_bar", self.pressure_max_bar, rig.pressure_max_bar)?,
            angle_max_deg: lower("angle_max_deg", self.angle_max_deg, rig.angle_max_deg)?,
            velocity_max_deg_s: lower("velocity_max_deg_s", self.velocity_max_deg_s, rig.velocity_max_deg_s)?,
            torque_max_nm: lower("torque_max_nm", self.torque_max_nm, rig.torque_max_nm)?,
            voltage_max_v: lower("voltage_max_v", self.voltage_max_v, rig.voltage_max_v)?,
            ..*rig
        })
    }
}

/// Checks what is written. `reader` has no variables, as no loop encloses the table.
pub(crate) fn envelope(raw: Option<&Spanned<RawEnvelope>>, reader: &Reader) -> Result<Envelope, ScriptError> {
    let Some(table) = raw else { return Ok(Envelope::default()) };
    let raw = table.get_ref();
    let within = |key: &str, value: &Option<Spanned<Quantity>>, low: f64, high: f64| {
        value.as_ref().map(|value| reader.within(key, value, low, high)).transpose()
    };
    let pressure = |key: &str, value: &Option<Spanned<Quantity>>| {
        value.as_ref().map(|value| reader.pressure(key, value)).transpose()
    };
    let envelope = Envelope {
        pressure_min_bar: pressure("pressure_min_bar", &raw.pressure_min_bar)?,
        pressure_max_bar: pressure("pressure_max_bar", &raw.pressure_max_bar)?,
        angle_max_deg: within("angle_max_deg", &raw.angle_max_deg, 0.1, ANGLE_MOST_DEG)?,
        velocity_max_deg_s: within("velocity_max_deg_s", &raw.velocity_max_deg_s, 0.1, VELOCITY_MOST_DEG_S)?,
        torque_max_nm: within("torque_max_nm", &raw.torque_max_nm, 0.1, TORQUE_MOST_NM)?,
        voltage_max_v: within("voltage_max_v", &raw.voltage_max_v, 0.1, VOLTAGE_MOST_V)?,
    };
    if let (Some(min), Some(max)) = (envelope.pressure_min_bar, envelope.pressure_max_bar)
        && min >= max
    {
        let what = format!("[envelope] `pressure_min_bar` must lie below `pressure_max_bar` = {max}, got {min}");
        return Err(reader.source.error(table.span().start, what));
    }
    Ok(envelope)
}
