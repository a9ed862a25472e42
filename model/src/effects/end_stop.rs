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
        summary: "an elastic contact acts near an end of the angle range, or near both",
        equation: "M -= k1*max(0, phi - phi_c) - k2*max(0, -phi - phi_c), the corners rounded over 0.002 rad",
        validity: "linear contact without loss, at the same angle on both sides",
        measure: "push the lever slowly to its end with the bypass open and read the force sensor",
        literature: "Johnson, Contact Mechanics, 1985; paper, remark below eq. (2) on angles beyond 30 degrees",
        parameters: &[
            Parameter { name: "k1", unit: "Nm/rad", lower: 0.0, upper: 500.0, typical: 10.0, size: true },
            Parameter { name: "k2", unit: "Nm/rad", lower: 0.0, upper: 500.0, typical: 10.0, size: true },
            Parameter { name: "phi_c", unit: "deg", lower: 15.0, upper: 60.0, typical: 36.0, size: false },
        ],
        states: 0,
        starts: &[
            &[3.0, 3.0, 27.0],
            &[10.0, 10.0, 32.0],
            &[10.0, 10.0, 36.0],
            &[60.0, 60.0, 34.0],
            &[60.0, 60.0, 38.0],
            &[20.0, 0.0, 24.0],
            &[0.0, 20.0, 24.0],
            &[60.0, 0.0, 30.0],
            &[0.0, 60.0, 30.0],
        ],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Progressive,
        neutral: &[1.0, 0.0, 0.0, 0.02],
        starts: &[&[1.5, 0.0, 0.0, 0.01], &[2.0, 0.0, 0.0, 0.01], &[10.0, 0.0, 0.0, 0.05], &[1.0, 0.0, 0.5, 0.02]],
        away: &[
            (&[0.4, 0.4, 0.95], &[2.0, 0.0, 0.0, 0.01]),
            (&[0.4, 0.4, 0.95], &[10.0, 0.0, 0.0, 0.025]),
            (&[0.2, 0.2, 0.9], &[10.0, 0.0, 0.0, 0.05]),
            (&[0.08, 0.08, 0.8], &[10.0, 0.0, 0.0, 0.1]),
        ],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        press([k[0], k[1]], [k[2], k[2]], port, |depth, _| depth);
    }

    fn is_itself(&self, k: &[f64]) -> bool {
        begins_near_an_end(k[2])
    }
}

/// What would begin nearer to the middle than `phi_c` may lie, where a fit ends at that bound or just within it, is no contact with an end, but something
/// that acts throughout the stroke.
fn begins_near_an_end(at_deg: f64) -> bool {
    at_deg > EndStop::HEADER.parameters[2].lower + WITHIN_DEG
}

/// A size below this share of the other end's says nothing of where its end begins.
const NO_CONTACT: f64 = 0.01;

/// How near to its bound `phi_c` stands at it, deg.
const WITHIN_DEG: f64 = 0.5;

/// A contact that stiffens or softens with its depth, begins earlier at one end, and loses what it was pushed in with.
struct Progressive;

/// Depth at which a progressive contact presses as hard as a linear one, rad.
const USUAL_DEPTH_RAD: f64 = 0.05;

impl Progressive {
    /// Depth (rad) at which a linear contact presses as hard as this one does at `depth_rad`: a power `n` of the depth beyond some `b` (rad), and near an
    /// exponential function of `depth_rad/b` where `n` is large.
    fn linear_depth_rad<S: Scalar>(depth_rad: S, n: S, b: S) -> S {
        let by = |depth: S| (depth / (n * b) + 1.0).powf(n) - 1.0;
        by(depth_rad) / by(S::constant(USUAL_DEPTH_RAD)) * USUAL_DEPTH_RAD
    }
}

impl Law for Progressive {
    const HEADER: Header = Header {
        equation: "M -= k1*f(phi - phi_c - e) - k2*f(-phi - phi_c + e), f(d) = d_0*s(d)/s(d_0)*max(0, 1 + c*d') for d > 0, s(d) = (1 + d/(n*b))^n - 1, its corner rounded over 0.002 rad, d_0 = 0.05 rad",
        validity: "n = 1 linear; b far below d: a power of d, n = 1.5 for two rounded bodies; n large: exponential over b, as rubber; a loss that grows with the force (Hunt and Crossley), so the contact never pulls; no force within 1e-9 rad of the rounded corner",
        literature: "Johnson, Contact Mechanics, 1985; Freakley, Payne, Theory and Practice of Engineering with Rubber, 1978 (buffers that stiffen); Hunt, Crossley, J. Appl. Mech. 42 (1975) 440",
        parameters: &[
            EndStop::HEADER.parameters[0],
            EndStop::HEADER.parameters[1],
            EndStop::HEADER.parameters[2],
            Parameter { name: "n", unit: "1", lower: 0.8, upper: 30.0, typical: 1.5, size: false },
            Parameter { name: "e", unit: "deg", lower: -15.0, upper: 15.0, typical: 2.0, size: false },
            Parameter { name: "c", unit: "s/rad", lower: 0.0, upper: 5.0, typical: 0.3, size: false },
            Parameter { name: "b", unit: "rad", lower: 0.0005, upper: 0.5, typical: 0.02, size: false },
        ],
        starts: &[
            &[5.0, 5.0, 24.0, 2.0, 0.0, 0.0, 0.01],
            &[5.0, 5.0, 29.0, 2.0, 0.0, 0.0, 0.01],
            &[20.0, 20.0, 33.0, 2.0, 0.0, 0.0, 0.01],
        ],
        ..EndStop::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        press([k[0], k[1]], [k[2] + k[4], k[2] - k[4]], port, |depth, speed| {
            Self::linear_depth_rad(depth, k[3], k[6]) * (k[5] * speed + 1.0).at_least(0.0)
        });
    }

    /// Each end that presses: where one alone does, `phi_c` and `e` by themselves say nothing.
    fn is_itself(&self, k: &[f64]) -> bool {
        let most = k[0].max(k[1]);
        let ends = [(k[0], k[2] + k[4]), (k[1], k[2] - k[4])];
        ends.into_iter().all(|(size, at_deg)| size < NO_CONTACT * most || begins_near_an_end(at_deg))
    }
}

/// A force by depth (rad) and speed (rad/s) beyond the angle `phi_c_deg` of each end, the positive one first, against the lever.
fn press<S: Scalar>(k: [S; 2], phi_c_deg: [S; 2], port: &mut Port<'_, S>, force: impl Fn(S, S) -> S) {
    if let Port::Mechanical(m) = port {
        for (end, side) in [1.0, -1.0].into_iter().enumerate() {
            let depth = m.angle_rad * side - phi_c_deg[end] * (std::f64::consts::PI / 180.0);
            let pressed = if depth.value() <= -0.5 * CLOSING_RAD {
                continue;
            } else if depth.value() < 0.5 * CLOSING_RAD {
                let closed = depth + 0.5 * CLOSING_RAD;
                closed * closed / (2.0 * CLOSING_RAD)
            } else {
                depth
            };
            if pressed.value() > 1e-9 {
                m.torque_nm -= k[end] * force(pressed, m.velocity_rad_s * side) * side;
            }
        }
    }
}
