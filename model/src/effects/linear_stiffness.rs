//! A spring on a body that the plant takes as free.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct LinearStiffness;

impl Law for LinearStiffness {
    const HEADER: Header = Header {
        id: "linear_stiffness",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "a linear spring acts on the body",
        equation: "M -= k*phi",
        validity: "springs, cables and hoses within their linear range",
        measure: "push the resting body away and read the force",
        literature: "any text on vibrations, the linear oscillator",
        parameters: &[Parameter { name: "k", unit: "Nm/rad", lower: -1e6, upper: 1e6, typical: 1.0, size: true }],
        states: 0,
        starts: &[&[0.1], &[10.0], &[1000.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm -= k[0] * m.angle_rad;
        }
    }
}
