//! Oil that leaves a chamber to the outside, against the paper's assumption 3.

use super::{Balance, Header, Law, Parameter};
use crate::port::{AMBIENT_BAR, Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct ExternalLeakage;

impl Law for ExternalLeakage {
    const HEADER: Header = Header {
        id: "external_leakage",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "oil leaves the chambers to the outside",
        equation: "q_i = k_i*(p_i - p_amb) out of chamber i = 1, 2, also where it is shut off",
        validity: "laminar gap; oil that has left does not come back",
        measure: "shut both chambers off at high pressure and watch each pressure fall over minutes",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 6 (leakage of actuators to their drain)",
        parameters: &[
            Parameter { name: "k1", unit: "ml/(s bar)", lower: 0.0, upper: 2.0, typical: 0.01, size: true },
            Parameter { name: "k2", unit: "ml/(s bar)", lower: 0.0, upper: 2.0, typical: 0.01, size: true },
        ],
        states: 0,
        starts: &[&[0.002, 0.0], &[0.0, 0.002], &[0.002, 0.002], &[0.05, 0.0], &[0.0, 0.05]],
        passive: true,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, k) in k.iter().enumerate() {
                h.flow_ml_s[i] -= *k * (h.pressure_bar[i] - AMBIENT_BAR);
            }
        }
    }
}
