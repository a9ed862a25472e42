//! A constant force: an offset of the drive, a preload, a weight.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct ForceOffset;

impl Law for ForceOffset {
    const HEADER: Header = Header {
        id: "force_offset",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "a constant force acts on the body",
        equation: "M += c, a constant",
        validity: "the force does not change with place, speed or time",
        measure: "rest the body at several places without drive, or compare slow strokes in both directions",
        literature: "Janot, Gautier, Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System Identification Benchmarks (2019)",
        parameters: &[Parameter { name: "c", unit: "Nm", lower: -1e6, upper: 1e6, typical: 1.0, size: true }],
        states: 0,
        starts: &[&[0.001], &[0.1], &[10.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm += k[0];
        }
    }
}
