//! What a rig file says about the wires: `[amplifier]` and `[can]`. Plain data; what it must satisfy is checked where the
//! protocol, the database and the wires' rates are known.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Both wires.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// `[amplifier]`
    pub amplifier: AmplifierSettings,
    /// `[can]`
    pub can: CanSettings,
}

/// `[amplifier]`: the pump amplifier on its serial port.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AmplifierSettings {
    /// What it speaks: a name out of [`crate::amplifier`]'s list.
    pub protocol: String,
    /// Its port, `/dev/serial/by-id/...` where there is one: the name stays when the adapter is plugged in elsewhere.
    pub port: PathBuf,
    /// Bits a second, 8N1.
    #[serde(default = "default::baud")]
    pub baud: u32,
    /// Voltage (V, > 0) at the drive's full scale: the supply at duty 1.
    pub full_scale_v: f64,
    /// The motor is wired the other way round: u > 0 is a negative duty.
    #[serde(default)]
    pub reversed: bool,
    /// Ticks between two requests for telemetry, >= 1.
    #[serde(default = "default::telemetry_every_ticks")]
    pub telemetry_every_ticks: u32,
    /// Telemetry may be silent for so long (ms); then the amplifier counts as gone, gets 0 V and is disarmed.
    #[serde(default = "default::timeout_ms")]
    pub timeout_ms: f64,
    /// For the protocol `vesc`.
    #[serde(default)]
    pub vesc: VescSettings,
    /// For the protocol `tmcl`.
    #[serde(default)]
    pub tmcl: TmclSettings,
}

/// `[amplifier.vesc]`: the motor at a VESC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VescSettings {
    /// Pole pairs of the motor, >= 1: a VESC tells electrical revolutions. 1 for a brushed motor.
    pub pole_pairs: u8,
}

impl Default for VescSettings {
    fn default() -> Self {
        VescSettings { pole_pairs: 1 }
    }
}

/// `[amplifier.tmcl]`: where the motor is in a Trinamic module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TmclSettings {
    /// Which module it is: a name out of [`crate::amplifier::tmcl::MODULES`], where its parameters are.
    pub module: String,
    /// Address of the module.
    pub module_address: u8,
    /// Address under which it answers: the host's.
    pub reply_address: u8,
    /// Axis (motor) of the module.
    pub axis: u8,
    /// Axis parameter that takes the command, where it is not the module's.
    pub command_parameter: Option<u8>,
    /// Its value at `full_scale_v`, > 0, where it is not the module's.
    pub full_scale_units: Option<i32>,
}

impl Default for TmclSettings {
    fn default() -> Self {
        TmclSettings {
            module: "TMC6140-EVAL".into(),
            module_address: 1,
            reply_address: 2,
            axis: 0,
            command_parameter: None,
            full_scale_units: None,
        }
    }
}

/// `[can]`: the bus with valves and sensors. Signals are named `MESSAGE.Signal`, as the database has them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CanSettings {
    /// `can0`, `vcan0`; `unix:PATH` to an emulated rig on a machine without CAN.
    pub interface: String,
    /// Bits a second of the bus, for its budget; the interface itself is set up by the system.
    #[serde(default = "default::bitrate")]
    pub bitrate: u32,
    /// The database, beside the rig file.
    pub dbc: PathBuf,
    /// Where the measured quantities are.
    pub sensors: Sensors,
    /// What is sent every tick.
    pub command: CommandSignals,
    /// An automatic fixture, where there is one; without it the operator does its work.
    pub fixture: Option<FixtureSignals>,
    /// Signs of life to wait for.
    #[serde(default)]
    pub heartbeat: Vec<Heartbeat>,
}

/// `[can.sensors]`: what is left out is not measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensors {
    /// Absolute encoder, degrees.
    pub angle_deg: Option<Sensor>,
    /// Chamber 1, bar absolute.
    pub pressure1_bar: Option<Sensor>,
    /// Chamber 2, bar absolute.
    pub pressure2_bar: Option<Sensor>,
    /// Torque on the clamp, Nm.
    pub torque_nm: Option<Sensor>,
    /// Measuring cylinder, ml.
    pub volume_ml: Option<Sensor>,
}

impl Sensors {
    /// In the order of `rt_core::Input`.
    pub fn by_input(&self) -> [Option<&Sensor>; 5] {
        let Sensors { angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml } = self;
        [angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml].map(Option::as_ref)
    }
}

/// A quantity on the bus: `gain` * physical value of the signal + `offset`, in the unit of the quantity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Where its value is.
    pub signal: String,
    /// Calibration, units of the quantity for one of the signal's; not 0.
    #[serde(default = "default::gain")]
    pub gain: f64,
    /// Calibration, in the unit of the quantity.
    #[serde(default)]
    pub offset: f64,
    /// A signal of the same message that is not 0 where the value is not to be trusted.
    pub fault: Option<String>,
    /// A signal of the same message that is 0 where there is no value (a force sensor of a lever that moves).
    pub present: Option<String>,
    /// A signal of the same message with the counter of the command on which it was measured: its age is then known exactly.
    pub counter: Option<String>,
    /// From the measurement to the frame's reception, ms; for sensors without a counter.
    #[serde(default)]
    pub latency_ms: f64,
}

/// `[can.command]`: messages with these signals are sent every tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandSignals {
    /// 1 = the valve in series with the pump is to be open.
    pub brake_open: String,
    /// 1 = the valve parallel to the pump is to be open.
    pub bypass_open: String,
    /// Counts the ticks, so that a node sees that commands are fresh.
    pub counter: Option<String>,
    /// 1 while a run goes on.
    pub running: Option<String>,
}

/// `[can.fixture]`: what an automatic fixture (or the emulated operator) is told, every tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FixtureSignals {
    /// 0 free, 1 clamped, 2 driven, 3 filled, 4 released, 5 pump bench.
    pub kind: String,
    /// Angle of the lever, degrees.
    pub angle_deg: String,
    /// Chamber 1 or port 1 of the pump, bar absolute.
    pub pressure1_bar: String,
    /// Chamber 2 or port 2 of the pump, bar absolute.
    pub pressure2_bar: String,
    /// Oil out of chamber 1, ml/s.
    pub flow_ml_s: String,
    /// Counts the set points: a measuring cylinder begins anew.
    pub segment: String,
    /// Counts the runs: a new value is a new preparation.
    pub run: String,
    /// 1 = gravity acts on the lever.
    pub vertical: String,
    /// Pressure of both chambers at the start of a run, bar absolute.
    pub fill_bar: String,
}

impl FixtureSignals {
    /// Keys with their signals.
    pub fn by_key(&self) -> [(&'static str, &str); 9] {
        [
            ("kind", &self.kind),
            ("angle_deg", &self.angle_deg),
            ("pressure1_bar", &self.pressure1_bar),
            ("pressure2_bar", &self.pressure2_bar),
            ("flow_ml_s", &self.flow_ml_s),
            ("segment", &self.segment),
            ("run", &self.run),
            ("vertical", &self.vertical),
            ("fill_bar", &self.fill_bar),
        ]
    }
}

/// `[[can.heartbeat]]`: a message whose absence means that its node is gone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heartbeat {
    /// The message.
    pub message: String,
    /// It comes at least so often, ms.
    pub period_ms: f64,
}

mod default {
    pub fn baud() -> u32 {
        460_800
    }
    pub fn bitrate() -> u32 {
        1_000_000
    }
    pub fn telemetry_every_ticks() -> u32 {
        10
    }
    pub fn timeout_ms() -> f64 {
        100.0
    }
    pub fn gain() -> f64 {
        1.0
    }
}
