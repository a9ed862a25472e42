//! The pump's own dynamics, eq. (9) of the paper, which its final model neglects.

use super::lag::first_order;
use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct PumpLag;

impl Law for PumpLag {
    const HEADER: Header = Header {
        id: "pump_lag",
        balance: Balance::Pump,
        ports: &[PortKind::Actuator],
        summary: "the pump follows its voltage with a first-order lag",
        equation: "tau*u_p' = u - u_p; eq. (10) takes u_p",
        validity: "motor inertia against an amplifier without speed control; tau of 5..50 ms",
        measure: "step the voltage with the lever clamped and watch the rise of the pressure difference",
        literature: "paper, eq. (9)",
        parameters: &[Parameter { name: "tau", unit: "s", lower: 0.0, upper: 0.5, typical: 0.005, size: true }],
        states: 1,
        starts: &[&[0.004], &[0.02], &[0.08]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            (dx[0], a.voltage_v) = first_order(k[0], a.voltage_v, x[0]);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = S::constant(rest.voltage_v);
    }
}
