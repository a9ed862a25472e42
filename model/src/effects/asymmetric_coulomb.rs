//! Dry friction that differs between the directions: what it has beyond the mean of both.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct AsymmetricCoulomb;

/// Below this speed the body counts as resting, rad/s.
const REST_RAD_S: f64 = 1e-3;

impl Law for AsymmetricCoulomb {
    const HEADER: Header = Header {
        id: "asymmetric_coulomb",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "dry friction is larger in one direction than in the other",
        equation: "M -= d*tanh(w/0.001)^2; with coulomb_friction c: c + d forwards, c - d backwards",
        validity: "gross sliding; vanishes at rest, which alone tells it from a constant force",
        measure: "slow strokes in both directions: the mean of the forces, which vanishes at rest",
        literature: "Armstrong-Helouvry, Control of Machines with Friction, Kluwer (1991)",
        parameters: &[Parameter { name: "d", unit: "Nm", lower: -1e6, upper: 1e6, typical: 1.0, size: true }],
        states: 0,
        starts: &[&[0.001], &[0.1], &[10.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let direction = (m.velocity_rad_s / REST_RAD_S).tanh();
            m.torque_nm -= k[0] * direction * direction;
        }
    }
}
