//! What pump amplifiers speak: one protocol a file, no I/O. Bytes come in, bytes go out; who owns the port and the clock calls.
//!
//! Each protocol has two sides: [`Protocol`] is the bench's, [`Drive`] is an emulated amplifier's. A protocol is known to the
//! bench when it is in [`PROTOCOLS`]. Neither side allocates after it was made.
//!
//! Voltages, currents and speeds have the rig's sign on both sides: where the motor is wired the other way round
//! (`reversed`), both turn the sign between here and the wire.

mod outbox;
pub mod tmcl;
pub mod vesc;

pub use crate::wired::settings::{AmplifierSettings, TmclSettings, VescSettings};
pub use outbox::Outbox;

use arrayvec::ArrayString;
use std::fmt;

/// Every protocol that the bench speaks, by the name in the rig file.
pub const PROTOCOLS: &[ProtocolKind] = &[vesc::KIND, tmcl::KIND];

/// The protocol of that name.
///
/// # Errors
/// [`AmplifierError::UnknownProtocol`], with the names that there are.
pub fn protocol(name: &str) -> Result<&'static ProtocolKind, AmplifierError> {
    PROTOCOLS.iter().find(|kind| kind.name == name).ok_or_else(|| AmplifierError::UnknownProtocol { name: name.into() })
}

/// A protocol, and how its two sides are made.
pub struct ProtocolKind {
    /// As the rig file has it.
    pub name: &'static str,
    /// What it is, for messages.
    pub title: &'static str,
    /// A fault that an amplifier with this protocol can report: for tests and fault injection.
    pub example_fault: Fault,
    /// Share of full scale at which it clips as it is delivered, without a word on the wire. The emulated one does not.
    pub delivered_share: f64,
    /// The bench's side.
    ///
    /// # Errors
    /// What in the settings does not make sense.
    pub client: fn(&AmplifierSettings) -> Result<Box<dyn Protocol>, AmplifierError>,
    /// An emulated amplifier's side.
    ///
    /// # Errors
    /// What in the settings does not make sense.
    pub drive: fn(&AmplifierSettings) -> Result<Box<dyn Drive>, AmplifierError>,
}

/// The bench's side of a protocol. What it asks or commands is appended to an [`Outbox`] as whole frames.
pub trait Protocol: Send {
    /// Asks who is there: answered by [`Told::Hello`].
    fn hello(&mut self, out: &mut Outbox);

    /// Commands a voltage (V), clamped at full scale; what is not a number is 0 V.
    fn command(&mut self, voltage_v: f64, out: &mut Outbox);

    /// Asks for telemetry: answered by [`Told::Telemetry`].
    fn request(&mut self, out: &mut Outbox);

    /// Says that the bench is alive; the command stays.
    fn keep_alive(&mut self, out: &mut Outbox);

    /// Takes bytes as they came, in any pieces, and tells what they say.
    fn hear(&mut self, bytes: &[u8], told: &mut dyn FnMut(Told));

    /// How sound was what came so far.
    fn garbled(&self) -> Garbled;

    /// Begins anew: half a frame and what is expected are forgotten, the counts of [`Protocol::garbled`] are 0. For a port that was
    /// opened again.
    fn reset(&mut self);

    /// What goes over the wire, for its budget.
    fn traffic(&self) -> Traffic;

    /// Smallest step of the commanded voltage (V).
    fn resolution_v(&self) -> f64;
}

/// An emulated amplifier's side of a protocol.
///
/// Times are nanoseconds of one clock that never goes back, whichever.
pub trait Drive: Send {
    /// Takes bytes as they came, in any pieces, and answers requests out of `state`. The newest voltage (V) that they command, if any.
    fn hear(&mut self, bytes: &[u8], now_ns: u64, state: &DriveState, out: &mut Outbox) -> Option<f64>;

    /// Voltage in force: the newest that was commanded; 0 V before the first, and when neither command nor keep-alive came for longer
    /// than the timeout.
    fn voltage_v(&self, now_ns: u64) -> f64;

    /// Whether a command is in force no more because nothing came for longer than the timeout.
    fn timed_out(&self, now_ns: u64) -> bool;

    /// Sets the timeout; `None` = it never gives up. Unset it is the firmware's default.
    fn set_timeout(&mut self, timeout_ns: Option<u64>);

    /// How sound was what came so far.
    fn garbled(&self) -> Garbled;
}

/// What an amplifier measures. NaN = not told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Telemetry {
    /// Supply (V).
    pub supply_v: f32,
    /// Motor (A).
    pub motor_current_a: f32,
    /// Motor's shaft, 1/min.
    pub speed_rpm: f32,
    /// Voltage at the motor as a share of the supply, -1 to 1.
    pub duty: f32,
    /// Output stage, °C.
    pub temperature_c: f32,
    /// What is wrong, if anything.
    pub fault: Option<Fault>,
}

impl Telemetry {
    /// Nothing told yet.
    pub const UNTOLD: Telemetry = Telemetry {
        supply_v: f32::NAN,
        motor_current_a: f32::NAN,
        speed_rpm: f32::NAN,
        duty: f32::NAN,
        temperature_c: f32::NAN,
        fault: None,
    };
}

impl Default for Telemetry {
    fn default() -> Self {
        Telemetry::UNTOLD
    }
}

/// A fault that an amplifier reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The protocol's code; for `tmcl` the status flags that mean a fault.
    pub code: u32,
    /// Its name in the amplifier's documentation.
    pub name: &'static str,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:#x})", self.name, self.code)
    }
}

/// Who answered a hello.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Firmware {
    /// What it calls its hardware; empty where it has no name.
    pub hardware: ArrayString<LONGEST_NAME>,
    /// Version, before the point.
    pub major: u16,
    /// Version, after the point.
    pub minor: u16,
}

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} firmware {}.{:02}", self.hardware, self.major, self.minor)
    }
}

/// Longest name of a hardware, bytes; more is cut off.
pub const LONGEST_NAME: usize = 40;

/// What a sound frame said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Told {
    /// Answer to [`Protocol::hello`].
    Hello(Firmware),
    /// Answer to [`Protocol::request`].
    Telemetry(Telemetry),
    /// A command was taken; only protocols that acknowledge say so.
    Acknowledged,
    /// Something was not taken.
    Refused(Refusal),
}

/// What an amplifier did not take, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The protocol's status.
    pub status: u8,
    /// What that means.
    pub meaning: &'static str,
    /// The command's number in the protocol.
    pub command: u8,
    /// It was to set the voltage; otherwise something was asked.
    pub of_voltage: bool,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (status {} to command {})", self.meaning, self.status, self.command)
    }
}

/// How sound is what comes from the other side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Garbled {
    /// Frames whose form, checksum and sender were right.
    pub sound: u64,
    /// Candidates of full length that the checksum or the end mark refused.
    pub refused: u64,
    /// Bytes that belonged to no sound frame.
    pub skipped_bytes: u64,
}

/// Bytes there and back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes {
    /// From the bench.
    pub out: usize,
    /// To the bench.
    pub back: usize,
}

/// What goes over the wire for one call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// [`Protocol::command`].
    pub command: Bytes,
    /// [`Protocol::request`].
    pub request: Bytes,
    /// [`Protocol::keep_alive`].
    pub keep_alive: Bytes,
}

/// What an emulated amplifier reports when it is asked. A fault is told, not acted on: that the motor then stands is the plant's part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveState {
    /// As the amplifier measures; NaN is told as 0.
    pub telemetry: Telemetry,
}

/// Settings of an amplifier that do not make sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AmplifierError {
    /// The bench does not speak it.
    #[error("[amplifier] protocol = {name:?}: there is {}", known())]
    UnknownProtocol {
        /// As the rig file has it.
        name: String,
    },
    /// The bench does not know where this module's values are.
    #[error("[amplifier.tmcl] module = {name:?}: there is {known}")]
    UnknownModule {
        /// As the rig file has it.
        name: String,
        /// All names.
        known: String,
    },
    /// A setting is out of its range.
    #[error("[amplifier] {key} = {value}: expected {expected}")]
    OutOfRange {
        /// Which.
        key: &'static str,
        /// As the rig file has it.
        value: f64,
        /// Its range.
        expected: &'static str,
    },
}

/// Names of all protocols.
fn known() -> String {
    PROTOCOLS.iter().map(|kind| format!("{:?} ({})", kind.name, kind.title)).collect::<Vec<_>>().join(", ")
}

/// Voltage to the share of full scale that goes over the wire, in [-1, 1], and back.
#[derive(Clone, Copy, Debug)]
struct Scale {
    full_scale_v: f64,
    /// -1 where the motor is wired the other way round.
    sign: f64,
}

impl Scale {
    fn of(settings: &AmplifierSettings) -> Result<Scale, AmplifierError> {
        let full_scale_v = settings.full_scale_v;
        if !(full_scale_v.is_finite() && full_scale_v > 0.0) {
            let expected = "a finite voltage > 0 V";
            return Err(AmplifierError::OutOfRange { key: "full_scale_v", value: full_scale_v, expected });
        }
        Ok(Scale { full_scale_v, sign: if settings.reversed { -1.0 } else { 1.0 } })
    }

    /// Clamped; NaN is 0.
    fn share(&self, voltage_v: f64) -> f64 {
        let share = voltage_v / self.full_scale_v;
        if share.is_nan() { 0.0 } else { self.sign * share.clamp(-1.0, 1.0) }
    }

    fn voltage_v(&self, share: f64) -> f64 {
        self.sign * share.clamp(-1.0, 1.0) * self.full_scale_v
    }

    /// A measured quantity between the rig's sign and the drive's.
    fn turned(&self, value: f32) -> f32 {
        self.sign as f32 * value
    }
}

/// What an emulated amplifier was commanded, and for how long that holds.
#[derive(Clone, Copy, Debug)]
struct InForce {
    voltage_v: f64,
    /// Last command or sign of life.
    heard_ns: Option<u64>,
    timeout_ns: Option<u64>,
}

impl InForce {
    fn new(timeout_ns: Option<u64>) -> InForce {
        InForce { voltage_v: 0.0, heard_ns: None, timeout_ns }
    }

    fn command(&mut self, voltage_v: f64, now_ns: u64) {
        // After a timeout a new command is obeyed; the one before it is not.
        self.voltage_v = voltage_v;
        self.heard_ns = Some(now_ns);
    }

    /// A sign of life prolongs a command; one that timed out stays without force.
    fn alive(&mut self, now_ns: u64) {
        if self.timed_out(now_ns) {
            self.voltage_v = 0.0;
        }
        self.heard_ns = Some(now_ns);
    }

    fn voltage_v(&self, now_ns: u64) -> f64 {
        if self.timed_out(now_ns) { 0.0 } else { self.voltage_v }
    }

    fn timed_out(&self, now_ns: u64) -> bool {
        match (self.heard_ns, self.timeout_ns) {
            (Some(heard_ns), Some(timeout_ns)) => now_ns.saturating_sub(heard_ns) > timeout_ns,
            _ => false,
        }
    }

    fn set_timeout(&mut self, timeout_ns: Option<u64>) {
        self.timeout_ns = timeout_ns;
    }
}
