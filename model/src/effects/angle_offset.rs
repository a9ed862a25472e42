//! An encoder whose zero is off.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct AngleOffset;

impl Law for AngleOffset {
    const HEADER: Header = Header {
        id: "angle_offset",
        balance: Balance::Sensor,
        ports: &[PortKind::Sensor],
        summary: "the encoder's zero is off",
        equation: "phi_shown = phi + o",
        validity: "any angle",
        measure: "bring the lever to rest hanging down with the bypass open and read the encoder",
        literature: "Webster, The Measurement, Instrumentation and Sensors Handbook, ch. 6",
        parameters: &[Parameter { name: "o", unit: "deg", lower: -20.0, upper: 20.0, typical: 0.2, size: true }],
        states: 0,
        starts: &[&[0.1], &[-0.1], &[2.0], &[-2.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            s.angle_deg += k[0];
        }
    }
}
