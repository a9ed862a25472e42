//! Effects that no library has: what a rig may well have, in each balance. The diagnosis must say that it does not know them, and where they
//! act.

use model::effects::{Balance, Effect, Header, Law, Parameter};
use model::port::{Port, PortKind};
use model::scalar::Scalar;

/// All of them.
pub static FOREIGN: &[&dyn Effect] = &[
    &TorqueRipple,
    &FrictionWarming,
    &CapacityAngle,
    &ReliefValve,
    &PumpSag,
    &SlipSquare,
    &PressureCurve,
    &EncoderEccentric,
];

const fn header(
    id: &'static str,
    balance: Balance,
    ports: &'static [PortKind],
    equation: &'static str,
    parameters: &'static [Parameter],
    starts: &'static [&'static [f64]],
) -> Header {
    Header {
        id,
        balance,
        ports,
        summary: "an effect that the library does not have",
        equation,
        validity: "stands in for what nobody thought of",
        measure: "",
        literature: "",
        parameters,
        states: 0,
        starts,
        passive: false,
    }
}

const fn size(name: &'static str, unit: &'static str, lower: f64, upper: f64, typical: f64) -> Parameter {
    Parameter { name, unit, lower, upper, typical, size: true }
}

const fn shape(name: &'static str, unit: &'static str, lower: f64, upper: f64, typical: f64) -> Parameter {
    Parameter { name, unit, lower, upper, typical, size: false }
}

/// A bearing that runs easier here and harder there.
struct TorqueRipple;

impl Law for TorqueRipple {
    const HEADER: Header = header(
        "torque_ripple",
        Balance::Torque,
        &[PortKind::Mechanical],
        "M += k*sin(n*phi)",
        &[size("k", "Nm", -5.0, 5.0, 0.1), shape("n", "1/rad", 4.0, 30.0, 9.0)],
        &[&[0.1, 7.0], &[-0.1, 10.0], &[0.1, 13.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            m.torque_nm += k[0] * (k[1] * m.angle_rad).sin();
        }
    }
}

/// A bearing whose grease warms: its friction falls over the run.
struct FrictionWarming;

impl Law for FrictionWarming {
    const HEADER: Header = header(
        "friction_warming",
        Balance::Torque,
        &[PortKind::Mechanical],
        "M -= k*exp(-t/tau)*tanh(w/0.02)",
        &[size("k", "Nm", 0.0, 5.0, 0.2), shape("tau", "s", 3.0, 100.0, 15.0)],
        &[&[0.2, 8.0], &[0.2, 20.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let left = (S::constant(-m.time_s) / k[1]).exp();
            m.torque_nm -= k[0] * left * (m.velocity_rad_s / 0.02).tanh();
        }
    }
}

/// Folds that open in the middle of the stroke: capacity over the square of the angle, alike in both chambers.
struct CapacityAngle;

impl Law for CapacityAngle {
    const HEADER: Header = header(
        "capacity_angle",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "C_hi *= 1 + k*sin(n*phi)^2",
        &[size("k", "1", -0.8, 4.0, 0.1), shape("n", "1/rad", 2.0, 12.0, 4.0)],
        &[&[0.1, 3.0], &[-0.1, 4.0], &[0.2, 6.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            let wave = (k[1] * h.angle_rad).sin();
            for i in 0..2 {
                h.capacity_ml_bar[i] = h.capacity_ml_bar[i] * (k[0] * wave * wave + 1.0);
            }
        }
    }
}

/// A relief valve that weeps early.
struct ReliefValve;

impl Law for ReliefValve {
    const HEADER: Header = header(
        "relief_valve",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "q_i = k*max(0, p_i - p_o)^2 out of each chamber",
        &[size("k", "ml/(s bar2)", 0.0, 20.0, 0.1), shape("p_o", "bar", 2.0, 6.0, 3.2)],
        &[&[0.05, 3.0], &[0.2, 3.4]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for i in 0..2 {
                let over = (h.pressure_bar[i] - k[1]).at_least(0.0);
                h.flow_ml_s[i] -= k[0] * over * over;
            }
        }
    }
}

/// A supply that sags under load: the flow bends over the voltage.
struct PumpSag;

impl Law for PumpSag {
    const HEADER: Header = header(
        "pump_sag",
        Balance::Pump,
        &[PortKind::Line],
        "Q -= k*drive*abs(drive)",
        &[size("k", "s/ml", -0.1, 0.1, 0.003)],
        &[&[0.003], &[-0.003]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            l.flow_ml_s -= k[0] * l.drive_ml_s * l.drive_ml_s.abs() * l.opening;
        }
    }
}

/// A gap that widens under pressure: slip with the square of the pressure difference.
struct SlipSquare;

impl Law for SlipSquare {
    const HEADER: Header = header(
        "slip_square",
        Balance::Pump,
        &[PortKind::Line],
        "Q -= k*dp*abs(dp)*opening of the brake valve",
        &[size("k", "ml/(s bar2)", -1.0, 5.0, 0.02)],
        &[&[0.02]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            l.flow_ml_s -= k[0] * l.dp_bar() * l.dp_bar().abs() * l.opening;
        }
    }
}

/// A sensor's bent characteristic.
struct PressureCurve;

impl Law for PressureCurve {
    const HEADER: Header = header(
        "pressure_curve",
        Balance::Sensor,
        &[PortKind::Sensor],
        "p1 shown = p1 + k1*sin(2*p1), p2 likewise",
        // with half a bar a sensor would show less at more pressure
        &[size("k1", "bar", -0.4, 0.4, 0.03), size("k2", "bar", -0.4, 0.4, 0.03)],
        &[&[0.03, 0.0], &[0.0, -0.03], &[0.02, 0.02]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            for i in 0..2 {
                let bent = (s.pressure_bar[i] * 2.0).sin();
                s.pressure_bar[i] += k[i] * bent;
            }
        }
    }
}

/// An encoder's disc off its axis.
struct EncoderEccentric;

impl Law for EncoderEccentric {
    const HEADER: Header = header(
        "encoder_eccentric",
        Balance::Sensor,
        &[PortKind::Sensor],
        "phi shown = phi + k*sin(n*phi)",
        &[size("k", "deg", -5.0, 5.0, 0.1), shape("n", "1", 3.0, 20.0, 6.0)],
        &[&[0.1, 5.0], &[-0.1, 8.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            let wave = (k[1] * s.angle_deg * (std::f64::consts::PI / 180.0)).sin();
            s.angle_deg += k[0] * wave;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::effects;

    #[test]
    fn none_is_in_the_library_and_every_balance_has_some() {
        for balance in Balance::ALL {
            assert!(FOREIGN.iter().filter(|e| e.header().balance == balance).count() >= 2, "{balance:?}");
        }
        for e in FOREIGN {
            assert!(effects::find(e.header().id).is_none());
            assert!(e.header().starts.iter().all(|s| s.len() == e.header().parameters.len()));
        }
    }
}
