//! Terms without a name: smooth functions of the signals of a port, one set per balance. They say how much of a residual
//! sits in a balance, and give a curve, where no effect of the library explains it. They claim no physics and are not part
//! of the library.

use super::{Balance, Effect, Header, Law, Parameter};
use crate::port::{AMBIENT_BAR, Port, PortKind, Rest};
use crate::scalar::Scalar;

/// One set of terms per balance, in the order of [`Balance::ALL`].
pub static EMPIRICAL: [&dyn Effect; 4] = [&EmpiricalTorque, &EmpiricalFlow, &EmpiricalPump, &EmpiricalSensor];

const fn term(name: &'static str, unit: &'static str, typical: f64) -> Parameter {
    Parameter { name, unit, lower: -1e3, upper: 1e3, typical, size: true }
}

/// The typical size of each term, the others at nothing.
const fn typical<const N: usize>(terms: &[Parameter; N]) -> [[f64; N]; N] {
    let mut out = [[0.0; N]; N];
    let mut i = 0;
    while i < N {
        out[i][i] = terms[i].typical;
        i += 1;
    }
    out
}

/// The rows as a header's starts.
const fn each_alone<const N: usize>(rows: &'static [[f64; N]; N]) -> [&'static [f64]; N] {
    let mut out: [&'static [f64]; N] = [&[]; N];
    let mut i = 0;
    while i < N {
        out[i] = &rows[i];
        i += 1;
    }
    out
}

const VALIDITY: &str = "the range of the data it was fitted to";
const MEASURE: &str = "not a physical effect: look at the curve for one";
/// Growth with running time, 1 - exp(-t/30 s).
fn grown(time_s: f64) -> f64 {
    1.0 - (-time_s / 30.0).exp()
}

static TORQUE: [Parameter; 14] = [
    term("constant", "Nm", 0.02),
    term("angle2", "Nm", 0.05),
    term("angle3", "Nm", 0.05),
    term("angle4", "Nm", 0.05),
    term("angle5", "Nm", 0.05),
    term("direction", "Nm", 0.02),
    term("direction_angle", "Nm", 0.05),
    term("direction_angle2", "Nm", 0.05),
    term("direction_load", "Nm/bar", 0.02),
    term("load_angle", "Nm/bar", 0.02),
    term("dp_angle2", "Nm/bar", 0.05),
    term("time_direction", "Nm", 0.05),
    term("motion", "Nm", 0.02),
    term("past_angle", "Nm", 0.05),
];
static TORQUE_STARTS: [[f64; 14]; 14] = typical(&TORQUE);

/// Torque as a function of angle, velocity, pressures, time and of the angle's past.
pub struct EmpiricalTorque;

impl Law for EmpiricalTorque {
    const HEADER: Header = Header {
        id: "empirical_torque",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "a smooth torque over angle, velocity, pressure and time",
        equation: "M += sum of c_i * term_i; angle in units of 0.7 rad, velocity direction tanh(w/0.03)",
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters: &TORQUE,
        states: 1,
        starts: &each_alone(&TORQUE_STARTS),
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let a = m.angle_rad / 0.7;
            let a2 = a * a;
            let direction = (m.velocity_rad_s / 0.03).tanh();
            // what the angle was half a second ago
            dx[0] = (a - x[0]) / 0.5;
            m.torque_nm += k[0]
                + ((k[3] + k[4] * a) * a2 + k[1] + k[2] * a) * a2
                + direction * (k[5] + k[6] * a + k[7] * a2 + k[8] * m.load_bar + k[11] * grown(m.time_s))
                + k[9] * m.load_bar * a
                + k[10] * m.dp_bar * a2
                // friction that is larger in one direction than in the other
                + k[12] * direction * direction
                + k[13] * (a - x[0]);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = rest.angle_rad / 0.7;
    }
}

static FLOW: [Parameter; 14] = [
    term("leak_both", "ml/(s bar)", 0.002),
    term("leak_difference", "ml/(s bar)", 0.002),
    term("leak_square", "ml/(s bar^2)", 0.001),
    term("transfer", "ml/(s bar)", 0.01),
    term("transfer_cubic", "ml/(s bar^3)", 0.01),
    term("capacity_low_pressure", "ml bar", 0.1),
    term("capacity_low_pressure_difference", "ml bar", 0.1),
    term("capacity_difference", "ml/bar", 0.02),
    term("capacity_angle2", "ml/bar", 0.05),
    term("capacity_angle4", "ml/bar", 0.05),
    term("displacement_pressure", "ml/(rad bar)", 0.2),
    term("displacement_difference", "ml/rad", 0.2),
    term("displacement_angle2", "ml/rad", 0.5),
    term("past_pressure", "ml/(s bar)", 0.02),
];
static FLOW_STARTS: [[f64; 14]; 14] = typical(&FLOW);

/// Flows into the chambers, their capacity and displacement.
pub struct EmpiricalFlow;

impl Law for EmpiricalFlow {
    const HEADER: Header = Header {
        id: "empirical_flow",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "smooth flows, capacities and displacements over pressure, angle and time",
        equation: "q_i, C_i, C_v,i += sum of c_i * term_i; angle in units of 0.7 rad",
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters: &FLOW,
        states: 2,
        starts: &each_alone(&FLOW_STARTS),
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            let dp = h.pressure_bar[0] - h.pressure_bar[1];
            let a = h.angle_rad / 0.7;
            if !h.shut_off {
                let transfer = k[3] * dp + k[4] * dp * dp * dp;
                h.flow_ml_s[0] -= transfer;
                h.flow_ml_s[1] += transfer;
            }
            for (i, side) in [(0, 1.0), (1, -1.0)] {
                let p = h.pressure_bar[i];
                let gauge = p - AMBIENT_BAR;
                // half a second's memory of the pressure
                dx[i] = (p - x[i]) / 0.5;
                h.flow_ml_s[i] -= gauge * (k[0] + k[1] * side + k[2] * gauge.abs()) + k[13] * (p - x[i]);
                h.capacity_ml_bar[i] += (k[5] + k[6] * side) / (p * p) + k[7] * side + (k[8] + k[9] * a * a) * a * a;
                h.displacement_ml_rad[i] += k[10] * (p - 2.5) * side + k[11] + k[12] * a * a * side;
            }
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x.copy_from_slice(&rest.pressure_bar);
    }
}

static PUMP: [Parameter; 12] = [
    term("voltage2", "ml/s", 0.05),
    term("voltage_square_odd", "ml/s", 0.05),
    term("voltage3", "ml/s", 0.05),
    term("dp_voltage2", "ml/(s bar)", 0.05),
    term("dp_square_odd", "ml/(s bar^2)", 0.02),
    term("dp3", "ml/(s bar^3)", 0.01),
    term("time_dp", "ml/(s bar)", 0.02),
    term("time_voltage", "ml/s", 0.05),
    term("past_voltage_fast", "ml/s", 0.5),
    term("past_voltage_slow", "ml/s", 0.2),
    term("after_opening", "ml/s", 2.0),
    term("after_closing", "ml/s", 2.0),
];
static PUMP_STARTS: [[f64; 12]; 12] = typical(&PUMP);

/// Flow through pump and line.
pub struct EmpiricalPump;

impl Law for EmpiricalPump {
    const HEADER: Header = Header {
        id: "empirical_pump",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "a smooth flow through pump and brake valve over voltage, its past, the valve's past, and time",
        equation: "Q += sum of c_i * term_i while oil can pass, and after the brake was switched; voltage in units of 24 V",
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters: &PUMP,
        states: 3,
        starts: &each_alone(&PUMP_STARTS),
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let u = l.voltage_v / 24.0;
            dx[0] = (u - x[0]) / 0.01;
            dx[1] = (u - x[1]) / 0.2;
            // what a valve passes shortly after it was switched; it need not open as it closes
            dx[2] = (l.opening - x[2]) / 0.05;
            let past = x[2] - l.opening;
            l.flow_ml_s += if past.value() < 0.0 { k[10] } else { k[11] } * past * u;
            if l.open {
                let dp = l.dp_bar;
                l.flow_ml_s += k[0] * u * u
                    + k[1] * u * u.abs()
                    + k[2] * u * u * u
                    + k[3] * dp * u * u
                    + (k[4] * dp.abs() + k[5] * dp * dp) * dp
                    + (k[6] * dp + k[7] * u) * grown(l.time_s)
                    + k[8] * (x[0] - u)
                    + k[9] * (x[1] - u);
            }
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x.fill(S::constant(rest.voltage_v / 24.0));
        x[2] = S::constant(f64::from(u8::from(rest.brake_open)));
    }
}

static SENSOR: [Parameter; 17] = [
    term("angle_zero", "deg", 0.05),
    term("angle_gain", "1", 0.002),
    term("pressure1_zero", "bar", 0.02),
    term("pressure2_zero", "bar", 0.02),
    term("pressure1_gain", "1", 0.005),
    term("pressure2_gain", "1", 0.005),
    term("pressure1_drift", "bar", 0.02),
    term("pressure2_drift", "bar", 0.02),
    term("pressure1_past", "1", 0.05),
    term("pressure2_past", "1", 0.05),
    term("pressure1_past_slow", "1", 0.02),
    term("pressure2_past_slow", "1", 0.02),
    term("angle_past", "1", 0.01),
    term("angle_square", "deg", 0.05),
    term("angle_cubic", "deg", 0.05),
    term("pressure1_square", "1/bar", 0.005),
    term("pressure2_square", "1/bar", 0.005),
];
static SENSOR_STARTS: [[f64; 17]; 17] = typical(&SENSOR);

/// What the sensors show.
pub struct EmpiricalSensor;

impl Law for EmpiricalSensor {
    const HEADER: Header = Header {
        id: "empirical_sensor",
        balance: Balance::Sensor,
        ports: &[PortKind::Sensor],
        summary: "zero, gain, bend, drift and lag of the sensors",
        equation: "shown += sum of c_i * term_i; angle in units of 40 deg, pressure about 2.5 bar where it is bent",
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters: &SENSOR,
        states: 5,
        starts: &each_alone(&SENSOR_STARTS),
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            for i in 0..2 {
                let p = s.pressure_bar[i];
                // a transducer forgets within milliseconds, a long hose or a wall between them within a second
                dx[i] = (p - x[i]) / 0.02;
                dx[2 + i] = (p - x[2 + i]) / 0.5;
                let from_middle = p - 2.5;
                s.pressure_bar[i] = p
                    + k[2 + i]
                    + k[4 + i] * from_middle
                    + k[15 + i] * from_middle * from_middle
                    + k[6 + i] * grown(s.time_s)
                    + k[8 + i] * (x[i] - p)
                    + k[10 + i] * (x[2 + i] - p);
            }
            let angle_deg = s.angle_deg;
            let a = angle_deg / 40.0;
            dx[4] = (angle_deg - x[4]) / 0.02;
            s.angle_deg += k[0] + k[1] * angle_deg + (k[13] + k[14] * a) * a * a + k[12] * (x[4] - angle_deg);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for i in 0..2 {
            (x[i], x[2 + i]) = (rest.pressure_bar[i], rest.pressure_bar[i]);
        }
        x[4] = rest.angle_rad * (180.0 / std::f64::consts::PI);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::port::{Arrival, HydraulicPort, LinePort, MechanicalPort, SensorPort};

    const VOLTAGE_V: f64 = 12.0;

    /// Flow that a term alone adds at this opening, and how the valve's memory moves.
    fn past(term: &str, x: &[f64; 3], opening: f64) -> (f64, f64) {
        let n = EmpiricalPump::HEADER.parameters.iter().position(|p| p.name == term).unwrap();
        let mut k = vec![0.0; EmpiricalPump::HEADER.parameters.len()];
        k[n] = 3.0;
        let mut line = LinePort { opening, open: opening > 0.0, ..LinePort::open(1.0, VOLTAGE_V, 0.7) };
        let mut dx = [0.0; 3];
        EmpiricalPump.act(&k, x, &mut dx, &mut Port::Line(&mut line));
        (line.flow_ml_s, dx[2])
    }

    #[test]
    fn friction_may_differ_by_direction_and_by_angle() {
        let torque = |term: &str, angle_rad: f64, velocity_rad_s: f64| {
            let n = EmpiricalTorque::HEADER.parameters.iter().position(|p| p.name == term).unwrap();
            let mut k = vec![0.0; EmpiricalTorque::HEADER.parameters.len()];
            k[n] = 0.3;
            let mut m = MechanicalPort::at(1.0, angle_rad, velocity_rad_s);
            EmpiricalTorque.act(&k, &[angle_rad / 0.7], &mut [0.0], &mut Port::Mechanical(&mut m));
            m.torque_nm
        };
        for (angle, speed) in [(0.0, 0.02), (0.4, 0.3), (-0.5, 2.0)] {
            assert_eq!(
                torque("motion", angle, speed),
                torque("motion", -angle, -speed),
                "more one way, less the other"
            );
            assert_eq!(torque("direction", angle, speed), -torque("direction", angle, -speed));
            assert_eq!(torque("direction_angle", angle, speed), -torque("direction_angle", -angle, speed));
            assert_eq!(torque("direction_angle", angle, speed), -torque("direction_angle", angle, -speed));
        }
        for term in ["motion", "direction", "direction_angle"] {
            assert_eq!(torque(term, 0.4, 0.0), 0.0, "at rest there is no friction");
            assert!(torque(term, 0.4, 0.5) > 0.1);
        }
    }

    #[test]
    fn a_valve_s_past_acts_after_its_switch_alone_and_is_forgotten() {
        let settled = |opening: f64| [VOLTAGE_V / 24.0, VOLTAGE_V / 24.0, opening];
        for term in ["after_opening", "after_closing"] {
            for opening in [0.0, 1.0] {
                assert_eq!(past(term, &settled(opening), opening), (0.0, 0.0), "a valve that stands");
            }
        }
        let (closed, falls) = past("after_closing", &settled(1.0), 0.0);
        let (opened, rises) = past("after_opening", &settled(0.0), 1.0);
        assert!(closed > 0.0 && closed == -opened, "oil still passes, or does not yet");
        assert!((falls, rises) == (-20.0, 20.0), "forgotten with 50 ms, 1/s");
        assert_eq!(past("after_opening", &settled(1.0), 0.0).0, 0.0, "a valve may close at once");
        assert_eq!(past("after_closing", &settled(0.0), 1.0).0, 0.0, "or open at once");
    }

    #[test]
    fn what_one_chamber_lacks_and_what_grows_with_the_square_of_the_pressure_have_their_terms() {
        let acts = |term: &str, pressure_bar: [f64; 2]| {
            let n = EmpiricalFlow::HEADER.parameters.iter().position(|p| p.name == term).unwrap();
            let mut k = vec![0.0; EmpiricalFlow::HEADER.parameters.len()];
            k[n] = 0.3;
            let mut port = HydraulicPort::at(1.0, pressure_bar);
            EmpiricalFlow.act(&k, &pressure_bar, &mut [0.0; 2], &mut Port::Hydraulic(&mut port));
            (port.flow_ml_s, port.capacity_ml_bar)
        };
        let (_, both) = acts("capacity_low_pressure", [2.0, 2.0]);
        let (_, apart) = acts("capacity_low_pressure_difference", [2.0, 2.0]);
        assert_eq!((both[0] + apart[0], both[1] + apart[1]), (0.15, 0.0), "air in chamber 1 alone");
        let (flow, _) = acts("leak_square", [AMBIENT_BAR, AMBIENT_BAR + 2.0]);
        assert!(flow[0] == 0.0 && (flow[1] + 1.2).abs() < 1e-12, "out of what is above ambient: {flow:?}");
    }

    #[test]
    fn a_sensor_s_past_shows_after_a_change_alone_fast_or_slow() {
        let (pressure_bar, angle_rad) = ([2.0, 3.0], 0.5f64);
        let rest = Rest {
            arrival: Arrival::Free,
            angle_rad,
            pressure_bar,
            actuator_torque_nm: 0.0,
            torque_nm: 0.0,
            voltage_v: 0.0,
            brake_open: true,
        };
        let mut still = [f64::NAN; 5];
        EmpiricalSensor.rest(&[], &rest, &mut still);
        let shown = |term: &str, x: &[f64; 5], pressure_bar: [f64; 2], angle_deg: f64| {
            let n = EmpiricalSensor::HEADER.parameters.iter().position(|p| p.name == term).unwrap();
            let mut k = vec![0.0; EmpiricalSensor::HEADER.parameters.len()];
            k[n] = 0.3;
            let mut port = SensorPort { time_s: 1.0, angle_deg, pressure_bar };
            let mut dx = [0.0; 5];
            EmpiricalSensor.act(&k, x, &mut dx, &mut Port::Sensor(&mut port));
            (
                [
                    port.pressure_bar[0] - pressure_bar[0],
                    port.pressure_bar[1] - pressure_bar[1],
                    port.angle_deg - angle_deg,
                ],
                dx,
            )
        };
        let angle_deg = angle_rad.to_degrees();
        for (term, moved) in [
            ("pressure1_past", [-0.3, 0.0, 0.0]),
            ("pressure1_past_slow", [-0.3, 0.0, 0.0]),
            ("pressure2_past", [0.0, -0.3, 0.0]),
            ("pressure2_past_slow", [0.0, -0.3, 0.0]),
            ("angle_past", [0.0, 0.0, -0.3]),
        ] {
            let (nothing, at_rest) = shown(term, &still, pressure_bar, angle_deg);
            assert!(nothing.iter().chain(&at_rest).all(|v| v.abs() < 1e-12), "{term}: {nothing:?} {at_rest:?}");
            let (late, _) = shown(term, &still, pressure_bar.map(|p| p + 1.0), angle_deg + 1.0);
            assert!(late.iter().zip(moved).all(|(a, b)| (a - b).abs() < 1e-12), "{term}: {late:?}");
        }
        let (_, dx) = shown("angle_past", &still, pressure_bar.map(|p| p + 1.0), angle_deg + 1.0);
        for (rate, per_second) in dx.iter().zip([50.0, 50.0, 2.0, 2.0, 50.0]) {
            assert!((rate - per_second).abs() < 1e-9, "{dx:?}");
        }
    }

    #[test]
    fn a_slip_turns_with_the_pressure_and_what_is_even_or_odd_in_the_angle_is() {
        let slip = |dp_bar: f64| {
            let n = EmpiricalPump::HEADER.parameters.iter().position(|p| p.name == "dp_square_odd").unwrap();
            let mut k = vec![0.0; EmpiricalPump::HEADER.parameters.len()];
            k[n] = -0.5;
            let mut line = LinePort::open(1.0, 0.0, dp_bar);
            EmpiricalPump.act(&k, &[0.0, 0.0, 1.0], &mut [0.0; 3], &mut Port::Line(&mut line));
            line.flow_ml_s
        };
        assert_eq!((slip(0.0), slip(2.0), slip(-2.0)), (0.0, -2.0, 2.0));
        let torque = |term: &str, angle_rad: f64| {
            let n = EmpiricalTorque::HEADER.parameters.iter().position(|p| p.name == term).unwrap();
            let mut k = vec![0.0; EmpiricalTorque::HEADER.parameters.len()];
            k[n] = 0.3;
            let mut m = MechanicalPort::at(1.0, angle_rad, 0.0);
            EmpiricalTorque.act(&k, &[angle_rad / 0.7], &mut [0.0], &mut Port::Mechanical(&mut m));
            m.torque_nm
        };
        for (power, term) in [(2, "angle2"), (3, "angle3"), (4, "angle4"), (5, "angle5")] {
            assert!((torque(term, 0.7) - 0.3).abs() < 1e-12, "{term}");
            assert!((torque(term, -0.35) - 0.3 * (-0.5f64).powi(power)).abs() < 1e-12, "{term}");
        }
    }
}
