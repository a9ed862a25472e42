//! What the effects of a model (`[[effect]]`) change in the loops' arithmetic.
//!
//! | port | used for |
//! |---|---|
//! | sensor | a known error of a sensor's zero is taken out of what was measured: targets mean the true angle and pressures |
//! | hydraulic | capacities and displacements, so the oil that a motion takes; leaks, which the feed-forward makes up for |
//! | mechanical | torque of the reference's equilibrium |
//! | line | the pump's flow at a voltage, and the voltage for a flow |
//!
//! Effects with a memory (lags, hysteresis, play, creep, inertia) are not used. Their states are not measured; and to undo a lag is to
//! differentiate what the loops ask for, sensors' noise included, beyond the bandwidth for which their gains were derived. Their flow is what the
//! integrators learn.

use super::seen::Seen;
use crate::simulation::{Valued, valued};
use model::ModelFile;
use model::effects::EffectSet;
use model::parameters::COUNT;
use model::parameters::index::F3;
use model::port::{AMBIENT_BAR, HydraulicPort, LinePort, MechanicalPort, Port, PortKind, SensorPort};
use model::rec::{STATES, pump_flow, stored_slope};
use std::fmt;
use std::sync::Arc;

/// The effects of a model that have no memory.
#[derive(Clone)]
pub struct KnownEffects {
    set: Arc<EffectSet<f64>>,
    ids: Vec<&'static str>,
}

impl fmt::Debug for KnownEffects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("KnownEffects").field(&self.ids).finish()
    }
}

/// What the hydraulic port holds at one state of the rig.
pub(super) struct Chambers {
    pub capacity_ml_bar: [f64; 2],
    pub displacement_ml_rad: [f64; 2],
    /// Into each chamber, beside the pump's, ml/s.
    pub flow_ml_s: [f64; 2],
}

/// Rounds of the inversion of the pump with its effects; each leaves the share of the flow that an effect makes out.
const ROUNDS: usize = 4;

impl KnownEffects {
    /// Of the reference model: none.
    pub fn none() -> Self {
        KnownEffects { set: Arc::new(EffectSet::none()), ids: Vec::new() }
    }

    /// Of a model file: those of its effects that have no memory. Effects that the library does not have and parameters that are missing are
    /// refused where the file is used as a plant; here they are nothing.
    pub fn of(model: &ModelFile) -> Self {
        let known = model.effect.iter().filter_map(|added| valued(added).ok());
        let known: Vec<Valued> = known.filter(|(effect, _)| effect.header().states == 0).collect();
        let ids = known.iter().map(|(e, _)| e.header().id).collect();
        KnownEffects { set: Arc::new(EffectSet::new(STATES, known)), ids }
    }

    /// Their ids.
    pub fn ids(&self) -> &[&'static str] {
        &self.ids
    }

    fn act(&self, port: Port<'_, f64>) {
        // none of them has a state
        self.set.act(&[0.0; STATES], &mut [0.0; STATES], port);
    }

    /// What was measured without the sensors' known errors.
    pub(super) fn corrected(&self, time_s: f64, seen: &Seen) -> Seen {
        if !self.set.touches(PortKind::Sensor) {
            return *seen;
        }
        let Seen { angle_deg, pressure1_bar, pressure2_bar } = *seen;
        let mut port = SensorPort { time_s, angle_deg, pressure_bar: [pressure1_bar, pressure2_bar] };
        self.act(Port::Sensor(&mut port));
        Seen {
            angle_deg: 2.0 * angle_deg - port.angle_deg,
            pressure1_bar: 2.0 * pressure1_bar - port.pressure_bar[0],
            pressure2_bar: 2.0 * pressure2_bar - port.pressure_bar[1],
        }
    }

    /// Torque on the lever beside that of the reference model, Nm.
    pub(super) fn torque_nm(
        &self,
        time_s: f64,
        [angle_rad, velocity_rad_s]: [f64; 2],
        dp_bar: f64,
        sum_bar: f64,
        vertical: bool,
    ) -> f64 {
        if !self.set.touches(PortKind::Mechanical) {
            return 0.0;
        }
        let load_bar = sum_bar - 2.0 * AMBIENT_BAR;
        let mut port = MechanicalPort { time_s, angle_rad, velocity_rad_s, dp_bar, load_bar, vertical, torque_nm: 0.0 };
        self.act(Port::Mechanical(&mut port));
        port.torque_nm
    }

    /// Capacities, displacements and leaks at rest; `capacity` and `displacement` are the reference model's.
    pub(super) fn chambers(
        &self,
        k: &[f64; COUNT],
        time_s: f64,
        angle_rad: f64,
        pressure_bar: [f64; 2],
        capacity_ml_bar: [f64; 2],
        displacement_ml_rad: [f64; 2],
    ) -> Chambers {
        if !self.set.touches(PortKind::Hydraulic) {
            return Chambers { capacity_ml_bar, displacement_ml_rad, flow_ml_s: [0.0; 2] };
        }
        let mut port = HydraulicPort {
            time_s,
            pressure_bar,
            angle_rad,
            velocity_rad_s: 0.0,
            flow_ml_s: [0.0; 2],
            capacity_ml_bar,
            displacement_ml_rad,
            stored_slope_ml_rad: stored_slope(k, angle_rad, pressure_bar),
            actuator_torque_nm: 0.0,
            shut_off: false,
        };
        self.act(Port::Hydraulic(&mut port));
        let HydraulicPort { flow_ml_s, capacity_ml_bar, displacement_ml_rad, .. } = port;
        Chambers { capacity_ml_bar, displacement_ml_rad, flow_ml_s }
    }

    /// Flow at a voltage (V) and the chambers' pressures (bar absolute), brake open, bypass closed, ml/s: eq. (10) and the effects on it.
    pub(super) fn flow_ml_s(&self, k: &[f64; COUNT], time_s: f64, voltage_v: f64, pressure_bar: [f64; 2]) -> f64 {
        let dp_bar = pressure_bar[0] - pressure_bar[1];
        let (flow_ml_s, delivers) = pump_flow(k, voltage_v, dp_bar);
        if !self.set.touches(PortKind::Line) {
            return flow_ml_s;
        }
        let slip = if delivers { k[F3] + k[model::parameters::index::F2] * voltage_v.abs() } else { k[F3] };
        let mut port = LinePort {
            time_s,
            voltage_v,
            pressure_bar,
            flow_ml_s,
            slip_ml_s_bar: slip.abs().max(0.02),
            bypass_ml_s_bar: 0.0,
            bypass_opening: 0.0,
            drive_ml_s: flow_ml_s - k[F3] * dp_bar,
            opening: 1.0,
            open: true,
        };
        self.act(Port::Line(&mut port));
        port.flow_ml_s
    }

    /// The voltage for a flow at the chambers' pressures (bar absolute): `inverse` solves eq. (10); what the effects add is taken off what it is asked for.
    pub(super) fn voltage_v(
        &self,
        k: &[f64; COUNT],
        time_s: f64,
        flow_ml_s: f64,
        pressure_bar: [f64; 2],
        inverse: impl Fn(f64) -> f64,
    ) -> f64 {
        let mut voltage_v = inverse(flow_ml_s);
        if self.set.touches(PortKind::Line) {
            let dp_bar = pressure_bar[0] - pressure_bar[1];
            for _ in 0..ROUNDS {
                let added = self.flow_ml_s(k, time_s, voltage_v, pressure_bar) - pump_flow(k, voltage_v, dp_bar).0;
                voltage_v = inverse(flow_ml_s - added);
            }
        }
        voltage_v
    }
}
