//! A spring that is softer on one side than on the other.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct QuadraticStiffness;

impl Law for QuadraticStiffness {
    const HEADER: Header = Header {
        id: "quadratic_stiffness",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "the restoring force has a part that is even in the displacement",
        equation: "M -= k*phi^2",
        validity: "first even term of a smooth characteristic about the rest",
        measure: "static characteristic, led to both sides over the whole range",
        literature: "Kovacic and Brennan, The Duffing Equation, Wiley (2011), chapter on asymmetric systems (Helmholtz-Duffing)",
        parameters: &[Parameter { name: "k", unit: "Nm/rad2", lower: -1e6, upper: 1e6, typical: 1.0, size: true }],
        states: 0,
        starts: &[&[0.1], &[10.0], &[1000.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm -= k[0] * m.angle_rad * m.angle_rad;
        }
    }
}
