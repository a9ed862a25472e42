//! Dry friction: the same force at any speed, against the motion.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct CoulombFriction;

impl Law for CoulombFriction {
    const HEADER: Header = Header {
        id: "coulomb_friction",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "dry friction acts against the motion, the same at any speed",
        equation: "M -= c*tanh(w/w_s)",
        validity: "gross sliding; rest is smoothed over w_s, so the body creeps where it would stick",
        measure: "slow strokes in both directions at several speeds: half the difference of the forces",
        literature: "Coulomb, Theorie des machines simples (1785); Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models for the control of machines with friction, Automatica 30 (1994)",
        parameters: &[
            Parameter { name: "c", unit: "Nm", lower: 0.0, upper: 1e6, typical: 1.0, size: true },
            Parameter { name: "w_s", unit: "rad/s", lower: 1e-5, upper: 0.5, typical: 0.01, size: false },
        ],
        states: 0,
        starts: &[&[0.001, 0.01], &[0.1, 0.001], &[0.1, 0.03], &[10.0, 0.001], &[10.0, 0.03]],
        passive: true,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm -= k[0] * (m.velocity_rad_s / k[1]).tanh();
        }
    }
}
