//! Oil that passes the valve block from one chamber to the other.

use super::gap::{beyond_cracking, through_a_gap};
use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct CrossLeakage;

impl Law for CrossLeakage {
    const HEADER: Header = Header {
        id: "cross_leakage",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "oil leaks between the chambers through an orifice in the valve block",
        equation: "q = k*dp/(dp^2 + d^2)^(1/4) from chamber 1 to chamber 2, also with the brake closed; none where the chambers are shut off one by one",
        validity: "turbulent orifice; laminar within the transition pressure d, all laminar where d is beyond the range",
        measure: "close the brake under load and watch the pressure difference decay",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 3 (orifice flow)",
        parameters: &[
            Parameter { name: "k", unit: "ml/(s sqrt(bar))", lower: 0.0, upper: 20.0, typical: 0.1, size: true },
            Parameter { name: "d", unit: "bar", lower: 1e-3, upper: 20.0, typical: 0.02, size: false },
        ],
        states: 0,
        starts: &[&[0.03, 0.02], &[0.5, 0.02], &[3.0, 0.1], &[0.3, 5.0]],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &AnyPower,
        neutral: &[0.5, 2.0, 0.0],
        starts: &[&[0.7, 2.0, 0.0], &[0.5, 0.7, 0.0], &[1.0, 2.0, 0.5]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port
            && !h.shut_off
        {
            let dp = h.pressure_bar[0] - h.pressure_bar[1];
            let leak = k[0] * dp / (dp * dp + k[1] * k[1]).sqrt().sqrt();
            h.flow_ml_s[0] -= leak;
            h.flow_ml_s[1] += leak;
        }
    }
}

/// A gap between a laminar and a turbulent one, which may open at a pressure difference only.
struct AnyPower;

impl Law for AnyPower {
    const HEADER: Header = Header {
        equation: "q = k*g*(abs(g)^s + d^s)^((m - 1)/s), g = dp less p_c, 0 within p_c, from chamber 1 to chamber 2, also with the brake closed; none where the chambers are shut off one by one",
        validity: "a gap of any kind: m = 0.5 turbulent, 1 laminar; laminar within the transition pressure d, which is passed the more gradually the smaller s is (a gap with an orifice behind it: some 0.7); p_c: the pressure difference that opens it, 0 where it is always open, its corner rounded over 0.05 bar; abs(g) smoothed over 1e-4 bar",
        parameters: &[
            Parameter { unit: "ml/(s bar^m)", ..CrossLeakage::HEADER.parameters[0] },
            CrossLeakage::HEADER.parameters[1],
            Parameter { name: "m", unit: "1", lower: 0.4, upper: 1.1, typical: 0.7, size: false },
            Parameter { name: "s", unit: "1", lower: 0.3, upper: 4.0, typical: 2.0, size: false },
            Parameter { name: "p_c", unit: "bar", lower: 0.0, upper: 20.0, typical: 0.5, size: false },
        ],
        starts: &[&[0.03, 0.02, 0.7, 2.0, 0.0], &[0.3, 0.1, 0.5, 0.7, 0.0]],
        ..CrossLeakage::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port
            && !h.shut_off
        {
            let dp = h.pressure_bar[0] - h.pressure_bar[1];
            let leak = k[0] * through_a_gap(beyond_cracking(dp, k[4]), k[2], k[1], k[3]);
            h.flow_ml_s[0] -= leak;
            h.flow_ml_s[1] += leak;
        }
    }
}
