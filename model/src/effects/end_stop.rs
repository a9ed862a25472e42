//! Elastic contact near the end of the angle range: chambers that touch the housing, or a buffer.

use super::{Balance, Header, Law, Parameter, Refined};
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
    const REFINED: Option<Refined> = Some(Refined { effect: &Progressive, neutral: &[1.0], starts: &[&[1.5], &[2.0]] });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        press(k, port, |depth| depth);
    }
}

/// A contact that stiffens or softens with its depth.
struct Progressive;

/// Depth at which a progressive contact presses as hard as a linear one, rad.
const USUAL_DEPTH_RAD: f64 = 0.05;

impl Law for Progressive {
    const HEADER: Header = Header {
        equation: "M -= k*d_0*(d/d_0)^n*sgn(phi), d = max(0, abs(phi) - phi_c) with its corner rounded over 0.002 rad, d_0 = 0.05 rad",
        validity: "elastic contact without loss, at the same angle on both sides; n = 1.5 for two rounded bodies",
        parameters: &[
            EndStop::HEADER.parameters[0],
            EndStop::HEADER.parameters[1],
            Parameter { name: "n", unit: "1", lower: 0.8, upper: 4.0, typical: 1.5, size: false },
        ],
        starts: &[&[5.0, 24.0, 2.0], &[5.0, 29.0, 2.0], &[20.0, 33.0, 2.0]],
        ..EndStop::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        press(k, port, |depth| (depth / USUAL_DEPTH_RAD).powf(k[2]) * USUAL_DEPTH_RAD);
    }
}

/// `k[0]` times a function of how deep the lever is beyond `k[1]`, against it.
fn press<S: Scalar>(k: &[S], port: &mut Port<'_, S>, of_depth: impl Fn(S) -> S) {
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
        // a power has no slope at 0
        if pressed.value() <= 1e-9 {
            return;
        }
        let torque = k[0] * of_depth(pressed);
        if m.angle_rad.value() > 0.0 {
            m.torque_nm -= torque;
        } else {
            m.torque_nm += torque;
        }
    }
}
