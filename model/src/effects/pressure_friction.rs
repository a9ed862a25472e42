//! Friction that grows with the pressures, as the paper expects at the end of its sec. 4.4.

use super::{Balance, Header, Law, Parameter, Refined};
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
        equation: "M -= k*max(0, p1 + p2 - 2*p_amb)*tanh(w/w_s)",
        validity: "sliding; the Coulomb level is smoothed over w_s; chambers that together pull instead of press load nothing",
        measure: "constant-flow strokes at several fill pressures",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 4 (friction torque of a motor, sgn(w)*C_f*D_m*(P1 + P2)); paper, sec. 4.4",
        parameters: &[
            Parameter { name: "k", unit: "Nm/bar", lower: 0.0, upper: 5.0, typical: 0.1, size: true },
            Parameter { name: "w_s", unit: "rad/s", lower: 0.002, upper: 0.2, typical: 0.02, size: false },
        ],
        states: 0,
        starts: &[&[0.03, 0.02], &[0.4, 0.02], &[1.0, 0.05]],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Lubricated,
        neutral: &[1.0, 0.0],
        starts: &[&[1.0, 0.9], &[1.0, 0.4], &[0.6, 0.0]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            // below ambient a friction in proportion would push the lever
            m.torque_nm -= k[0] * m.load_bar.at_least(0.0) * (m.velocity_rad_s / k[1]).tanh();
        }
    }
}

/// Oil between the surfaces, so that a share of the friction grows with speed, and surfaces that bear otherwise than in proportion to the load.
struct Lubricated;

/// Sum of the gauge pressures at which a friction by any power is as large as one in proportion, bar.
const USUAL_LOAD_BAR: f64 = 3.0;

impl Law for Lubricated {
    const HEADER: Header = Header {
        equation: "M -= k*g_0*(g/g_0)^m*((1 - v)*tanh(w/w_s) + v*w/w_0), g = max(0, p1 + p2 - 2*p_amb), g_0 = 3 bar, w_0 = 1 rad/s",
        validity: "v = 1: viscous",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 4; Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, Friction models and friction compensation, Eur. J. Control 4 (1998)",
        parameters: &[
            PressureFriction::HEADER.parameters[0],
            PressureFriction::HEADER.parameters[1],
            Parameter { name: "m", unit: "1", lower: 0.2, upper: 3.0, typical: 1.0, size: false },
            Parameter { name: "v", unit: "1", lower: 0.0, upper: 1.0, typical: 0.4, size: false },
        ],
        starts: &[&[0.2, 0.02, 1.0, 1.0], &[0.1, 0.02, 0.5, 0.0]],
        ..PressureFriction::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            // a power has no slope at 0
            let load = (m.load_bar / USUAL_LOAD_BAR).at_least(1e-6).powf(k[2]) * USUAL_LOAD_BAR;
            let dry = (m.velocity_rad_s / k[1]).tanh();
            m.torque_nm -= k[0] * load * (dry + k[3] * (m.velocity_rad_s - dry));
        }
    }
}
