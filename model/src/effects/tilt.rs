//! A plane that was called horizontal and is not.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct Tilt;

impl Law for Tilt {
    const HEADER: Header = Header {
        id: "tilt",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "gravity acts in the runs called horizontal, as from a tilted plane",
        equation: "M -= s*sin(phi) + c*cos(phi) where the plane is called horizontal; amplitude sqrt(s^2 + c^2), direction atan2(c, s)",
        validity: "rigid lever; amplitude far below the gravity torque of the vertical plane",
        measure: "clamp the lever at several angles with the bypass open and read the force sensor, and once more with the plane turned by 180 degrees, or compare with the vertical plane",
        literature: "Meriam, Kraige, Engineering Mechanics: Statics, 2012, ch. 3 (equilibrium of a rigid body)",
        parameters: &[
            Parameter { name: "s", unit: "Nm", lower: -5.0, upper: 5.0, typical: 0.1, size: true },
            Parameter { name: "c", unit: "Nm", lower: -5.0, upper: 5.0, typical: 0.1, size: true },
        ],
        states: 0,
        starts: &[&[0.05, 0.0], &[0.0, 0.05], &[0.5, 0.5]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port
            && !m.vertical
        {
            m.torque_nm -= k[0] * m.angle_rad.sin() + k[1] * m.angle_rad.cos();
        }
    }
}
