//! The loop's view of the world. The consumer owns the traits: drivers, profiles and controllers implement them.

use crate::types::{Command, Measurement, Tick};

/// A rig: real hardware, the emulated rig, or a wrapper around either.
///
/// The command written at tick k acts from k to k+1; the measurement read at tick k is the state at k, before that command.
/// After the run's last tick, and at once after a failure, the loop writes [`Command::SAFE`] once more without a read before it.
pub trait Device {
    /// The sensors at this tick.
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError>;
    /// The command that acts from this tick on.
    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError>;
}

/// What a device could not do. Carries the device, what was expected and what came.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{device} at tick {tick}: {what}")]
pub struct DeviceError {
    /// Name of the device or channel.
    pub device: &'static str,
    /// The tick at which it happened.
    pub tick: u64,
    /// Expected, got, remedy.
    pub what: String,
}

/// What the profile wants at a tick: everything but the voltage, which is the controller's answer to `target`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What the controller is to reach.
    pub target: Target,
    /// Valve in series with the pump.
    pub brake_open: bool,
    /// Valve parallel to the pump.
    pub bypass_open: bool,
    /// The operator's part.
    pub fixture: crate::types::Fixture,
    /// Counts the set points of the protocol.
    pub segment: u32,
    /// This is the run's last tick.
    pub last: bool,
}

/// A quantity for the controller to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Open loop: this voltage, V.
    VoltageV(f64),
    /// Flow of the pump through the inverted characteristic, eq. (10), ml/s.
    FlowMlS(f64),
}

/// A profile: what is wanted at each tick. Deterministic; may look at the measurement ("until the angle reaches ...").
pub trait Reference {
    /// The step of this tick. Called once a tick, in order.
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step;
}

/// Turns the profile's target into a voltage.
pub trait Controller {
    /// Voltage for this tick, V.
    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64;
}
