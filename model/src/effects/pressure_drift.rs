//! A pressure sensor whose zero is off, constantly or more and more since it was switched on.

use super::{Balance, Header, Law, Parameter, Refined};
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
        equation: "p_i shown = p_i + offset_i + drift_i*(1 - exp(-t/tau)), sensor i = 1, 2 with offset1, drift1, offset2, drift2, and one tau",
        validity: "t since the run's start",
        measure: "read both sensors at rest, the chambers vented to ambient or beside a reference gauge, at switch-on and after some minutes",
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

    const REFINED: Option<Refined> =
        Some(Refined { effect: &GoingOn, neutral: &[0.0], starts: &[&[1.0], &[0.3]], away: &[], screened: &[] });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        shift(k, port, |time| settled(time));
    }
}

/// A zero that goes on drifting instead of settling.
struct GoingOn;

impl Law for GoingOn {
    const HEADER: Header = Header {
        equation: "p_i shown = p_i + offset_i + drift_i*((1 - s)*(1 - exp(-t/tau)) + s*t/tau), sensor i = 1, 2 with offset1, drift1, offset2, drift2, and one tau and s",
        validity: "t since the run's start; s = 0 settles, 1 drifts steadily",
        parameters: &[
            PressureDrift::HEADER.parameters[0],
            PressureDrift::HEADER.parameters[1],
            PressureDrift::HEADER.parameters[2],
            PressureDrift::HEADER.parameters[3],
            PressureDrift::HEADER.parameters[4],
            Parameter { name: "s", unit: "1", lower: 0.0, upper: 1.0, typical: 0.3, size: false },
        ],
        starts: &[&[0.0, 0.05, 0.0, 0.0, 60.0, 1.0], &[0.0, 0.0, 0.0, 0.05, 60.0, 1.0]],
        ..PressureDrift::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        shift(k, port, |time| settled(time) + k[5] * (time - settled(time)));
    }
}

/// How far a zero has settled after so many time constants.
fn settled<S: Scalar>(time: S) -> S {
    -(-time).exp() + 1.0
}

/// Shifts both zeros by their constant part and by how far their drift has `grown` after so many time constants.
fn shift<S: Scalar>(k: &[S], port: &mut Port<'_, S>, grown: impl Fn(S) -> S) {
    if let Port::Sensor(s) = port {
        let grown = grown(S::constant(s.time_s) / k[4]);
        s.pressure_bar[0] += k[0] + k[1] * grown;
        s.pressure_bar[1] += k[2] + k[3] * grown;
    }
}
