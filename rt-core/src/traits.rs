//! The loop's view of the world. The consumer owns the traits: drivers, profiles and controllers implement them.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::confirmation::{Confirmation, ConfirmationSlot, Waiting};
use crate::types::{Command, Fixture, Measurement, TargetKind, Tick};

/// What somebody outside the loop asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Demand {
    /// Go on.
    #[default]
    None,
    /// End the run: the safe state is written, nothing latches.
    Stop,
    /// Emergency stop: the supervisor trips.
    EmergencyStop,
}

/// The people at the rig, as the loop hears them. Asked once a tick; must not wait.
pub trait Operator {
    /// What is asked for at this tick.
    fn demand(&mut self, now: Tick) -> Demand;
    /// What they confirm at this tick, where it is what the run waits for. Called once a tick, also where nothing is waited for, so that a
    /// word that comes too late is refused and not kept.
    fn confirmation(&mut self, _now: Tick, _waiting: Option<Waiting>, _measured: &Measurement) -> Option<Confirmation> {
        None
    }
}

/// Nobody asks for anything.
impl Operator for () {
    fn demand(&mut self, _now: Tick) -> Demand {
        Demand::None
    }
}

/// Switches that any thread or signal handler may throw. They stay thrown: who throws them decides when to go on.
#[derive(Debug, Default)]
pub struct Switches {
    /// Ask for the end of the run.
    pub stop: AtomicBool,
    /// Ask for the emergency stop.
    pub emergency_stop: AtomicBool,
    /// Where confirmations come in.
    pub confirmations: ConfirmationSlot,
}

impl Switches {
    /// Nothing is asked for. (For a static.)
    pub const fn new() -> Self {
        Switches {
            stop: AtomicBool::new(false),
            emergency_stop: AtomicBool::new(false),
            confirmations: ConfirmationSlot::new(),
        }
    }
}

impl Operator for &Switches {
    fn demand(&mut self, _now: Tick) -> Demand {
        if self.emergency_stop.load(Ordering::Relaxed) {
            Demand::EmergencyStop
        } else if self.stop.load(Ordering::Relaxed) {
            Demand::Stop
        } else {
            Demand::None
        }
    }

    fn confirmation(&mut self, now: Tick, waiting: Option<Waiting>, measured: &Measurement) -> Option<Confirmation> {
        self.confirmations.take(now, waiting, measured)
    }
}

/// A rig: real hardware, the emulated rig, or a wrapper around either.
///
/// The command written at tick k acts from k to k+1; the measurement read at tick k is the state at k, before that command.
/// After the run's last tick, and at once after a failure, the loop writes the safe state once more without a read before it.
/// Ticks may be passed over; time never goes back. Neither call may wait, allocate or take a lock.
pub trait Device {
    /// A run begins. `origin_ns` is its tick 0 on `CLOCK_MONOTONIC`, 0 in virtual time: what a device with times of its own needs
    /// to say how old a value is at a tick.
    fn begin_run(&mut self, _origin_ns: u64) {}
    /// The sensors at this tick. The loop takes an infinite value for a missing one that the device calls wrong.
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError>;
    /// The command that acts from this tick on.
    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError>;
    /// The run is over; the safe state was written.
    fn end_run(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

impl<D: Device + ?Sized> Device for &mut D {
    fn begin_run(&mut self, origin_ns: u64) {
        (**self).begin_run(origin_ns);
    }

    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        (**self).read(now)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        (**self).write(now, command)
    }

    fn end_run(&mut self) -> Result<(), DeviceError> {
        (**self).end_run()
    }
}

impl<D: Device + ?Sized> Device for Box<D> {
    fn begin_run(&mut self, origin_ns: u64) {
        (**self).begin_run(origin_ns);
    }

    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        (**self).read(now)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        (**self).write(now, command)
    }

    fn end_run(&mut self) -> Result<(), DeviceError> {
        (**self).end_run()
    }
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
    pub fixture: Fixture,
    /// Counts the set points of the protocol.
    pub segment: u32,
    /// Active step of the profile, counted through its unrolled loops from 0.
    pub index: u32,
    /// This is the run's last tick.
    pub last: bool,
    /// What the run waits for at this tick.
    pub waiting: Option<Waiting>,
    /// It waits for people and wants 0 V for as long as that lasts: they may have their hands on the rig. A step that drives the pump while it
    /// waits is no such.
    pub hands_on: bool,
}

/// A quantity for the controller to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Open loop: this voltage, V.
    VoltageV(f64),
    /// Flow of the pump through the inverted characteristic, eq. (10), ml/s.
    FlowMlS(f64),
    /// A pressure, bar (absolute for a chamber).
    PressureBar {
        /// Which one.
        of: ControlledPressure,
        /// Its value, bar.
        bar: f64,
    },
    /// Angle of the lever.
    AngleDeg {
        /// The angle, degrees.
        angle_deg: f64,
        /// How fast the reference moves there, degrees per second; for the feed-forward.
        velocity_deg_s: f64,
    },
}

impl Target {
    /// What it is of, and its value in that kind's unit.
    pub fn told(&self) -> (TargetKind, f64) {
        match *self {
            Target::VoltageV(voltage_v) => (TargetKind::Voltage, voltage_v),
            Target::FlowMlS(flow_ml_s) => (TargetKind::Flow, flow_ml_s),
            Target::PressureBar { of: ControlledPressure::Chamber1, bar } => (TargetKind::Pressure1, bar),
            Target::PressureBar { of: ControlledPressure::Chamber2, bar } => (TargetKind::Pressure2, bar),
            Target::PressureBar { of: ControlledPressure::Difference, bar } => (TargetKind::PressureDifference, bar),
            Target::AngleDeg { angle_deg, .. } => (TargetKind::Angle, angle_deg),
        }
    }
}

/// A pressure that the pump can drive somewhere: it moves oil from one chamber to the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlledPressure {
    /// Chamber 1; rises with the pump's flow.
    Chamber1,
    /// Chamber 2; falls with the pump's flow.
    Chamber2,
    /// p1 - p2.
    Difference,
}

/// A profile: what is wanted at each tick. Deterministic; may look at the measurement ("until the angle reaches ...").
pub trait Reference {
    /// What holds the lever before the first tick: kept where the device fails before any command was written.
    fn fixture_at_start(&self) -> Fixture {
        Fixture::Free
    }
    /// What the last step waited for is confirmed at this tick. Called before this tick's [`Reference::step`], which still belongs to the
    /// step that waited, and waits no more.
    fn confirmed(&mut self, _now: Tick) {}
    /// The step of this tick. Called once a tick, in order.
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step;
}

/// Turns the profile's target into a voltage.
pub trait Controller {
    /// A run begins: what was integrated before has no bearing.
    fn begin_run(&mut self) {}
    /// Voltage for this tick, V. NaN where there is no answer; the supervisor then trips.
    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64;
}
