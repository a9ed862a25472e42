//! A pump that slips more as its oil warms.

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct PumpWarming;

impl Law for PumpWarming {
    const HEADER: Header = Header {
        id: "pump_warming",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "the pump's slip grows as the oil warms",
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
    const REFINED: Option<Refined> = Some(Refined {
        effect: &OtherCourse,
        neutral: &[0.0, 0.0, 0.0],
        starts: &[&[1.0, 0.0, 0.0], &[-0.9, 0.0, 0.0], &[0.0, 0.9, 0.0], &[0.0, 0.9, 0.7]],
        away: &[],
        screened: &[&[0.1, 30.0, 0.0, 1.0, 0.0], &[0.1, 120.0, 0.0, 1.0, 0.0]],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let warmed = -(S::constant(-l.time_s) / k[1]).exp() + 1.0;
            l.flow_ml_s -= k[0] * warmed * l.dp_bar() * l.opening;
        }
    }
}

/// A body that warms ever more slowly, with several time constants in a row, or steadily; or by what the pump does, whose losses grow with the square of its
/// voltage. And oil that thins exponentially, so that the slip grows the faster the warmer it is.
struct OtherCourse;

/// The voltage at which a pump that warms by what it does is in the end as warm as one that warms by running, V.
const WARMING_V: f64 = 12.0;

impl OtherCourse {
    /// In the end, at this voltage.
    fn in_the_end<S: Scalar>(voltage_v: S) -> S {
        let share = voltage_v / WARMING_V;
        share * share
    }
}

impl Law for OtherCourse {
    const HEADER: Header = Header {
        equation: "Q -= k*(exp(c*W) - 1)/c*dp*opening of the brake valve, W = (1-w)*(1 - (1 + s*t/tau)^(-1/s)) + w*x, all of its first bracket where its root's base is below 0; tau*x' = (u/12 V)^2 - x, x = 0 at the run's start",
        validity: "t since the run's start; s = 0 one time constant, 1 a hyperbola, -1 a steady rise for tau; w = 0 warms by running alone, 1 by its losses at u alone; c = 0 slips in proportion to its warmth W",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 4 (slip flow goes as dp/viscosity); copper losses of a motor go as the square of its current; Reynolds, Phil. Trans. R. Soc. 177, 1886 (viscosity falls exponentially with temperature)",
        parameters: &[
            PumpWarming::HEADER.parameters[0],
            PumpWarming::HEADER.parameters[1],
            Parameter { name: "s", unit: "1", lower: -1.0, upper: 4.0, typical: 1.0, size: false },
            Parameter { name: "w", unit: "1", lower: 0.0, upper: 1.0, typical: 1.0, size: false },
            Parameter { name: "c", unit: "1", lower: -1.0, upper: 2.0, typical: 0.5, size: false },
        ],
        states: 1,
        starts: &[
            &[0.03, 60.0, 1.0, 0.0, 0.0],
            &[0.1, 300.0, -0.9, 0.0, 0.0],
            &[0.1, 100.0, 0.0, 1.0, 0.0],
            &[0.05, 40.0, 0.0, 1.0, 0.7],
        ],
        ..PumpWarming::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            dx[0] = (Self::in_the_end(l.voltage_v) - x[0]) / k[1];
            let running = -(-slowed(S::constant(l.time_s) / k[1], k[2])).exp() + 1.0;
            let warmed = running + k[3] * (x[0] - running);
            l.flow_ml_s -= k[0] * thinned(warmed, k[4]) * l.dp_bar() * l.opening;
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = rest.ran.iter().fold(S::zero(), |x, ran| {
            let end = Self::in_the_end(S::constant(ran.voltage_v));
            end + (x - end) * (S::constant(-ran.for_s) / k[1]).exp()
        });
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

/// `(exp(c*x) - 1)/c`, which is x where c is 0.
fn thinned<S: Scalar>(x: S, c: S) -> S {
    let product = c * x;
    if product.value().abs() < 1e-3 {
        // both sides of the quotient vanish: its series, to 1e-14
        let series = product * (product * (product * (1.0 / 24.0) + 1.0 / 6.0) + 0.5) + 1.0;
        x * series
    } else {
        (product.exp() - 1.0) / c
    }
}
