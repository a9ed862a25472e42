//! Other forms of the pump's effects.

use model::effects::{Balance, Header, Law, Parameter};
use model::port::{Port, PortKind, Rest};
use model::scalar::Scalar;

use super::{header, shape, size};

/// A motor with a winding and an inertia: two lags in a row.
pub(super) struct PumpLagSecondOrder;

impl Law for PumpLagSecondOrder {
    const HEADER: Header = header(
        "pump_lag_second_order",
        Balance::Pump,
        &[PortKind::Actuator],
        "tau*a' = u - a, 0.3*tau*b' = a - b; eq. (10) takes b",
        &[Parameter { name: "tau", unit: "s", lower: 1e-4, upper: 0.5, typical: 0.005, size: true }],
        2,
        &[&[0.006], &[0.02]],
    );

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            // below a millisecond nothing of it shows
            let tau = k[0].at_least(1e-3);
            dx[0] = (a.voltage_v - x[0]) / tau;
            dx[1] = (x[0] - x[1]) / (tau * 0.3).at_least(5e-4);
            a.voltage_v = x[1];
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x.fill(S::constant(rest.voltage_v));
    }
}

/// Oil that warms soon and a housing that follows late.
pub(super) struct PumpWarmingTwoMasses;

impl Law for PumpWarmingTwoMasses {
    const HEADER: Header = header(
        "pump_warming_two_masses",
        Balance::Pump,
        &[PortKind::Line],
        "Q -= k*(1 - 0.6*exp(-t/tau) - 0.4*exp(-t/(8*tau)))*dp*opening of the brake valve",
        &[size("k", "ml/(s bar)", 5.0, 0.05), shape("tau", "s", 5.0, 600.0, 60.0)],
        0,
        &[&[0.02, 20.0], &[0.05, 60.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let time = S::constant(l.time_s);
            let (oil, housing) = ((-(time / k[1])).exp(), (-(time / (k[1] * 8.0))).exp());
            l.flow_ml_s -= k[0] * (-(oil * 0.6 + housing * 0.4) + 1.0) * l.dp_bar() * l.opening;
        }
    }
}

/// Oil that thins as the losses of the motor warm it, by Vogel's law (ln of the viscosity falls as B/(C + T)); what it has done decides, not how long it has run.
pub(super) struct PumpWarmingByLosses;

impl Law for PumpWarmingByLosses {
    const HEADER: Header = header(
        "pump_warming_by_losses",
        Balance::Pump,
        &[PortKind::Line],
        "Q -= k*(exp(T/(1 + T/5)) - 1)*dp*opening of the brake valve; tau*T' = (u/15 V)^2 - T, T = 0 at the run's start",
        &[size("k", "ml/(s bar)", 5.0, 0.05), shape("tau", "s", 5.0, 600.0, 60.0)],
        1,
        &[&[0.02, 40.0], &[0.05, 150.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let share = l.voltage_v / 15.0;
            dx[0] = (share * share - x[0]) / k[1];
            let thinned = (x[0] / (x[0] / 5.0 + 1.0)).exp();
            l.flow_ml_s -= k[0] * (thinned - 1.0) * l.dp_bar() * l.opening;
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = rest.ran.iter().fold(S::zero(), |x, ran| {
            let end = (ran.voltage_v / 15.0).powi(2);
            (x - end) * (S::constant(-ran.for_s) / k[1]).exp() + end
        });
    }
}
