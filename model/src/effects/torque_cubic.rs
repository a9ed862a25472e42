//! The cubic part of the chambers' torque, eq. (1) of the paper, which its eq. (2) drops.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct TorqueCubic;

impl Law for TorqueCubic {
    const HEADER: Header = Header {
        id: "torque_cubic",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "the torque characteristic has the third-order terms of eq. (1), which eq. (2) drops",
        equation: "M += c1*phi^3 + c2*abs(dp)*phi^3 + c3*dp*phi^2, odd in (phi, dp) as eq. (2) is",
        validity: "at one amount of oil, where p1 + p2 is a function of abs(dp); identical chambers; the coefficients of eq. (1) linear in pressure",
        measure: "torque map with the lever clamped beyond 30 degrees at middle pressures",
        literature: "paper, eq. (1) and the remark on the approximation error below eq. (2)",
        parameters: &[
            Parameter { name: "c1", unit: "Nm/rad3", lower: -60.0, upper: 60.0, typical: 1.0, size: true },
            Parameter { name: "c2", unit: "Nm/(bar rad3)", lower: -30.0, upper: 30.0, typical: 0.5, size: true },
            Parameter { name: "c3", unit: "Nm/(bar rad2)", lower: -30.0, upper: 30.0, typical: 0.5, size: true },
        ],
        states: 0,
        starts: &[&[0.3, 0.0, 0.0], &[-0.3, 0.0, 0.0], &[0.0, 0.3, 0.0], &[0.0, 0.0, 0.3], &[-5.0, -1.0, 1.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let (phi, dp) = (m.angle_rad, m.dp_bar);
            m.torque_nm += phi * phi * ((k[0] + k[1] * dp.abs()) * phi + k[2] * dp);
        }
    }
}
