//! A pump that slips more as its oil warms.

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct PumpWarming;

impl Law for PumpWarming {
    const HEADER: Header = Header {
        id: "pump_warming",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "the pump's slip grows as the oil warms with running time",
        equation: "Q -= k*(1 - exp(-t/tau))*dp*opening of the brake valve",
        validity: "t since the run's start; one time constant whatever the load",
        measure: "pump map at one voltage and load, again and again over some minutes",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 4 (slip flow goes as dp/viscosity)",
        parameters: &[
            Parameter { name: "k", unit: "ml/(s bar)", lower: 0.0, upper: 5.0, typical: 0.05, size: true },
            Parameter { name: "tau", unit: "s", lower: 5.0, upper: 600.0, typical: 60.0, size: false },
        ],
        states: 0,
        starts: &[&[0.01, 15.0], &[0.01, 60.0], &[0.03, 250.0], &[0.3, 30.0], &[0.5, 120.0]],
        passive: true,
    };
    const REFINED: Option<Refined> =
        Some(Refined { effect: &OtherPace, neutral: &[0.0], starts: &[&[1.0], &[-0.9]], away: &[] });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let warmed = -(S::constant(-l.time_s) / k[1]).exp() + 1.0;
            l.flow_ml_s -= k[0] * warmed * l.dp_bar() * l.opening;
        }
    }
}

/// A body that warms ever more slowly, with several time constants in a row, or steadily.
struct OtherPace;

impl Law for OtherPace {
    const HEADER: Header = Header {
        equation: "Q -= k*(1 - (1 + s*t/tau)^(-1/s))*dp*opening of the brake valve; all of it where the bracket is below 0",
        validity: "t since the run's start; s = 0 one time constant, 1 a hyperbola, -1 a steady rise for tau",
        parameters: &[
            PumpWarming::HEADER.parameters[0],
            PumpWarming::HEADER.parameters[1],
            Parameter { name: "s", unit: "1", lower: -1.0, upper: 4.0, typical: 1.0, size: false },
        ],
        starts: &[&[0.03, 60.0, 1.0], &[0.1, 300.0, -0.9]],
        ..PumpWarming::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let warmed = -(-slowed(S::constant(l.time_s) / k[1], k[2])).exp() + 1.0;
            l.flow_ml_s -= k[0] * warmed * l.dp_bar() * l.opening;
        }
    }
}

/// `ln(1 + s*x)/s`, which is x where s is 0.
fn slowed<S: Scalar>(x: S, s: S) -> S {
    let product = s * x;
    if product.value().abs() < 1e-3 {
        // both sides of the quotient vanish: its series, to 2e-13
        let series = product * (product * (product * -0.25 + 1.0 / 3.0) - 0.5) + 1.0;
        x * series
    } else {
        (product + 1.0).at_least(1e-9).ln() / s
    }
}
