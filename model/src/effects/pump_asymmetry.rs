//! A pump whose flow differs with the direction of rotation.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// Half of the difference goes to each direction, so that eq. (10) stays the mean of both.
pub struct PumpAsymmetry;

/// Driven flow (ml/s) over which offset and slip come in as the pump leaves its dead zone.
const ONSET_ML_S: f64 = 0.5;

impl Law for PumpAsymmetry {
    const HEADER: Header = Header {
        id: "pump_asymmetry",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "the pump's flow differs with the direction of rotation",
        equation: "Q += abs(D)*gain/2 + abs(s)*offset/2 - s*slip/2*dp; D: part of eq. (10) outside f3*dp, s = D/(abs(D) + 0.5 ml/s). Positive: more drive, more slip for u > 0",
        validity: "outside of the dead zone; inside nothing changes",
        measure: "pump map in both directions",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 4 (leakage and drive of pumps)",
        parameters: &[
            Parameter { name: "gain", unit: "1", lower: -1.0, upper: 1.0, typical: 0.02, size: true },
            Parameter { name: "offset", unit: "ml/s", lower: -3.0, upper: 3.0, typical: 0.1, size: true },
            Parameter { name: "slip", unit: "ml/(s bar)", lower: -1.0, upper: 1.0, typical: 0.02, size: true },
        ],
        states: 0,
        starts: &[
            &[0.01, 0.0, 0.0],
            &[-0.01, 0.0, 0.0],
            &[0.1, 0.0, 0.0],
            &[-0.1, 0.0, 0.0],
            &[0.0, 0.1, 0.0],
            &[0.0, 0.0, 0.05],
        ],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let drive = l.drive_ml_s;
            let strength = drive.abs();
            let share = drive / (strength + ONSET_ML_S);
            l.flow_ml_s += (k[0] * strength + k[1] * share.abs() - k[2] * share * l.dp_bar()) * 0.5;
        }
    }
}
