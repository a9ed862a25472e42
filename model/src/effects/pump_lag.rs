//! The pump's own dynamics, eq. (9) of the paper, which its final model neglects.

use super::lag::{dead_time, first_order};
use super::{Balance, Header, Law, Parameter, Refined};
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
        validity: "motor inertia against an amplifier without speed control: the paper estimates 5..10 ms; time constants below 1 ms are blended into none",
        measure: "step the voltage with the lever clamped and watch the rise of the pressure difference",
        literature: "paper, eq. (9) and the estimate of T_p below eq. (10)",
        parameters: &[Parameter { name: "tau", unit: "s", lower: 0.0, upper: 0.5, typical: 0.005, size: true }],
        states: 1,
        starts: &[&[0.004], &[0.02], &[0.08]],
        passive: false,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Ramped,
        neutral: &[0.0, 0.0],
        starts: &[&[0.2, 0.01], &[0.8, 0.01], &[0.2, 0.2]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            (dx[0], a.voltage_v) = first_order(k[0], a.voltage_v, x[0]);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = S::constant(rest.voltage_v);
    }
}

/// What an amplifier adds: it acts on a command some time after it, and its ramp or current limit makes a large change take longer. Two lags in a row are
/// nearly a lag and a dead time.
struct Ramped;

impl Law for Ramped {
    const HEADER: Header = Header {
        equation: "(1-d)*tau*(1 + r*|v - u_p|)*u_p' = v - u_p, v(t) = u(t - d*tau) to third order in s*d*tau (Pade 1/2): where r is large u_p moves by 1/((1-d)*tau*r) at most; eq. (10) takes u_p",
        validity: "dead time short against what is commanded; a ramp alike up and down",
        literature: "paper, eq. (9); Astrom, Hagglund, Advanced PID Control, 2006, ch. 2 (first order with dead time)",
        parameters: &[
            PumpLag::HEADER.parameters[0],
            Parameter { name: "d", unit: "1", lower: 0.0, upper: 1.0, typical: 0.5, size: false },
            Parameter { name: "r", unit: "1/V", lower: 0.0, upper: 20.0, typical: 0.2, size: false },
        ],
        states: 3,
        starts: &[&[6e-3, 0.8, 0.01], &[5e-3, 0.2, 0.3], &[0.025, 0.7, 0.01], &[0.02, 0.3, 0.3]],
        ..PumpLag::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            let dead_s = k[0] * k[1];
            let (rates, late) = dead_time(dead_s, a.voltage_v, [x[1], x[2]]);
            dx[1..3].copy_from_slice(&rates);
            let slower = S::constant(1.0) + k[2] * (late - x[0]).abs();
            (dx[0], a.voltage_v) = first_order((k[0] - dead_s) * slower, late, x[0]);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = S::constant(rest.voltage_v);
        x[1] = x[0];
        x[2] = S::constant(0.0);
    }
}
