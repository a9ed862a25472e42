//! Chambers that are not identical, against the paper's assumption 3.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// Chamber 1 keeps the reference model, since volume map and clamp steps measure chamber 1 alone: the reference
/// parameters are those of chamber 1, and this effect says how chamber 2 differs.
pub struct ChamberAsymmetry;

impl Law for ChamberAsymmetry {
    const HEADER: Header = Header {
        id: "chamber_asymmetry",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "chamber 2 differs from chamber 1 in capacity or displacement",
        equation: "C_h2 = (1 + c)*C_h1 mirrored, C_v2 = (1 + d)*C_v1 mirrored; chamber 1 as in the reference model",
        validity: "same shape of both characteristics, another scale; beside displacement_pressure that is scaled too, the air of trapped_air is not; the torque characteristic stays odd, so that d breaks virtual work by 0.1*d*C_v2*p2 Nm: the torque map of such a rig would not be odd by this, and a torque residual of that size is no second effect",
        measure: "clamp steps and volume map once more, with chamber 2",
        literature: "paper, sec. 3.2, assumption 3, and eqs. (13), (14)",
        parameters: &[
            Parameter { name: "c", unit: "1", lower: -0.8, upper: 4.0, typical: 0.05, size: true },
            Parameter { name: "d", unit: "1", lower: -0.8, upper: 4.0, typical: 0.02, size: true },
        ],
        states: 0,
        starts: &[&[0.02, 0.0], &[-0.02, 0.0], &[0.0, 0.01], &[0.0, -0.01], &[0.3, 0.0], &[0.0, 0.1]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            let (c, d) = (h.capacity_ml_bar[1], h.displacement_ml_rad[1]);
            h.capacity_ml_bar[1] += k[0] * c;
            h.displacement_ml_rad[1] += k[1] * d;
        }
    }
}
