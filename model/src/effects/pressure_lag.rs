//! Pressure sensors that are slow.

use super::lag::{first_order, second_order};
use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct PressureLag;

impl Law for PressureLag {
    const HEADER: Header = Header {
        id: "pressure_lag",
        balance: Balance::Sensor,
        ports: &[PortKind::Sensor],
        summary: "a pressure sensor is slow",
        equation: "tau_i*y_i' = p_i - y_i; sensor i = 1, 2 shows y_i",
        validity: "first order: filter of the amplifier, or oil in a thin connecting bore; time constants below 1 ms are blended into none",
        measure: "open the bypass under load and compare both sensors' decays with a fast one",
        literature: "Doebelin, Measurement Systems, 2003, ch. 3 and 6",
        parameters: &[
            Parameter { name: "tau1", unit: "s", lower: 0.0, upper: 2.0, typical: 0.01, size: true },
            Parameter { name: "tau2", unit: "s", lower: 0.0, upper: 2.0, typical: 0.01, size: true },
        ],
        states: 2,
        starts: &[&[0.005, 0.0], &[0.0, 0.005], &[0.005, 0.005], &[0.05, 0.0], &[0.0, 0.05], &[0.2, 0.2]],
        passive: false,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &SecondOrder,
        neutral: &[0.0, 0.0],
        starts: &[&[0.2, 0.0], &[0.5, 0.0], &[0.05, 0.5]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            for i in 0..2 {
                (dx[i], s.pressure_bar[i]) = first_order(k[i], s.pressure_bar[i], x[i]);
            }
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x.copy_from_slice(&rest.pressure_bar);
    }
}

/// A sensor that has a mass, or oil in its bore, to move: it swings, or is slow twice. Or one that shows a part of the pressure at once and the rest late, as where
/// its membrane creeps: two lags side by side are two in a row with a zero.
struct SecondOrder;

impl Law for SecondOrder {
    const HEADER: Header = Header {
        equation: "z*tau_i^2*y_i'' + tau_i*y_i' + y_i = p_i; sensor i = 1, 2 shows y_i + c*tau_i*y_i'",
        validity: "second order, alike in both sensors: two equal lags in a row at z = 0.25, damping 1/(2*sqrt(z)); side by side, shares b and 1-b of lags T1 and T2: tau = T1+T2, z = T1*T2/tau^2, c = (b*T2 + (1-b)*T1)/tau",
        parameters: &[
            PressureLag::HEADER.parameters[0],
            PressureLag::HEADER.parameters[1],
            Parameter { name: "z", unit: "1", lower: 0.0, upper: 2.0, typical: 0.25, size: false },
            Parameter { name: "c", unit: "1", lower: 0.0, upper: 1.0, typical: 0.5, size: false },
        ],
        states: 4,
        starts: &[
            &[0.03, 0.0, 0.25, 0.0],
            &[0.0, 0.03, 0.25, 0.0],
            &[0.03, 0.03, 0.5, 0.0],
            &[0.2, 0.0, 0.05, 0.5],
            &[0.0, 0.2, 0.05, 0.5],
        ],
        ..PressureLag::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            for i in 0..2 {
                let (rates, shown) = second_order(k[i], k[i] * k[2], s.pressure_bar[i], [x[i], x[2 + i]]);
                (dx[i], dx[2 + i]) = (rates[0], rates[1]);
                s.pressure_bar[i] = shown + k[3] * rates[0] * k[i];
            }
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[..2].copy_from_slice(&rest.pressure_bar);
        x[2..].fill(S::zero());
    }
}
