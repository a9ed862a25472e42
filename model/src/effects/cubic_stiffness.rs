//! A spring that hardens or softens with displacement.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct CubicStiffness;

impl Law for CubicStiffness {
    const HEADER: Header = Header {
        id: "cubic_stiffness",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "the restoring force hardens (k > 0) or softens (k < 0) with displacement",
        equation: "M -= k*phi^3",
        validity: "first odd term beyond the linear one of a symmetric characteristic",
        measure: "static characteristic at large displacement, or the resonance over growing amplitudes",
        literature: "Duffing, Erzwungene Schwingungen (1918); Wigren and Schoukens, Three free data sets for nonlinear system identification, ECC 2013",
        parameters: &[Parameter { name: "k", unit: "Nm/rad3", lower: -1e6, upper: 1e6, typical: 1.0, size: true }],
        states: 0,
        starts: &[&[0.1], &[10.0], &[1000.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm -= k[0] * m.angle_rad * m.angle_rad * m.angle_rad;
        }
    }
}
