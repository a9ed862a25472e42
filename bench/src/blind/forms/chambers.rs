//! Other forms of what the chambers do.

use model::effects::{Balance, Header, Law};
use model::port::{AMBIENT_BAR, Port, PortKind};
use model::scalar::Scalar;

use super::{header, shape, size};

/// Walls of cord that stretch until the cord is straight: the displacement grows ever less with pressure.
pub(super) struct DisplacementStraightens;

impl Law for DisplacementStraightens {
    const HEADER: Header = header(
        "displacement_straightens",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "C_v1 += e*g1/(1 + g1/w), C_v2 -= e*g2/(1 + g2/w), g the gauge pressure, none below ambient",
        &[size("e", "ml/(rad bar)", 8.0, 0.5), shape("w", "bar", 0.5, 20.0, 3.0)],
        0,
        &[&[0.3, 2.0], &[2.0, 4.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, sign) in [1.0, -1.0].into_iter().enumerate() {
                let gauge_bar = (h.pressure_bar[i] - AMBIENT_BAR).at_least(0.0);
                h.displacement_ml_rad[i] += k[0] * gauge_bar / (gauge_bar / k[1] + 1.0) * sign;
            }
        }
    }
}
