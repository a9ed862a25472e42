//! Drag of a fluid around the body, or of one that it displaces.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct QuadraticDrag;

impl Law for QuadraticDrag {
    const HEADER: Header = Header {
        id: "quadratic_drag",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "drag grows with the square of the speed",
        equation: "M -= c*abs(w)*w",
        validity: "turbulent flow around the body or through what it displaces",
        measure: "coast down from high speed, or steady strokes from slow to fast",
        literature: "Hoerner, Fluid-Dynamic Drag, 1965, ch. 3 (pressure drag)",
        parameters: &[Parameter { name: "c", unit: "Nm s2/rad2", lower: 0.0, upper: 1e6, typical: 1.0, size: true }],
        states: 0,
        starts: &[&[0.1], &[10.0], &[1000.0]],
        passive: true,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm -= k[0] * m.velocity_rad_s.abs() * m.velocity_rad_s;
        }
    }
}
