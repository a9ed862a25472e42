//! Displacement that depends on pressure, which the paper measured and left out of eq. (14).

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// With closure = 1 and no slopes, C_h dp + C_v dphi is an exact differential, so that a closed cycle returns to its start.
pub struct DisplacementPressure;

/// Middle pressure, to which eq. (14) belongs, bar absolute.
const MIDDLE_BAR: f64 = crate::rec::STORED_FROM_BAR;

impl Law for DisplacementPressure {
    const HEADER: Header = Header {
        id: "displacement_pressure",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "the displacement depends on pressure",
        equation: "C_v1 += closure*S_1 + (slope + bend*phi)*(p1 - 2.5 bar), C_v2 += closure*S_2 + (-slope + bend*phi)*(p2 - 2.5 bar); S_i: d/dphi of the integral of C_hi over pressure from 2.5 bar, which closes eq. (13)",
        validity: "linear in pressure beside the closing term; V2(phi) = V1(-phi); slope and bend alone do not close the volume, so that a cycle of pressure and angle keeps or makes oil; 2.5 bar, where eq. (14) is taken to hold, is a choice",
        measure: "volume map: slope of the volume over the angle at several pressures",
        literature: "paper, eq. (14), v_1i and v_2i at p_i = 1..6 bar",
        parameters: &[
            Parameter { name: "closure", unit: "1", lower: -5.0, upper: 8.0, typical: 0.2, size: true },
            Parameter { name: "slope", unit: "ml/(rad bar)", lower: -8.0, upper: 8.0, typical: 0.5, size: true },
            Parameter { name: "bend", unit: "ml/(rad2 bar)", lower: -10.0, upper: 10.0, typical: 0.5, size: true },
        ],
        states: 0,
        starts: &[
            &[0.1, 0.0, 0.0],
            &[1.0, 0.0, 0.0],
            &[0.0, 0.1, 0.0],
            &[0.0, -0.1, 0.0],
            &[0.0, 2.0, 0.0],
            &[0.0, -2.0, 0.0],
        ],
        passive: false,
    };
    const CLOSES_VOLUME: bool = true;

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            let [closure, slope, bend] = [k[0], k[1], k[2] * h.angle_rad];
            for (i, per_bar) in [bend + slope, bend - slope].into_iter().enumerate() {
                h.displacement_ml_rad[i] +=
                    closure * h.stored_slope_ml_rad[i] + per_bar * (h.pressure_bar[i] - MIDDLE_BAR);
            }
        }
    }
}
