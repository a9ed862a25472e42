//! EMPS: an electro-mechanical positioning system, DC motor with ball screw and carriage, in closed loop.
//!
//! Data: Janot, Gautier, Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System Identification Benchmarks 2019.
//! Columns `t_s`, `q_m`, `vir_V` and, in the test file, `pulses_N`, 24841 rows at 1 kHz.
//!
//! The controller hides friction from the position, so the force is the output: it is predicted from the measured motion (the
//! inverse model). The encoder's values and the force are smoothed by the same filter without a shift, so that it drops out of the
//! equation, and speed and acceleration are central differences; targets are means over 10 ms (Gautier's parallel decimation).

use model::effects::{
    AsymmetricCoulomb, Balance, CoulombFriction, CubicStiffness, ForceOffset, QuadraticDrag, QuadraticStiffness,
};
use model::port::PortKind;
use model::scalar::Scalar;
use recordings::Role;

use super::{DataError, Section, Source, Table, TablePlant};
use crate::equations::{Between, Equations, Instant};
use crate::plant::{BaseParameter, PlantHeader, Quantity};
use crate::prepare::Stretch;
use crate::smoothing::{differences, local_cubic};

/// See the module.
pub struct Emps;

/// The plant.
pub static EMPS: Emps = Emps;

/// Force of the drive over the controller's output, N/V (given with the data).
const DRIVE_N_V: f64 = 35.15065188;
/// The local cubic reaches so far to both sides, s: it passes what the closed loop moves at (below 30 Hz) and cuts the encoder's steps.
const REACH_S: f64 = 0.015;
/// Targets are means over so many rows: 10 ms.
const BLOCK: usize = 10;

static HEADER: PlantHeader = PlantHeader {
    id: "emps",
    summary: "a carriage on a ball screw in closed loop: the force that its motion takes",
    equation: "F = M q'' + Fv q'",
    states: &[],
    inputs: &[
        Quantity { name: "q", unit: "m" },
        Quantity { name: "speed", unit: "m/s" },
        Quantity { name: "acceleration", unit: "m/s2" },
    ],
    channels: &[Quantity { name: "force", unit: "N" }],
    parameters: &[
        BaseParameter { name: "M", unit: "kg", lower: 1e-3, upper: 1e5, start: 100.0 },
        BaseParameter { name: "Fv", unit: "N s/m", lower: 0.0, upper: 1e6, start: 200.0 },
    ],
    balances: &[(Balance::Torque, "force")],
    ports: &[PortKind::Mechanical],
    library: &[
        &QuadraticStiffness,
        &CubicStiffness,
        &ForceOffset,
        &CoulombFriction,
        &AsymmetricCoulomb,
        &QuadraticDrag,
    ],
};

impl Equations for Emps {
    fn header(&self) -> &'static PlantHeader {
        &HEADER
    }

    /// A second is several times what the closed loop and the filter remember.
    fn cluster_s(&self) -> f64 {
        1.0
    }

    /// Only effects have states.
    fn step_s(&self) -> f64 {
        1e-3
    }

    fn between(&self) -> Between {
        Between::Straight
    }

    fn derivative<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S]) {
        at.mechanical(dx, S::constant(at.u[0]), S::constant(at.u[1]));
    }

    fn outputs<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S], y: &mut [S]) {
        let effects = at.mechanical(dx, S::constant(at.u[0]), S::constant(at.u[1]));
        y[0] = at.k[0] * at.u[2] + at.k[1] * at.u[1] - effects;
    }
}

impl TablePlant for Emps {
    /// Ripple of screw and belt, which no term of so plain a model has.
    fn resolution(&self) -> f64 {
        0.01
    }

    fn sections(&self, table: &Table, source: Source) -> Result<Vec<Section>, DataError> {
        let (time_s, q, output_v) = (table.column("t_s")?, table.column("q_m")?, table.column("vir_V")?);
        table.at_least(1000, "a second at 1 kHz")?;
        let step_s = (time_s[time_s.len() - 1] - time_s[0]) / (time_s.len() - 1) as f64;
        if !(step_s > 0.0 && step_s < REACH_S / 3.0) {
            return Err(table.refuse(format!(
                "column t_s: expected growing seconds, less than {:.3} s apart, got a mean step of {step_s} s",
                REACH_S / 3.0
            )));
        }
        let force_n: Vec<f64> = output_v.iter().map(|v| DRIVE_N_V * v).collect();
        let half = (REACH_S / step_s).round() as usize;
        let position = local_cubic(q, half);
        let (speed, acceleration) = differences(&position, step_s);
        let inputs = vec![position, speed, acceleration];
        let (name, role) = match source {
            Source::Data => ("training file", Role::Identify),
            Source::Validation => ("test file", Role::Validate),
        };
        // what has less than a whole window around it is not compared
        let mut measured = local_cubic(&force_n, half);
        let end = measured.len();
        measured[..half].fill(f64::NAN);
        measured[end - half..].fill(f64::NAN);
        let block = if role == Role::Identify { BLOCK } else { 1 };
        let time_s = (0..end).map(|i| i as f64 * step_s).collect();
        let stretch = Stretch::of_columns(0, time_s, inputs, vec![measured], (Vec::new(), Vec::new()), block);
        Ok(vec![Section { name, role, stretches: vec![stretch] }])
    }
}
