//! Friction that grows with the pressures, as the paper expects at the end of its sec. 4.4.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct PressureFriction;

impl Law for PressureFriction {
    const HEADER: Header = Header {
        id: "pressure_friction",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "friction grows with the sum of the chamber pressures",
        equation: "M -= k*(p1 + p2 - 2*p_amb)*tanh(w/w_s)",
        validity: "sliding; the Coulomb level is smoothed over w_s",
        measure: "constant-flow strokes at several fill pressures",
        literature: "Olsson et al., Friction models and friction compensation, Eur. J. Control 4 (1998)",
        parameters: &[
            Parameter { name: "k", unit: "Nm/bar", lower: 0.0, upper: 5.0, typical: 0.1, size: true },
            Parameter { name: "w_s", unit: "rad/s", lower: 0.002, upper: 0.2, typical: 0.02, size: false },
        ],
        states: 0,
        starts: &[&[0.03, 0.02], &[0.4, 0.02], &[1.0, 0.05]],
        passive: true,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm -= k[0] * m.load_bar * (m.velocity_rad_s / k[1]).tanh();
        }
    }
}
