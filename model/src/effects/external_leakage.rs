//! Oil that leaves a chamber to the outside, against the paper's assumption 3.

use super::gap::{beyond_cracking, through_a_gap};
use super::{Balance, Header, Law, Parameter, Refined};
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
        validity: "laminar gap; meant above ambient: oil that has left does not come back",
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
    const REFINED: Option<Refined> = Some(Refined {
        effect: &AnyPower,
        neutral: &[1.0, 0.01, 2.0, 0.0],
        starts: &[&[0.6, 0.01, 2.0, 0.0], &[0.5, 0.3, 1.0, 0.0], &[1.0, 0.01, 2.0, 1.0]],
        away: &[(&[3.0, 3.0], &[1.0, 0.01, 2.0, 1.5]), (&[10.0, 10.0], &[1.0, 0.01, 2.0, 2.5])],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, k) in k.iter().enumerate() {
                h.flow_ml_s[i] -= *k * (h.pressure_bar[i] - AMBIENT_BAR);
            }
        }
    }
}

/// A gap that is laminar, turbulent, or the one at a low pressure and the other at a high one, and may open at a pressure only.
struct AnyPower;

impl Law for AnyPower {
    const HEADER: Header = Header {
        equation: "q_i = k_i*g*(abs(g)^s + d^s)^((m - 1)/s), g = p_i - p_amb less p_c, 0 within p_c, out of chamber i = 1, 2, also where it is shut off",
        validity: "a gap of any kind: m = 0.5 turbulent, 1 laminar; laminar within the transition pressure d, which is passed the more gradually the smaller s is (a gap with an orifice behind it: some 0.7); p_c: the pressure that lifts a lip, 0 of a gap that is always open, its corner rounded over 0.05 bar; abs(g) smoothed over 1e-4 bar; meant above ambient: oil that has left does not come back",
        parameters: &[
            Parameter { unit: "ml/(s bar^m)", ..ExternalLeakage::HEADER.parameters[0] },
            Parameter { unit: "ml/(s bar^m)", ..ExternalLeakage::HEADER.parameters[1] },
            Parameter { name: "m", unit: "1", lower: 0.4, upper: 1.2, typical: 0.5, size: false },
            Parameter { name: "d", unit: "bar", lower: 1e-3, upper: 20.0, typical: 0.1, size: false },
            Parameter { name: "s", unit: "1", lower: 0.3, upper: 4.0, typical: 1.0, size: false },
            Parameter { name: "p_c", unit: "bar", lower: 0.0, upper: 20.0, typical: 1.0, size: false },
        ],
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 6 (leakage of actuators to their drain); Mueller, Nau, Fluid Sealing Technology, 1998 (lips that lift at a pressure)",
        starts: &[&[0.002, 0.002, 0.6, 0.01, 2.0, 0.0]],
        ..ExternalLeakage::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for i in 0..2 {
                let gauge = h.pressure_bar[i] - AMBIENT_BAR;
                h.flow_ml_s[i] -= k[i] * through_a_gap(beyond_cracking(gauge, k[5]), k[2], k[3], k[4]);
            }
        }
    }

    /// No gap passes more than a laminar one: what grows faster, so that its fit ends at the bound of the power or just within it, opens as it passes oil, as a
    /// valve does.
    fn is_itself(&self, k: &[f64]) -> bool {
        k[2] < Self::HEADER.parameters[2].upper - WITHIN
    }
}

/// How near to its bound the power stands at it.
const WITHIN: f64 = 0.02;
