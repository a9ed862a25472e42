//! Friction that is highest just above rest and falls with velocity, on top of eq. (16).

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct StribeckFriction;

impl Law for StribeckFriction {
    const HEADER: Header = Header {
        id: "stribeck_friction",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "friction has a peak near zero velocity",
        equation: "M -= k*exp(-(w/w_v)^2)*tanh(w/w_s)",
        validity: "mixed lubrication; the static level is smoothed over w_s, so the lever creeps where it would stick",
        measure: "strokes at the lowest constant flows, where the torque falls with velocity",
        literature: "Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models for the control of machines with friction, Automatica 30 (1994)",
        parameters: &[
            Parameter { name: "k", unit: "Nm", lower: 0.0, upper: 10.0, typical: 0.2, size: true },
            Parameter { name: "w_v", unit: "rad/s", lower: 0.01, upper: 3.0, typical: 0.1, size: false },
            Parameter { name: "w_s", unit: "rad/s", lower: 0.002, upper: 0.2, typical: 0.02, size: false },
        ],
        states: 0,
        starts: &[
            &[0.1, 0.05, 0.02],
            &[0.1, 0.2, 0.02],
            &[0.1, 0.8, 0.02],
            &[1.5, 0.1, 0.02],
            &[1.5, 0.5, 0.02],
            &[0.5, 0.4, 0.005],
        ],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &AnyFall,
        neutral: &[2.0, 0.0],
        starts: &[&[1.0, 0.0], &[2.0, 1.0]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let w = m.velocity_rad_s;
            let fall = w / k[1];
            m.torque_nm -= k[0] * (-(fall * fall)).exp() * (w / k[2]).tanh();
        }
    }
}

/// A peak that falls with velocity in another way: between an exponential and a rational function (Hess and Soom).
struct AnyFall;

/// The least `q` that is told from 0: there the exponential is met within 1e-6.
const LEAST_TAIL: f64 = 1e-6;

impl Law for AnyFall {
    const HEADER: Header = Header {
        equation: "M -= k*(1 + q*(abs(w)/w_v)^delta)^(-1/q)*tanh(w/w_s); q = 0: k*exp(-(abs(w)/w_v)^delta)*tanh(w/w_s)",
        validity: "mixed lubrication; the static level is smoothed over w_s, so the lever creeps where it would stick; the power of abs(w) smoothed over 1e-4 of w_v",
        parameters: &[
            StribeckFriction::HEADER.parameters[0],
            StribeckFriction::HEADER.parameters[1],
            StribeckFriction::HEADER.parameters[2],
            Parameter { name: "delta", unit: "1", lower: 0.4, upper: 4.0, typical: 1.0, size: false },
            Parameter { name: "q", unit: "1", lower: 0.0, upper: 2.0, typical: 0.5, size: false },
        ],
        literature: "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994); Hess, Soom, Friction at a lubricated line contact, J. Tribology 112 (1990)",
        starts: &[&[0.1, 0.2, 0.02, 1.0, 0.0], &[0.3, 0.3, 0.02, 2.0, 1.0]],
        ..StribeckFriction::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let w = m.velocity_rad_s;
            let fall = w / k[1];
            // the power has a slope at rest as well
            let fallen = (fall * fall + 1e-8).powf(k[3] * 0.5);
            let tail = k[4] + LEAST_TAIL;
            m.torque_nm -= k[0] * (-((tail * fallen + 1.0).ln() / tail)).exp() * (w / k[2]).tanh();
        }
    }
}
