//! Ports: where an effect touches a plant. A plant fills the signals of a port, lets the effects act, and goes on with
//! what they left. An effect knows the port, never the plant, so a second plant gets the whole library.
//!
//! Units: rad, rad/s, Nm, bar absolute, ml/s, ml/bar, ml/rad, V, s. A plant that moves along a line fills the mechanical port with
//! position, speed and force.

use crate::rec::STORED_FROM_BAR;
use crate::scalar::Scalar;

/// Ambient pressure, bar absolute. Gauge pressure is `p - AMBIENT_BAR`.
pub const AMBIENT_BAR: f64 = 1.0;

/// The kinds of ports; an effect names the one that it acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PortKind {
    /// Before the pump: command and valve.
    Actuator,
    /// Between pump and chambers: the flow itself.
    Line,
    /// The chambers.
    Hydraulic,
    /// The lever.
    Mechanical,
    /// What the sensors show.
    Sensor,
}

/// Signals between command and pump.
pub struct ActuatorPort<S> {
    /// Since the run's start, s.
    pub time_s: f64,
    /// Voltage that the pump follows; an effect may replace it, V.
    pub voltage_v: S,
    /// Opening of the brake valve, 0 closed to 1 open; an effect may replace it.
    pub brake_opening: S,
    /// Opening of the bypass valve, likewise.
    pub bypass_opening: S,
}

/// Signals between pump and chambers.
pub struct LinePort<S> {
    /// Since the run's start, s.
    pub time_s: f64,
    /// Voltage that drives the pump, V.
    pub voltage_v: S,
    /// Pressure at the line's ends, chambers 1 and 2, bar absolute.
    pub pressure_bar: [S; 2],
    /// Flow from chamber 2 to chamber 1; an effect may replace it, ml/s.
    pub flow_ml_s: S,
    /// Size of the slope of the pump's flow over the pressure difference, ml/(s bar), positive.
    pub slip_ml_s_bar: S,
    /// Conductance of the bypass, ml/(s bar); 0 where it is closed. Its flow, this times -dp, is part of the flow.
    pub bypass_ml_s_bar: S,
    /// Opening of the bypass valve, 0 closed to 1 open.
    pub bypass_opening: S,
    /// Part of the flow that the voltage drives, ml/s: what eq. (10) has beyond f3*dp, 0 in the dead zone.
    pub drive_ml_s: S,
    /// Opening of the brake valve, 0 closed to 1 open.
    pub opening: S,
    /// Oil can pass.
    pub open: bool,
}

/// Signals of the two chambers, `[chamber 1, chamber 2]`.
pub struct HydraulicPort<S> {
    /// Since the run's start, s.
    pub time_s: f64,
    /// Pressure, bar absolute.
    pub pressure_bar: [S; 2],
    /// Lever angle, rad.
    pub angle_rad: S,
    /// Lever velocity, rad/s.
    pub velocity_rad_s: S,
    /// Flow into each chamber; effects add, ml/s.
    pub flow_ml_s: [S; 2],
    /// Capacity dV/dp; effects add, ml/bar.
    pub capacity_ml_bar: [S; 2],
    /// Displacement dV/dphi; effects add, ml/rad.
    pub displacement_ml_rad: [S; 2],
    /// Slope over the angle of the oil stored by pressure, taken from 2.5 bar: d/dphi of the integral of the capacity over
    /// pressure, ml/rad. 0 where no effect asks for it ([`crate::effects::Law::CLOSES_VOLUME`]).
    pub stored_slope_ml_rad: [S; 2],
    /// Torque of the chambers on the lever by the base model, Nm.
    pub actuator_torque_nm: S,
    /// The chambers are shut off one by one at their ports (bench experiments), not by the brake valve.
    pub shut_off: bool,
}

/// Signals of a body that moves.
///
/// On a plant that moves along a line, angle, velocity and torque stand for position (m), speed (m/s) and force (N), or for what the
/// plant's header gives as their units; effects read rad as that unit. Signals that the plant lacks (`dp_bar`, `load_bar`) are 0.
pub struct MechanicalPort<S> {
    /// Since the run's start, s.
    pub time_s: f64,
    /// Angle, rad.
    pub angle_rad: S,
    /// Velocity, rad/s.
    pub velocity_rad_s: S,
    /// Pressure difference that drives, bar.
    pub dp_bar: S,
    /// Load on the bearing: sum of the chambers' gauge pressures, bar.
    pub load_bar: S,
    /// The plane of motion is vertical; then gravity is part of the base model.
    pub vertical: bool,
    /// Torque on the lever; effects add, Nm.
    pub torque_nm: S,
}

impl<S: Scalar> LinePort<S> {
    /// An open line through which nothing flows yet, with the voltage (V) and the pressure difference (bar) across the pump, about [`STORED_FROM_BAR`].
    pub fn open(time_s: f64, voltage_v: S, dp_bar: S) -> Self {
        let half_bar = dp_bar * 0.5;
        let pressure_bar = [half_bar + STORED_FROM_BAR, -half_bar + STORED_FROM_BAR];
        let zero = S::zero();
        let (flow_ml_s, slip_ml_s_bar, drive_ml_s) = (zero, zero, zero);
        let (bypass_ml_s_bar, bypass_opening) = (zero, zero);
        LinePort {
            time_s,
            voltage_v,
            pressure_bar,
            flow_ml_s,
            slip_ml_s_bar,
            bypass_ml_s_bar,
            bypass_opening,
            drive_ml_s,
            opening: S::constant(1.0),
            open: true,
        }
    }

    /// Pressure difference across the pump, p1 - p2, bar.
    pub fn dp_bar(&self) -> S {
        self.pressure_bar[0] - self.pressure_bar[1]
    }
}

impl<S: Scalar> HydraulicPort<S> {
    /// Two vessels at these pressures, bar absolute, into which nothing flows yet; the lever rests in the middle, or there is none.
    pub fn at(time_s: f64, pressure_bar: [S; 2]) -> Self {
        HydraulicPort {
            time_s,
            pressure_bar,
            angle_rad: S::zero(),
            velocity_rad_s: S::zero(),
            flow_ml_s: [S::zero(); 2],
            capacity_ml_bar: [S::zero(); 2],
            displacement_ml_rad: [S::zero(); 2],
            stored_slope_ml_rad: [S::zero(); 2],
            actuator_torque_nm: S::zero(),
            shut_off: false,
        }
    }
}

impl<S: Scalar> MechanicalPort<S> {
    /// A body on which nothing acts yet, without chambers, at this angle (rad) and velocity (rad/s).
    pub fn at(time_s: f64, angle_rad: S, velocity_rad_s: S) -> Self {
        let (dp_bar, load_bar, torque_nm) = (S::zero(), S::zero(), S::zero());
        MechanicalPort { time_s, angle_rad, velocity_rad_s, dp_bar, load_bar, vertical: false, torque_nm }
    }
}

/// What the sensors show; effects alter it.
pub struct SensorPort<S> {
    /// Since the run's start, s.
    pub time_s: f64,
    /// Shown angle, degrees.
    pub angle_deg: S,
    /// Shown pressures, bar absolute.
    pub pressure_bar: [S; 2],
}

/// A port with its signals.
pub enum Port<'a, S> {
    /// See [`ActuatorPort`].
    Actuator(&'a mut ActuatorPort<S>),
    /// See [`LinePort`].
    Line(&'a mut LinePort<S>),
    /// See [`HydraulicPort`].
    Hydraulic(&'a mut HydraulicPort<S>),
    /// See [`MechanicalPort`].
    Mechanical(&'a mut MechanicalPort<S>),
    /// See [`SensorPort`].
    Sensor(&'a mut SensorPort<S>),
}

impl<S> Port<'_, S> {
    /// Which kind it is.
    #[inline(always)]
    pub fn kind(&self) -> PortKind {
        match self {
            Port::Actuator(_) => PortKind::Actuator,
            Port::Line(_) => PortKind::Line,
            Port::Hydraulic(_) => PortKind::Hydraulic,
            Port::Mechanical(_) => PortKind::Mechanical,
            Port::Sensor(_) => PortKind::Sensor,
        }
    }
}

/// How the lever came to stand where it does: what a wall that remembers its way starts from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Arrival<'a> {
    /// It is free and stands still: friction holds the torque that is left.
    Free,
    /// It was led there and is held. Turning points of the way, rad, in their order, the last one where it stands; fewer than two: no way is
    /// known.
    Led(&'a [f64]),
    /// It was led there on a way that is not known, and what the clamp holds was measured: the walls hold the rest of the torque that is left.
    Held,
}

/// For how long the pump has run at which voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ran {
    /// s
    pub for_s: f64,
    /// Root mean square, V.
    pub voltage_v: f64,
}

/// What a clamped lever was seen to be held with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    /// Torque of the clamp, Nm.
    pub torque_nm: f64,
    /// Chamber pressures meanwhile, bar absolute.
    pub pressure_bar: [f64; 2],
}

/// What was before the plant stood as it does, for the effects that remember it; the default is that nothing is known, as at a run's start.
#[derive(Clone, Copy, Debug, Default)]
pub struct Before<'a> {
    /// Turning points of the way on which a led lever came to its angle ([`Arrival::Led`]), rad.
    pub way_rad: &'a [f64],
    /// What a led lever is held with, where its way is not known ([`Arrival::Held`]).
    pub held: Option<Held>,
    /// What the pump has done since the run's start, in order.
    pub ran: &'a [Ran],
}

/// The plant at rest, from which effects set their own states.
pub struct Rest<'a, S> {
    /// How the lever came to its angle.
    pub arrival: Arrival<'a>,
    /// What the pump has done since the run's start, in order; empty at that start.
    pub ran: &'a [Ran],
    /// Angle, rad.
    pub angle_rad: S,
    /// Chamber pressures, bar absolute.
    pub pressure_bar: [S; 2],
    /// Torque of the chambers on the lever by the base model, Nm.
    pub actuator_torque_nm: S,
    /// Torque that is balanced neither by the base model at rest nor by a clamp ([`Arrival::Held`]): friction or walls must hold it, Nm.
    pub torque_nm: S,
    /// Voltage, V.
    pub voltage_v: f64,
    /// Brake valve open.
    pub brake_open: bool,
    /// Bypass valve open.
    pub bypass_open: bool,
}

impl<S: Scalar> Rest<'_, S> {
    /// Gauge pressure of a chamber, bar.
    pub fn gauge_bar(&self, chamber: usize) -> S {
        self.pressure_bar[chamber] - AMBIENT_BAR
    }
}
