//! Inertia of the oil in the line between pump and chambers, which the paper's sec. 5 suspects behind its oscillations.

use super::lag::{SHORTEST_S, first_order};
use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// The pump sees dp + I*q'. Its flow falls by `slip` per bar, so q = Q - slip*I*q': the line's flow follows with the time
/// constant I*slip, which changes with voltage and valves.
pub struct LineInertance;

impl Law for LineInertance {
    const HEADER: Header = Header {
        id: "line_inertance",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "the oil in the line between pump and chambers has inertia",
        equation: "I*slip*q' = Q - q, slip = -dQ/d(dp); q goes into the chambers; q = 0 where brake and bypass are closed",
        validity: "incompressible oil in a short line; a closing valve stops it at once",
        measure: "reverse the voltage with the lever clamped and watch the pressures at 1 kHz or more",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 3 (transients in conduits); paper, sec. 5",
        parameters: &[Parameter { name: "I", unit: "bar s2/ml", lower: 0.0, upper: 3.0, typical: 0.02, size: true }],
        states: 1,
        starts: &[&[0.005], &[0.03], &[0.1], &[0.4]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            if l.open {
                (dx[0], l.flow_ml_s) = first_order(k[0] * l.slip_ml_s_bar, l.flow_ml_s, x[0]);
            } else {
                dx[0] = -x[0] / SHORTEST_S;
            }
        }
    }
}
