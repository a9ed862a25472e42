//! A pressure sensor whose zero is off, constantly or more and more since it was switched on.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct PressureDrift;

impl Law for PressureDrift {
    const HEADER: Header = Header {
        id: "pressure_drift",
        balance: Balance::Sensor,
        ports: &[PortKind::Sensor],
        summary: "the zero of a pressure sensor is off, constantly or drifting since switch-on",
        equation: "p_shown = p + o + d*(1 - exp(-t/tau)) for each sensor: o1, d1, o2, d2, one tau",
        validity: "t since the run's start",
        measure: "read both sensors at rest with the bypass open, at switch-on and after some minutes",
        literature: "Webster, The Measurement, Instrumentation and Sensors Handbook, ch. 26",
        parameters: &[
            Parameter { name: "offset1", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.05, size: true },
            Parameter { name: "drift1", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.05, size: true },
            Parameter { name: "offset2", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.05, size: true },
            Parameter { name: "drift2", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.05, size: true },
            Parameter { name: "tau", unit: "s", lower: 2.0, upper: 600.0, typical: 40.0, size: false },
        ],
        states: 0,
        starts: &[
            &[0.05, 0.0, 0.0, 0.0, 40.0],
            &[0.0, 0.05, 0.0, 0.0, 40.0],
            &[0.0, 0.0, 0.05, 0.0, 40.0],
            &[0.0, 0.0, 0.0, 0.05, 40.0],
        ],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            let grown = -(S::constant(-s.time_s) / k[4]).exp() + 1.0;
            s.pressure_bar[0] += k[0] + k[1] * grown;
            s.pressure_bar[1] += k[2] + k[3] * grown;
        }
    }
}
