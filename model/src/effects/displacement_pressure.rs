//! Displacement that depends on pressure, which the paper measured and left out of eq. (14).

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{HydraulicPort, Port, PortKind};
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
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Saturating,
        neutral: &[0.0, MIDDLE_BAR],
        starts: &[&[0.3, MIDDLE_BAR], &[0.6, 1.5], &[0.6, 4.0]],
        away: &[],
        screened: &[],
    });
    const CLOSES_VOLUME: bool = true;

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            grow(k, h, |pressure_bar| pressure_bar - MIDDLE_BAR);
        }
    }
}

/// A wall that stretches less and less: the displacement stops growing beyond a pressure.
struct Saturating;

impl Law for Saturating {
    const HEADER: Header = Header {
        equation: "as the library's form, with (tanh(q*(p - m)) + tanh(q*(m - 2.5 bar)))/q for p - 2.5 bar beside the closing term",
        validity: "q = 0 grows in proportion to pressure, whatever m; beside the closing term it grows most at m and hardly any more at 2/q from there; as the library's form otherwise",
        parameters: &[
            DisplacementPressure::HEADER.parameters[0],
            DisplacementPressure::HEADER.parameters[1],
            DisplacementPressure::HEADER.parameters[2],
            Parameter { name: "q", unit: "1/bar", lower: 0.0, upper: 3.0, typical: 0.5, size: false },
            Parameter { name: "m", unit: "bar", lower: 0.5, upper: 8.0, typical: MIDDLE_BAR, size: false },
        ],
        starts: &[&[0.0, 0.5, 0.0, 0.5, MIDDLE_BAR], &[0.0, -0.5, 0.0, 0.5, MIDDLE_BAR]],
        ..DisplacementPressure::HEADER
    };
    const CLOSES_VOLUME: bool = true;

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            grow(k, h, |pressure_bar| {
                let (steep, middle) = (k[3], k[4]);
                stretched(pressure_bar - middle, steep) + stretched(middle - MIDDLE_BAR, steep)
            });
        }
    }
}

/// Adds the closing term and what grows with `over_bar` of either chamber's pressure.
fn grow<S: Scalar>(k: &[S], h: &mut HydraulicPort<S>, over_bar: impl Fn(S) -> S) {
    let [closure, slope, bend] = [k[0], k[1], k[2] * h.angle_rad];
    for (i, per_bar) in [bend + slope, bend - slope].into_iter().enumerate() {
        h.displacement_ml_rad[i] += closure * h.stored_slope_ml_rad[i] + per_bar * over_bar(h.pressure_bar[i]);
    }
}

/// `tanh(q*x)/q`, which is x where q is 0.
fn stretched<S: Scalar>(x: S, q: S) -> S {
    let product = q * x;
    if product.value().abs() < 1e-2 {
        // both sides of the quotient vanish: its series, to 1e-13
        let square = product * product;
        x * (square * (square * (2.0 / 15.0) - 1.0 / 3.0) + 1.0)
    } else {
        product.tanh() / q
    }
}
