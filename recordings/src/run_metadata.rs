//! What an MCAP recording holds besides the samples: what the run is, and what happened in it.

use std::collections::BTreeMap;

use crate::{Plane, Protocol, Role};

/// What a run is, written before its first sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunMetadata {
    /// Name of the run, for people.
    pub name: String,
    /// Which experiment it is.
    pub protocol: Protocol,
    /// What it was recorded for. In a campaign folder `campaign.toml` decides.
    pub role: Role,
    /// The plane in which the lever moves.
    pub plane: Plane,
    /// Text of the profile that was run, as it was run.
    pub profile: String,
    /// Files that the run depended on, text by name: the rig file, CAN databases, a model.
    pub files: BTreeMap<String, String>,
    /// Calibration of the sensors as the bench understood it, as TOML; empty: none is known.
    pub calibration: String,
    /// The machine that ran the loop, by name: `hostname`, `kernel`, `machine`, `cpus`.
    pub host: BTreeMap<String, String>,
    /// The program that ran the loop: version and commit; empty: not known.
    pub program: String,
    /// Anything else worth keeping, by name.
    pub notes: BTreeMap<String, String>,
}

impl RunMetadata {
    /// A run of which nothing else is known: the other fields are empty.
    pub fn new(name: impl Into<String>, protocol: Protocol, role: Role, plane: Plane) -> RunMetadata {
        RunMetadata {
            name: name.into(),
            protocol,
            role,
            plane,
            profile: String::new(),
            files: BTreeMap::new(),
            calibration: String::new(),
            host: BTreeMap::new(),
            program: String::new(),
            notes: BTreeMap::new(),
        }
    }
}

/// How bad an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Part of a normal run.
    Info,
    /// The run goes on, but a person should know.
    Warning,
    /// The run is not what it was meant to be.
    Error,
}

/// Something that happened besides the samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    /// Tick at which it happened.
    pub tick: u64,
    /// Scheduled time of that tick since the run's start, ns.
    pub scheduled_ns: u64,
    /// How bad it is.
    pub severity: Severity,
    /// Who says it.
    pub source: String,
    /// What happened.
    pub text: String,
}

/// What the motor amplifier told of itself, when it told it. A value that this amplifier does not tell is NaN (`fault`: `None`).
#[derive(Clone, Debug, PartialEq)]
pub struct AmplifierReport {
    /// Tick of the loop in which it arrived.
    pub tick: u64,
    /// Time of its arrival since the run's start, ns. In virtual time that of the tick.
    pub arrived_ns: u64,
    /// Supply voltage, V.
    pub supply_v: f64,
    /// Motor current, A; signed where the amplifier tells the direction.
    pub motor_current_a: f64,
    /// Speed of the motor's shaft, rpm; sign as of the command.
    pub speed_rpm: f64,
    /// Duty cycle, -1 to 1.
    pub duty: f64,
    /// Temperature of the power stage, degrees Celsius.
    pub temperature_c: f64,
    /// The fault that it reports; `None`: it reports none, or does not tell.
    pub fault: Option<AmplifierFault>,
}

/// A fault by the amplifier's own numbering.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AmplifierFault {
    /// Its number in the amplifier's documentation.
    pub code: u32,
    /// Its name there; empty where the number is not known.
    pub name: String,
}

impl AmplifierReport {
    /// A report that tells nothing.
    pub const BLANK: AmplifierReport = AmplifierReport {
        tick: 0,
        arrived_ns: 0,
        supply_v: f64::NAN,
        motor_current_a: f64::NAN,
        speed_rpm: f64::NAN,
        duty: f64::NAN,
        temperature_c: f64::NAN,
        fault: None,
    };
}
