//! Elastic contact near the end of the angle range: chambers that touch the housing, or a buffer.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct EndStop;

/// The contact closes over this angle, rad: the torque has no corner in it.
const CLOSING_RAD: f64 = 0.002;

impl Law for EndStop {
    const HEADER: Header = Header {
        id: "end_stop",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "an elastic contact acts near both ends of the angle range",
        equation: "M -= k*max(0, abs(phi) - phi_c)*sgn(phi), the corner rounded over 0.002 rad",
        validity: "linear contact without loss, at the same angle on both sides",
        measure: "push the lever slowly to its end with the bypass open and read the force sensor",
        literature: "Johnson, Contact Mechanics, 1985; paper, remark below eq. (2) on angles beyond 30 degrees",
        parameters: &[
            Parameter { name: "k", unit: "Nm/rad", lower: 0.0, upper: 500.0, typical: 10.0, size: true },
            Parameter { name: "phi_c", unit: "deg", lower: 15.0, upper: 60.0, typical: 36.0, size: false },
        ],
        states: 0,
        starts: &[&[3.0, 27.0], &[10.0, 32.0], &[10.0, 36.0], &[60.0, 34.0], &[60.0, 38.0]],
        passive: true,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let depth = m.angle_rad.abs() - k[1] * (std::f64::consts::PI / 180.0);
            let pressed = if depth.value() <= -0.5 * CLOSING_RAD {
                return;
            } else if depth.value() < 0.5 * CLOSING_RAD {
                let closed = depth + 0.5 * CLOSING_RAD;
                closed * closed / (2.0 * CLOSING_RAD)
            } else {
                depth
            };
            if m.angle_rad.value() > 0.0 {
                m.torque_nm -= k[0] * pressed;
            } else {
                m.torque_nm += k[0] * pressed;
            }
        }
    }
}
