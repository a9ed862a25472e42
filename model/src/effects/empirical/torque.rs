//! Terms without a name in the torque balance.

use super::{MEASURE, VALIDITY, each_alone, grown, term, typical, waves};
use crate::effects::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

static TORQUE: [Parameter; 33] = [
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
    term("direction_creeping", "Nm", 0.05),
    term("direction_slow", "Nm", 0.05),
    term("sine", "Nm", 0.05),
    term("cosine", "Nm", 0.05),
    term("upright_cosine", "Nm", 0.05),
    term("wave6_sine", "Nm", 0.05),
    term("wave6_cosine", "Nm", 0.05),
    term("wave9_sine", "Nm", 0.05),
    term("wave9_cosine", "Nm", 0.05),
    term("wave12_sine", "Nm", 0.05),
    term("wave12_cosine", "Nm", 0.05),
    term("wave15_sine", "Nm", 0.05),
    term("wave15_cosine", "Nm", 0.05),
    term("wave18_sine", "Nm", 0.05),
    term("wave18_cosine", "Nm", 0.05),
    term("wave21_sine", "Nm", 0.05),
    term("wave21_cosine", "Nm", 0.05),
    term("wave24_sine", "Nm", 0.05),
    term("wave24_cosine", "Nm", 0.05),
];
static TORQUE_STARTS: [[f64; 33]; 33] = typical(&TORQUE);

/// Torque as a function of angle, velocity, pressures, time and of the angle's past.
pub struct EmpiricalTorque;

impl Law for EmpiricalTorque {
    const HEADER: Header = Header {
        id: "empirical_torque",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "a smooth torque over angle, velocity, pressure and time",
        equation: "M += sum of c_i * term_i; angle in units of 0.7 rad, velocity direction tanh(w/0.03), creeping exp(-(w/0.05)^2), slow exp(-(w/0.3)^2), waves of 6, 9, 12, ... 24 rad of phase to a radian, upright in the vertical plane alone",
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
                + direction * (k[14] * below(m.velocity_rad_s, 0.05) + k[15] * below(m.velocity_rad_s, 0.3))
                + direction * (k[5] + k[6] * a + k[7] * a2 + k[8] * m.load_bar + k[11] * grown(m.time_s))
                + k[9] * m.load_bar * a
                + k[10] * m.dp_bar * a2
                // friction that is larger in one direction than in the other
                + k[12] * direction * direction
                + k[13] * (a - x[0]);
            // what repeats within the stroke, such as teeth and folds
            m.torque_nm += waves(&k[19..], m.angle_rad);
            // what pulls where gravity is not expected. It acts in both planes, so that what it and other terms make of the runs of one plane together
            // they make of the other as well; what the vertical plane has beside it is gravity's own sine, and a cosine
            m.torque_nm += k[16] * m.angle_rad.sin() + k[17] * m.angle_rad.cos();
            if m.vertical {
                m.torque_nm += k[18] * m.angle_rad.cos();
            }
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = rest.angle_rad / 0.7;
    }
}

/// 1 at rest, nothing far above a velocity.
fn below<S: Scalar>(velocity_rad_s: S, width_rad_s: f64) -> S {
    let times = velocity_rad_s / width_rad_s;
    (-(times * times)).exp()
}

#[cfg(test)]
mod tests {
    use super::super::WAVES;
    use super::super::tests::alone;
    use super::*;
    use crate::port::MechanicalPort;

    /// Torque of 0.3 Nm of a term alone.
    fn torque(term: &str, angle_rad: f64, velocity_rad_s: f64) -> f64 {
        let mut m = MechanicalPort::at(1.0, angle_rad, velocity_rad_s);
        let k = alone::<EmpiricalTorque>(term, 0.3);
        EmpiricalTorque.act(&k, &[angle_rad / 0.7], &mut [0.0], &mut Port::Mechanical(&mut m));
        m.torque_nm
    }

    #[test]
    fn friction_may_differ_by_direction_and_by_angle() {
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
        let of = |term: &str, velocity: f64| torque(term, 0.0, velocity);
        assert!(of("direction_creeping", 0.03) > 0.15 && of("direction_creeping", 0.2) < 1e-6, "a peak near rest");
        assert!(of("direction_slow", 0.1) > 0.25 && of("direction_slow", 1.0) < 1e-4);
        assert_eq!(of("direction_slow", -0.1), -of("direction_slow", 0.1));
    }

    #[test]
    fn one_term_alone_tells_the_planes_apart() {
        for term in &TORQUE {
            let k = alone::<EmpiricalTorque>(term.name, 0.3);
            let [flat, upright] = [false, true].map(|vertical| {
                let mut m = MechanicalPort { vertical, ..MechanicalPort::at(1.0, 0.4, 0.5) };
                EmpiricalTorque.act(&k, &[0.1], &mut [0.0], &mut Port::Mechanical(&mut m));
                m.torque_nm
            });
            // beside them the vertical plane has gravity's sine, which is the base model's
            let expected = match term.name {
                "sine" => [0.3 * 0.4f64.sin(); 2],
                "cosine" => [0.3 * 0.4f64.cos(); 2],
                "upright_cosine" => [0.0, 0.3 * 0.4f64.cos()],
                _ => [flat; 2],
            };
            assert_eq!([flat, upright], expected, "{}", term.name);
        }
    }

    #[test]
    fn what_repeats_within_the_stroke_does() {
        for waves in WAVES {
            for term in [format!("wave{waves}_sine"), format!("wave{waves}_cosine")] {
                let of = |angle: f64| torque(&term, angle, 0.0);
                assert!((of(0.1) - of(0.1 + std::f64::consts::TAU / waves)).abs() < 1e-12, "{term}");
                let odd = if term.ends_with("_sine") { -1.0 } else { 1.0 };
                assert!((of(0.2) - odd * of(-0.2)).abs() < 1e-12 && of(0.2) != 0.0, "{term}");
            }
        }
    }

    #[test]
    fn what_is_even_or_odd_in_the_angle_is() {
        for (power, term) in [(2, "angle2"), (3, "angle3"), (4, "angle4"), (5, "angle5")] {
            assert!((torque(term, 0.7, 0.0) - 0.3).abs() < 1e-12, "{term}");
            assert!((torque(term, -0.35, 0.0) - 0.3 * (-0.5f64).powi(power)).abs() < 1e-12, "{term}");
        }
    }
}
