//! Silverbox: an electronic oscillator that stands for a mass on a spring.
//!
//! Data: Wigren and Schoukens, Three free data sets for development and benchmarking in nonlinear system identification, ECC 2013.
//! Columns `u_V`, `y_V`, 131072 rows at 610.35 Hz.

use model::effects::{Balance, CoulombFriction, CubicStiffness, ForceOffset, QuadraticDrag, QuadraticStiffness};
use model::port::PortKind;
use model::scalar::Scalar;
use recordings::Role;

use super::{DataError, Section, Source, Table, TablePlant};
use crate::equations::{Between, Equations, Instant};
use crate::plant::{BaseParameter, PlantHeader, Quantity};
use crate::prepare::Stretch;

/// See the module.
pub struct Silverbox;

/// The plant.
pub static SILVERBOX: Silverbox = Silverbox;

/// 10 MHz / 2^14
const RATE_HZ: f64 = 1e7 / 16384.0;
/// Rows of the test signal with growing amplitude.
const ARROW: (usize, usize) = (100, 40_575);
/// Its part within the amplitudes of the multisine.
const ARROW_INSIDE: (usize, usize) = (100, 32_100);
/// Rows of the odd random-phase multisine; the first three quarters are fitted.
const MULTISINE: (usize, usize) = (40_650, 127_400);
/// Rows that a free run may take to forget its initial state; they are not scored.
const SETTLING: usize = 50;
/// Rows of a fitted stretch: 8 s.
const PIECE: usize = 5000;

static HEADER: PlantHeader = PlantHeader {
    id: "silverbox",
    summary: "a mass on a spring with a damper, driven by a force (an electronic circuit stands for it)",
    equation: "m y'' + d y' + k y = u",
    states: &[Quantity { name: "y", unit: "V" }, Quantity { name: "speed", unit: "V/s" }],
    inputs: &[Quantity { name: "u", unit: "V" }],
    channels: &[Quantity { name: "y", unit: "V" }],
    parameters: &[
        BaseParameter { name: "m", unit: "s2", lower: 1e-9, upper: 1.0, start: 5e-6 },
        BaseParameter { name: "d", unit: "s", lower: 0.0, upper: 1.0, start: 2e-4 },
        BaseParameter { name: "k", unit: "1", lower: 1e-3, upper: 1e3, start: 1.0 },
    ],
    balances: &[(Balance::Torque, "force")],
    ports: &[PortKind::Mechanical],
    // asymmetric friction is a part of dry friction: for itself it would drive the body
    library: &[&CubicStiffness, &QuadraticStiffness, &ForceOffset, &CoulombFriction, &QuadraticDrag],
};

impl Equations for Silverbox {
    fn header(&self) -> &'static PlantHeader {
        &HEADER
    }

    /// Some ten times the decay of the resonance.
    fn cluster_s(&self) -> f64 {
        0.5
    }

    /// The resonance lies near 70 Hz.
    fn step_s(&self) -> f64 {
        0.6e-3
    }

    /// The input is band-limited to 200 Hz and was sampled at the plant.
    fn between(&self) -> Between {
        Between::Smooth
    }

    fn derivative<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S]) {
        let (y, speed) = (at.x[0], at.x[1]);
        let [m, d, k] = [at.k[0], at.k[1], at.k[2]];
        let force = at.mechanical(dx, y, speed) + at.u[0] - d * speed - k * y;
        dx[0] = speed;
        dx[1] = force / m;
    }

    fn outputs<S: Scalar>(&self, at: &Instant<S>, _dx: &mut [S], y: &mut [S]) {
        y[0] = at.x[0];
    }
}

/// Rows `[first, end)` as a stretch. It starts where the output and its central difference say; a stretch that is fitted corrects that.
fn stretch(run: usize, u: &[f64], y: &[f64], (first, end): (usize, usize), fitted: bool, settling: usize) -> Stretch {
    let before = first.saturating_sub(1);
    let speed = (y[first + 1] - y[before]) * RATE_HZ / (first + 1 - before) as f64;
    let mut measured = y[first..end].to_vec();
    measured[..settling.min(end - first)].fill(f64::NAN);
    // differences of a signal near 70 Hz at this rate are a tenth off
    let spread = if fitted { vec![1e-2, 10.0] } else { vec![0.0; 2] };
    let time_s = (first..end).map(|i| i as f64 / RATE_HZ).collect();
    Stretch::of_columns(run, time_s, vec![u[first..end].to_vec()], vec![measured], (vec![y[first], speed], spread), 1)
}

impl TablePlant for Silverbox {
    /// Eight bits of the signal: converters, and an input that is known at the samples alone.
    fn resolution(&self) -> f64 {
        0.004
    }

    fn sections(&self, table: &Table, source: Source) -> Result<Vec<Section>, DataError> {
        if source == Source::Validation {
            return Err(table.refuse(
                "silverbox takes its validation data from the one file of the benchmark; leave --validate away".into(),
            ));
        }
        let (u, y) = (table.column("u_V")?, table.column("y_V")?);
        table.at_least(MULTISINE.1, "the benchmark's file has 131072")?;
        let middle = MULTISINE.0 + (MULTISINE.1 - MULTISINE.0) * 3 / 4;
        let starts = (MULTISINE.0..middle - PIECE / 2).step_by(PIECE);
        let fitted = starts.map(|a| stretch(0, u, y, (a, (a + PIECE).min(middle)), true, 0)).collect();
        let predicted = |run, rows| vec![stretch(run, u, y, rows, false, SETTLING)];
        let of = |name, role, stretches| Section { name, role, stretches };
        Ok(vec![
            of("multisine, first three quarters", Role::Identify, fitted),
            of("multisine test", Role::Validate, predicted(1, (middle, MULTISINE.1))),
            of("arrow", Role::Validate, predicted(2, ARROW)),
            of("arrow, no extrapolation", Role::Validate, predicted(3, ARROW_INSIDE)),
        ])
    }
}
