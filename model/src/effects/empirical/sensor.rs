//! Terms without a name in what the sensors show.

use super::{MEASURE, VALIDITY, each_alone, grown, term, typical, waves};
use crate::effects::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

static SENSOR: [Parameter; 41] = [
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
    term("angle4", "deg", 0.05),
    term("angle5", "deg", 0.05),
    term("pressure1_cubic", "bar", 0.02),
    term("pressure2_cubic", "bar", 0.02),
    term("pressure1_4", "bar", 0.02),
    term("pressure2_4", "bar", 0.02),
    term("pressure1_5", "bar", 0.02),
    term("pressure2_5", "bar", 0.02),
    term("wave6_sine", "deg", 0.05),
    term("wave6_cosine", "deg", 0.05),
    term("wave9_sine", "deg", 0.05),
    term("wave9_cosine", "deg", 0.05),
    term("wave12_sine", "deg", 0.05),
    term("wave12_cosine", "deg", 0.05),
    term("wave15_sine", "deg", 0.05),
    term("wave15_cosine", "deg", 0.05),
    term("wave18_sine", "deg", 0.05),
    term("wave18_cosine", "deg", 0.05),
    term("wave21_sine", "deg", 0.05),
    term("wave21_cosine", "deg", 0.05),
    term("wave24_sine", "deg", 0.05),
    term("wave24_cosine", "deg", 0.05),
    term("pressure1_of_2", "1", 0.005),
    term("pressure2_of_1", "1", 0.005),
];
static SENSOR_STARTS: [[f64; 41]; 41] = typical(&SENSOR);

/// Where a pressure sensor's curve is expanded.
const MIDDLE_BAR: f64 = 2.5;

/// What the sensors show.
pub struct EmpiricalSensor;

impl Law for EmpiricalSensor {
    const HEADER: Header = Header {
        id: "empirical_sensor",
        balance: Balance::Sensor,
        ports: &[PortKind::Sensor],
        summary: "zero, gain, bend, ripple, drift, lag and cross-talk of the sensors",
        equation: "shown += sum of c_i * term_i; angle in units of 40 deg, pressure about 2.5 bar where it is bent, from its cube on in units of 2.5 bar; waves of 6, 9, 12, ... 24 rad of phase to a radian of the angle",
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
            let seen_bar = s.pressure_bar;
            for i in 0..2 {
                let p = seen_bar[i];
                // a transducer forgets within milliseconds, a long hose or a wall between them within a second
                dx[i] = (p - x[i]) / 0.02;
                dx[2 + i] = (p - x[2 + i]) / 0.5;
                let from_middle = p - MIDDLE_BAR;
                let a = from_middle / MIDDLE_BAR;
                s.pressure_bar[i] = p
                    + k[2 + i]
                    + k[4 + i] * from_middle
                    + k[15 + i] * from_middle * from_middle
                    + (k[19 + i] + (k[21 + i] + k[23 + i] * a) * a) * a * a * a
                    + k[6 + i] * grown(s.time_s)
                    + k[8 + i] * (x[i] - p)
                    + k[10 + i] * (x[2 + i] - p)
                    // a common supply, or a channel switch that keeps a part of the other's charge
                    + k[39 + i] * (seen_bar[1 - i] - MIDDLE_BAR);
            }
            let angle_deg = s.angle_deg;
            let a = angle_deg / 40.0;
            dx[4] = (angle_deg - x[4]) / 0.02;
            s.angle_deg += k[0]
                + k[1] * angle_deg
                + (k[13] + (k[14] + (k[17] + k[18] * a) * a) * a) * a * a
                + k[12] * (x[4] - angle_deg)
                // what repeats with the lines of a disc
                + waves(&k[25..], angle_deg * (std::f64::consts::PI / 180.0));
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
    use super::super::WAVES;
    use super::super::tests::alone;
    use super::*;
    use crate::port::{Arrival, SensorPort};

    #[test]
    fn a_sensor_s_past_shows_after_a_change_alone_fast_or_slow() {
        let (pressure_bar, angle_rad) = ([2.0, 3.0], 0.5f64);
        let rest = Rest {
            arrival: Arrival::Free,
            ran: &[],
            angle_rad,
            pressure_bar,
            actuator_torque_nm: 0.0,
            torque_nm: 0.0,
            voltage_v: 0.0,
            brake_open: true,
            bypass_open: false,
        };
        let mut still = [f64::NAN; 5];
        EmpiricalSensor.rest(&[], &rest, &mut still);
        let shown = |term: &str, x: &[f64; 5], pressure_bar: [f64; 2], angle_deg: f64| {
            let k = alone::<EmpiricalSensor>(term, 0.3);
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
    fn a_sensor_s_curve_is_of_each_power_alone() {
        let error = |term: &str, angle_deg: f64, pressure_bar: [f64; 2]| {
            let k = alone::<EmpiricalSensor>(term, 0.3);
            let mut port = SensorPort { time_s: 1.0, angle_deg, pressure_bar };
            let still = [pressure_bar[0], pressure_bar[1], pressure_bar[0], pressure_bar[1], angle_deg];
            EmpiricalSensor.act(&k, &still, &mut [0.0; 5], &mut Port::Sensor(&mut port));
            [port.angle_deg - angle_deg, port.pressure_bar[0] - pressure_bar[0], port.pressure_bar[1] - pressure_bar[1]]
        };
        for share in [-1.0f64, -0.5, 0.0, 1.0] {
            let is = |term: &str, channel: usize, of: f64, seen: [f64; 3]| {
                let off = (0..3).map(|n| seen[n] - if n == channel { of } else { 0.0 });
                assert!(off.into_iter().all(|d| d.abs() < 1e-12), "{term} at {share}: {seen:?}");
            };
            for (term, power) in [("angle_square", 2), ("angle_cubic", 3), ("angle4", 4), ("angle5", 5)] {
                is(term, 0, 0.3 * share.powi(power), error(term, 40.0 * share, [2.5; 2]));
            }
            for (end, power) in [("cubic", 3), ("4", 4), ("5", 5)] {
                for sensor in 0..2 {
                    let term = format!("pressure{}_{end}", sensor + 1);
                    let mut pressure_bar = [2.5; 2];
                    pressure_bar[sensor] += 2.5 * share;
                    is(&term, 1 + sensor, 0.3 * share.powi(power), error(&term, 10.0, pressure_bar));
                }
            }
        }
    }

    #[test]
    fn a_pressure_sensor_shows_a_part_of_what_the_other_one_sees() {
        for (term, expected) in [("pressure1_of_2", [2.0 + 0.1 * 1.5, 4.0]), ("pressure2_of_1", [2.0, 4.0 - 0.1 * 0.5])]
        {
            let k = alone::<EmpiricalSensor>(term, 0.1);
            let mut port = SensorPort { time_s: 1.0, angle_deg: 5.0, pressure_bar: [2.0, 4.0] };
            let still = [2.0, 4.0, 2.0, 4.0, 5.0];
            EmpiricalSensor.act(&k, &still, &mut [0.0; 5], &mut Port::Sensor(&mut port));
            let off = port.pressure_bar.iter().zip(expected).map(|(a, b)| (a - b).abs());
            assert!(off.into_iter().all(|d: f64| d < 1e-12), "{term}: {:?}", port.pressure_bar);
        }
    }

    #[test]
    fn an_angle_sensor_s_ripple_repeats_within_the_stroke() {
        for wave in WAVES {
            for (end, of) in [("sine", f64::sin as fn(f64) -> f64), ("cosine", f64::cos)] {
                let k = alone::<EmpiricalSensor>(&format!("wave{wave}_{end}"), 0.3);
                for angle_deg in [-20.0f64, 3.0, 31.0] {
                    let mut port = SensorPort { time_s: 1.0, angle_deg, pressure_bar: [2.0, 3.0] };
                    let still = [2.0, 3.0, 2.0, 3.0, angle_deg];
                    EmpiricalSensor.act(&k, &still, &mut [0.0; 5], &mut Port::Sensor(&mut port));
                    let expected = angle_deg + 0.3 * of(wave * angle_deg.to_radians());
                    assert!((port.angle_deg - expected).abs() < 1e-12, "wave{wave}_{end}");
                    assert_eq!(port.pressure_bar, [2.0, 3.0]);
                }
            }
        }
    }
}
