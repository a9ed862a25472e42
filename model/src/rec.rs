//! The REC actuator: the reference model, composed from the paper's component equations, with ports for effects.
//!
//! States: angle (rad), velocity (rad/s), pressure 1, pressure 2 (bar absolute), volume (ml, see [`Circuit`]); the states
//! of the effects follow. Sign convention: angle > 0 expands chamber 1, flow > 0 goes from chamber 2 through the pump
//! into chamber 1.

use crate::effects::EffectSet;
use crate::near::{Curves, Exact};
use crate::parameters::COUNT;
use crate::parameters::index::*;
use crate::port::{
    AMBIENT_BAR, ActuatorPort, Arrival, Before, HydraulicPort, LinePort, MechanicalPort, Port, PortKind, Rest,
    SensorPort,
};
use crate::scalar::Scalar;

pub(crate) use crate::characteristics::DEGREES;
pub use crate::characteristics::{STORED_FROM_BAR, capacity, displacement, losses, pump_flow, stored_slope, torque};

/// States of the plant itself.
pub const STATES: usize = 5;
/// Positions of the states.
#[allow(missing_docs)]
pub mod state {
    pub const ANGLE: usize = 0;
    pub const VELOCITY: usize = 1;
    pub const PRESSURE1: usize = 2;
    pub const PRESSURE2: usize = 3;
    pub const VOLUME: usize = 4;
}

/// What moves the lever.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lever {
    /// The torques do.
    Free,
    /// It is clamped (velocity 0) or led; the angle follows from the state by this velocity, rad/s.
    Led {
        /// rad/s
        velocity_rad_s: f64,
    },
    /// It is led at the velocity that the state holds: of a lever whose way is only known by what a sensor shows, the velocity depends on the sensor's errors.
    Carried,
}

/// What the chambers are connected to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Circuit {
    /// Pump, brake valve and bypass, as in fig. 1. The volume state rests.
    Pump,
    /// Both chambers shut off; oil leaves chamber 1 at this rate (ml/s), and the volume state counts it.
    ShutOff {
        /// ml/s, positive out of the chamber
        release_ml_s: f64,
    },
    /// Both chambers shut off and their pressures known from measurement: they change at these rates (bar/s), and the
    /// volume state counts what must have left chamber 1 for that (ml).
    Measured {
        /// bar/s
        rate1_bar_s: f64,
        /// bar/s
        rate2_bar_s: f64,
    },
    /// The pump alone between two reservoirs at the pressures of the state; the volume state counts what it delivers,
    /// positive in the direction of u (ml).
    Bench,
}

/// What acts from outside during a step (zero-order hold).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Input {
    /// V
    pub voltage_v: f64,
    /// Valve in series with the pump.
    pub brake_open: bool,
    /// Valve parallel to the pump.
    pub bypass_open: bool,
    /// Gravity acts.
    pub vertical: bool,
    /// The lever.
    pub lever: Lever,
    /// The chambers.
    pub circuit: Circuit,
}

impl Input {
    /// The chambers are shut off one by one at their ports.
    fn shut_off(&self) -> bool {
        matches!(self.circuit, Circuit::ShutOff { .. } | Circuit::Measured { .. })
    }
}

/// What a derivative says besides the derivative.
pub struct Derived<S> {
    /// Torque on the lever from everything but its own motion losses, Nm: what a clamp holds.
    pub torque_nm: S,
    /// Flow through pump, valves and line into chamber 1, ml/s.
    pub flow_ml_s: S,
    /// Which branches of the piecewise equations were taken: changes where a kink was crossed.
    pub branches: u32,
}

/// A bypass that is less open than this is shut: one that lags comes near to it for ever.
const SHUT: f64 = 1e-6;

/// The plant's derivative at time `t` (s since the run's start).
///
/// `k`: parameter vector ([`crate::parameters::NAMES`]); `x`, `dx`: [`STATES`] plus the effects' states.
pub fn derivative<S: Scalar>(
    input: &Input,
    k: &[S],
    effects: &EffectSet<S>,
    t: f64,
    x: &[S],
    dx: &mut [S],
) -> Derived<S> {
    derivative_by::<S, true>(&mut Exact, input, k, effects, t, x, dx)
}

/// What the pump follows, after the effects on it.
#[inline(always)]
fn actuated<S: Scalar, const EFFECTS: bool>(
    input: &Input,
    effects: &EffectSet<S>,
    t: f64,
    x: &[S],
    dx: &mut [S],
) -> ActuatorPort<S> {
    let mut actuator = ActuatorPort {
        time_s: t,
        voltage_v: S::constant(input.voltage_v),
        brake_opening: S::constant(f64::from(u8::from(input.brake_open))),
        bypass_opening: S::constant(f64::from(u8::from(input.bypass_open))),
    };
    if EFFECTS && effects.touches(PortKind::Actuator) {
        effects.act(x, dx, Port::Actuator(&mut actuator));
    }
    actuator
}

/// The branches of the pump: whether it delivers, and whether for a positive voltage.
#[inline(always)]
fn pump_branches(delivers: bool, voltage_v: f64) -> u32 {
    u32::from(delivers) << 1 | u32::from(voltage_v > 0.0) << 2
}

/// On these branches the lever is free and slower than the losses' threshold: they have a time constant of 1..2 ms there.
#[inline(always)]
pub(crate) fn creeps(input: &Input, branches: u32) -> bool {
    input.lever == Lever::Free && branches >> 3 == 0
}

/// On these branches the lever is free and faster than the losses' threshold.
#[inline(always)]
pub(crate) fn slides(input: &Input, branches: u32) -> bool {
    input.lever == Lever::Free && branches >> 3 != 0
}

/// [`Derived::branches`] without the derivative; `dx` is scratch.
#[inline(always)]
pub(crate) fn branches(input: &Input, k: &[f64], effects: &EffectSet<f64>, t: f64, x: &[f64], dx: &mut [f64]) -> u32 {
    let dp = x[state::PRESSURE1] - x[state::PRESSURE2];
    let mut branches = u32::from(dp > 0.0);
    if !input.shut_off() {
        let voltage_v = actuated::<f64, true>(input, effects, t, x, dx).voltage_v;
        branches |= pump_branches(pump_flow(k, voltage_v, dp).1, voltage_v);
    }
    if input.lever == Lever::Free {
        branches |= losses(k, x[state::VELOCITY]).1 << 3;
    }
    branches
}

/// [`derivative`] with the functions that are not rational from `curves`; `EFFECTS` = false where none is known to act on the
/// plant, so that no port has to lie in memory.
#[inline(always)]
pub(crate) fn derivative_by<S: Scalar, const EFFECTS: bool>(
    curves: &mut impl Curves<S>,
    input: &Input,
    k: &[S],
    effects: &EffectSet<S>,
    t: f64,
    x: &[S],
    dx: &mut [S],
) -> Derived<S> {
    use state::*;
    let touches = |port| EFFECTS && effects.touches(port);
    assert!(k.len() >= COUNT && x.len() >= STATES && dx.len() >= STATES, "a vector too short for the plant");
    for d in &mut dx[STATES..] {
        *d = S::zero();
    }
    let angle = x[ANGLE];
    let pressure = [x[PRESSURE1], x[PRESSURE2]];
    let dp = pressure[0] - pressure[1];
    let velocity = match input.lever {
        Lever::Free | Lever::Carried => x[VELOCITY],
        Lever::Led { velocity_rad_s } => S::constant(velocity_rad_s),
    };
    let shut_off = input.shut_off();
    let mut branches = u32::from(dp.value() > 0.0);

    // flow through pump and valves, from chamber 2 to chamber 1
    let flow = if shut_off {
        S::zero()
    } else {
        let actuator = actuated::<S, EFFECTS>(input, effects, t, x, dx);
        let (delivered, delivers) = pump_flow(k, actuator.voltage_v, dp);
        branches |= pump_branches(delivers, actuator.voltage_v.value());
        let mut flow = delivered * actuator.brake_opening;
        let bypassed = input.circuit == Circuit::Pump && (input.bypass_open || touches(PortKind::Actuator));
        let bypass_opening = if bypassed { actuator.bypass_opening } else { S::zero() };
        let bypass_ml_s_bar = k[K_B] * bypass_opening;
        if bypassed {
            flow -= bypass_ml_s_bar * dp;
        }
        if touches(PortKind::Line) {
            // slope of the pump's flow over the pressure difference
            let slip = if delivers { k[F3] + k[F2] * actuator.voltage_v.abs() } else { k[F3] } * actuator.brake_opening;
            let mut line = LinePort {
                time_s: t,
                voltage_v: actuator.voltage_v,
                pressure_bar: pressure,
                flow_ml_s: flow,
                slip_ml_s_bar: slip.abs().at_least(0.02),
                bypass_ml_s_bar,
                bypass_opening,
                drive_ml_s: (delivered - k[F3] * dp) * actuator.brake_opening,
                opening: actuator.brake_opening,
                open: actuator.brake_opening.value() > 0.0 || bypass_opening.value() > SHUT,
            };
            effects.act(x, dx, Port::Line(&mut line));
            flow = line.flow_ml_s;
        }
        flow
    };

    let actuator_torque_nm = torque(k, angle, dp);

    // chambers, eqs. (7), (8)
    let mut flow_ml_s = [flow, -flow];
    let mut displacement_ml_rad = displacement(k, angle);
    // on the bench, where nothing is connected, the pressures stay
    let on_bench = input.circuit == Circuit::Bench;
    let mut capacity_ml_bar = if on_bench { [S::constant(1.0); 2] } else { curves.capacity(k, angle, pressure) };
    if touches(PortKind::Hydraulic) && !on_bench {
        let mut hydraulic = HydraulicPort {
            time_s: t,
            pressure_bar: pressure,
            angle_rad: angle,
            velocity_rad_s: velocity,
            flow_ml_s,
            capacity_ml_bar,
            displacement_ml_rad,
            stored_slope_ml_rad: if effects.closes_volume { stored_slope(k, angle, pressure) } else { [S::zero(); 2] },
            actuator_torque_nm,
            shut_off,
        };
        effects.act(x, dx, Port::Hydraulic(&mut hydraulic));
        HydraulicPort { flow_ml_s, capacity_ml_bar, displacement_ml_rad, .. } = hydraulic;
    }
    match input.circuit {
        Circuit::Pump | Circuit::ShutOff { .. } => {
            let mut flow1 = flow_ml_s[0];
            dx[VOLUME] = S::zero();
            if let Circuit::ShutOff { release_ml_s } = input.circuit {
                flow1 = flow1 - release_ml_s;
                dx[VOLUME] = S::constant(release_ml_s);
            }
            dx[PRESSURE1] = (flow1 - displacement_ml_rad[0] * velocity) / capacity_ml_bar[0];
            dx[PRESSURE2] = (flow_ml_s[1] - displacement_ml_rad[1] * velocity) / capacity_ml_bar[1];
        }
        Circuit::Measured { rate1_bar_s, rate2_bar_s } => {
            dx[PRESSURE1] = S::constant(rate1_bar_s);
            dx[PRESSURE2] = S::constant(rate2_bar_s);
            dx[VOLUME] = flow_ml_s[0] - capacity_ml_bar[0] * rate1_bar_s - displacement_ml_rad[0] * velocity;
        }
        Circuit::Bench => {
            dx[PRESSURE1] = S::zero();
            dx[PRESSURE2] = S::zero();
            dx[VOLUME] = if input.voltage_v < 0.0 { -flow } else { flow };
        }
    }

    // motion, eq. (3)
    let mut torque_nm = actuator_torque_nm;
    if input.vertical {
        torque_nm -= k[G] * curves.sine(angle);
    }
    if touches(PortKind::Mechanical) && !on_bench {
        let mut mechanical = MechanicalPort {
            time_s: t,
            angle_rad: angle,
            velocity_rad_s: velocity,
            dp_bar: dp,
            load_bar: pressure[0] + pressure[1] - 2.0 * AMBIENT_BAR,
            vertical: input.vertical,
            torque_nm,
        };
        effects.act(x, dx, Port::Mechanical(&mut mechanical));
        torque_nm = mechanical.torque_nm;
    }
    match input.lever {
        Lever::Free => {
            let (loss, branch) = losses(k, velocity);
            branches |= branch << 3;
            dx[ANGLE] = velocity;
            dx[VELOCITY] = (torque_nm - loss) / k[J];
        }
        Lever::Led { .. } | Lever::Carried => {
            dx[ANGLE] = velocity;
            dx[VELOCITY] = S::zero();
        }
    }
    // effects that only watch the plant (slow sensors) have their states at the sensor port
    if EFFECTS && effects.sensor_states {
        let mut shown = sensor_port(t, x);
        effects.act(x, dx, Port::Sensor(&mut shown));
    }
    Derived { torque_nm, flow_ml_s: flow, branches }
}

fn sensor_port<S: Scalar>(t: f64, x: &[S]) -> SensorPort<S> {
    SensorPort {
        time_s: t,
        angle_deg: x[state::ANGLE] * DEGREES,
        pressure_bar: [x[state::PRESSURE1], x[state::PRESSURE2]],
    }
}

/// What the sensors show in this state: angle (degrees), pressures (bar absolute).
pub fn shown<S: Scalar>(effects: &EffectSet<S>, t: f64, x: &[S], scratch: &mut [S]) -> [S; 3] {
    let mut port = sensor_port(t, x);
    if effects.touches(PortKind::Sensor) {
        effects.act(x, scratch, Port::Sensor(&mut port));
    }
    [port.angle_deg, port.pressure_bar[0], port.pressure_bar[1]]
}

/// Fills the effects' states for the plant at rest in `x[..STATES]`. Of a lever that is led no way to its angle is known.
pub fn rest_states<S: Scalar>(input: &Input, k: &[S], effects: &EffectSet<S>, x: &mut [S]) {
    rest_states_after(Before::default(), input, k, effects, x);
}

/// As [`rest_states`], after what was `before`.
pub fn rest_states_after<S: Scalar>(before: Before, input: &Input, k: &[S], effects: &EffectSet<S>, x: &mut [S]) {
    let pressure = [x[state::PRESSURE1], x[state::PRESSURE2]];
    let angle = x[state::ANGLE];
    let actuator_torque_nm = torque(k, angle, pressure[0] - pressure[1]);
    let mut torque_nm = actuator_torque_nm;
    if input.vertical {
        torque_nm -= k[G] * angle.sin();
    }
    let arrival = match (input.lever, before.held) {
        (Lever::Free, _) => Arrival::Free,
        (Lever::Led { .. } | Lever::Carried, None) => Arrival::Led(before.way_rad),
        (Lever::Led { .. } | Lever::Carried, Some(held)) => {
            let [p1, p2] = held.pressure_bar;
            // the oil may have gone on from its initial pressures while the clamp's torque was read
            torque_nm += torque(k, angle, S::constant(p1 - p2)) - actuator_torque_nm - held.torque_nm;
            Arrival::Held
        }
    };
    let rest = Rest {
        arrival,
        ran: before.ran,
        angle_rad: angle,
        pressure_bar: pressure,
        actuator_torque_nm,
        torque_nm,
        voltage_v: input.voltage_v,
        brake_open: input.brake_open,
        bypass_open: input.bypass_open,
    };
    effects.rest(&rest, &mut x[STATES..]);
}
