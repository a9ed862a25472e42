//! Air pockets in the chambers, which the paper calls impossible to avoid.

use super::{Balance, Header, Law, Parameter};
use crate::port::{AMBIENT_BAR, Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct TrappedAir;

impl Law for TrappedAir {
    const HEADER: Header = Header {
        id: "trapped_air",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "air pockets add capacity at low pressure",
        equation: "C_hi += V_ai*p_amb/p_i^2: isothermal air of volume V_ai at ambient pressure in chamber i = 1, 2",
        validity: "isothermal, no air goes into solution",
        measure: "clamp steps of both chambers down to ambient pressure",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 2 (bulk modulus with entrapped air); paper, sec. 3.2",
        parameters: &[
            Parameter { name: "V_a1", unit: "ml", lower: 0.0, upper: 60.0, typical: 0.5, size: true },
            Parameter { name: "V_a2", unit: "ml", lower: 0.0, upper: 60.0, typical: 0.5, size: true },
        ],
        states: 0,
        starts: &[&[0.2, 0.0], &[0.0, 0.2], &[0.2, 0.2], &[4.0, 0.5], &[0.5, 4.0]],
        passive: true,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, volume) in k.iter().enumerate() {
                let p = h.pressure_bar[i];
                h.capacity_ml_bar[i] += *volume * AMBIENT_BAR / (p * p);
            }
        }
    }
}
