//! Viscoelastic chamber walls: part of the capacity answers with a delay.

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{AMBIENT_BAR, Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// Passive: the branch stores x^2/(2 C_c) and loses tau*x'^2/C_c. It returns all its oil when the pressure returns.
pub struct WallCreep;

impl Law for WallCreep {
    const HEADER: Header = Header {
        id: "wall_creep",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "the chamber walls creep: part of the capacity answers with a delay",
        equation: "tau*x_i' = C_c*(p_i - p_amb) - x_i takes x_i' out of chamber i = 1, 2 (Kelvin-Voigt branch); at rest x_i = C_c*(p_i - p_amb)",
        validity: "linear viscoelasticity with one time constant; the same wall in both chambers",
        measure: "clamp the lever, step the pressure, shut the chambers off and watch the pressures settle",
        literature: "Lakes, Viscoelastic Materials, 2009, ch. 2",
        parameters: &[
            Parameter { name: "C_c", unit: "ml/bar", lower: 0.0, upper: 30.0, typical: 0.3, size: true },
            Parameter { name: "tau", unit: "s", lower: 0.05, upper: 30.0, typical: 1.0, size: false },
        ],
        states: 2,
        starts: &[&[0.1, 0.2], &[0.1, 1.0], &[0.1, 5.0], &[2.0, 0.3], &[2.0, 1.0], &[2.0, 4.0]],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &TwoBranches,
        neutral: &[0.0, 5.0],
        starts: &[&[0.5, 5.0], &[0.5, 0.2]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for i in 0..2 {
                let rate = (k[0] * (h.pressure_bar[i] - AMBIENT_BAR) - x[i]) / k[1];
                dx[i] = rate;
                h.flow_ml_s[i] -= rate;
            }
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for (chamber, x) in x.iter_mut().enumerate() {
            *x = k[0] * rest.gauge_bar(chamber);
        }
    }
}

/// A wall with two time constants.
struct TwoBranches;

/// Least time constant of the second branch, s: the integrator's shortest step stands no faster one of the largest capacity.
const LEAST_S: f64 = 0.01;

impl Law for TwoBranches {
    const HEADER: Header = Header {
        equation: "two Kelvin-Voigt branches: C_c and tau as in the plain form, C_c*share and tau*ratio but 10 ms at least; at rest x_ij = C_j*(p_i - p_amb)",
        validity: "linear viscoelasticity with two time constants; the same wall in both chambers",
        parameters: &[
            WallCreep::HEADER.parameters[0],
            WallCreep::HEADER.parameters[1],
            Parameter { name: "share", unit: "1", lower: 0.0, upper: 10.0, typical: 0.5, size: false },
            Parameter { name: "ratio", unit: "1", lower: 0.02, upper: 50.0, typical: 5.0, size: false },
        ],
        states: 4,
        starts: &[&[0.1, 1.0, 0.5, 5.0]],
        ..WallCreep::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (branch, capacity, tau) in [(0, k[0], k[1]), (1, k[0] * k[2], (k[1] * k[3]).at_least(LEAST_S))] {
                for i in 0..2 {
                    let n = 2 * branch + i;
                    let rate = (capacity * (h.pressure_bar[i] - AMBIENT_BAR) - x[n]) / tau;
                    dx[n] = rate;
                    h.flow_ml_s[i] -= rate;
                }
            }
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for (n, x) in x.iter_mut().enumerate() {
            let capacity = if n < 2 { k[0] } else { k[0] * k[2] };
            *x = capacity * rest.gauge_bar(n % 2);
        }
    }
}
