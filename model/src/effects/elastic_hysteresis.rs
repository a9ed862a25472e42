//! Hysteresis of the chamber walls: the torque at an angle depends on the way there, not on the velocity.

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Arrival, Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// Passive: with the stored energy k*d*z^2/2, the power k*z*w that it draws is the change of the stored energy plus
/// k*z^2*abs(w).
pub struct ElasticHysteresis;

/// A torque at rest far below this (Nm) is measurement noise and says nothing of the walls' state.
const NOISE_NM: f64 = 0.01;

impl Law for ElasticHysteresis {
    const HEADER: Header = Header {
        id: "elastic_hysteresis",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "the chamber walls have a rate-independent hysteresis over the angle",
        equation: "M -= k*z, d*z' = w - abs(w)*z (Dahl); abs(z) <= 1; of a free lever at rest z holds the torque that is left, as far as k reaches; where the lever was led, z follows from its way, or, where that is not known, from the torque that the clamp held",
        validity: "rate-independent internal friction of rubber and fabric; d is the way on which a reversed stroke forgets",
        measure: "lead the lever slowly to and fro over growing amplitudes with the bypass open, and read the force sensor",
        literature: "Dahl, A solid friction model, Aerospace Corp. TOR-158 (1968); Vo-Minh, Tjahjowidodo et al., hysteresis of pneumatic muscles, IEEE/ASME Trans. Mechatronics 16 (2011)",
        parameters: &[
            Parameter { name: "k", unit: "Nm", lower: 0.0, upper: 10.0, typical: 0.2, size: true },
            Parameter { name: "d", unit: "rad", lower: 0.002, upper: 1.5, typical: 0.1, size: false },
        ],
        states: 1,
        starts: &[&[0.1, 0.02], &[0.1, 0.1], &[0.1, 0.4], &[1.5, 0.05], &[1.5, 0.3]],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &ThreeElements,
        neutral: &[1.0, 1.0, 0.0, 0.0, 4.0],
        starts: &[
            &[2.0, 0.75, 0.3, 0.3, 4.0],
            &[1.0, 0.6, 0.1, 0.1, 4.0],
            &[2.0, 0.75, 0.1, 0.7, 4.0],
            &[2.0, 0.75, 0.7, 0.1, 4.0],
            &[4.0, 1.0, 1.0, 0.0, 5.0],
        ],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let w = m.velocity_rad_s;
            dx[0] = (w - w.abs() * x[0]) / k[1];
            m.torque_nm -= k[0] * x[0];
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = match rest.arrival {
            Arrival::Free | Arrival::Held => held(k[0], rest.torque_nm),
            Arrival::Led(way_rad) => led(way_rad, k[1]),
        };
    }
}

/// z of a lever at rest that walls hold: torque/k for k far above the noise, 0 for k -> 0.
fn held<S: Scalar>(k: S, torque_nm: S) -> S {
    let held = torque_nm * k / (k * k + NOISE_NM * NOISE_NM);
    if held.value().abs() <= 1.0 { held } else { S::constant(held.value().signum()) }
}

/// z at the end of a way from z = 0 on: dz/dphi = (1 - z*sign(w))/d along each stroke.
fn led<S: Scalar>(way_rad: &[f64], d: S) -> S {
    way_rad.windows(2).fold(S::zero(), |z, leg| {
        let side = (leg[1] - leg[0]).signum();
        (z - side) * (S::constant(-(leg[1] - leg[0]).abs()) / d).exp() + side
    })
}

/// Hysteresis of three elements side by side, which forget on ways of different length, and whose branches bend sooner or later, and back otherwise than there.
/// Ways that follow each other by one factor come near to any distribution of them; what each element bears is linear, so its fit has one minimum.
///
/// Each is passive as Dahl's: of the power k*z*w the stored energy k*d*z^2/2 takes all but k*abs(z)^(n+1)*abs(w) on the way up, and that times 2*b - 1, which is
/// not negative, on the way back.
struct ThreeElements;

/// Smooths abs(z) about 0, where a power of it has no slope.
const SMALL: f64 = 1e-3;
/// A stroke of so many d forgets all that was before it.
const FORGOTTEN: f64 = 30.0;
/// Least way of an element, rad, as of the plain form's: an integration with steps of a millisecond jumps over a shorter one.
const LEAST_WAY_RAD: f64 = 2e-3;
/// Steps of a Runge-Kutta integration along a way of one d.
const STEPS: f64 = 5.0;

impl Law for ThreeElements {
    const HEADER: Header = Header {
        equation: "M -= k*(short*z1 + z2 + long*z3)/(short + 1 + long), d_i*z_i' = w - (b*abs(w)*z_i + (1 - b)*w*abs(z_i))*abs(z_i)^(n - 1), d_1 = d/ratio but 2 mrad at least, d_2 = d, d_3 = ratio*d (Bouc-Wen; n = b = 1: Dahl; short = long = 0: one element); abs(z_i) <= 1; of a free lever at rest all hold the torque that is left, as far as k reaches; where the lever was led, each follows from its way, or, where that is not known, from the torque that the clamp held",
        validity: "rate-independent internal friction of rubber and fabric; d_i is the way on which an element forgets a reversed stroke; with a larger n the branches bend later and more sharply, with a smaller b they are straighter on the way back; the power of abs(z_i) smoothed over 1e-3",
        literature: "Wen, Method for random vibration of hysteretic systems, J. Eng. Mech. Div. ASCE 102 (1976); Ismail, Ikhouane, Rodellar, The hysteresis Bouc-Wen model, a survey, Arch. Comput. Methods Eng. 16 (2009); Iwan, A distributed-element model for hysteresis, J. Appl. Mech. 33 (1966); Vo-Minh, Tjahjowidodo et al., IEEE/ASME Trans. Mechatronics 16 (2011): Maxwell slip, elements side by side",
        parameters: &[
            ElasticHysteresis::HEADER.parameters[0],
            ElasticHysteresis::HEADER.parameters[1],
            Parameter { name: "n", unit: "1", lower: 1.0, upper: 6.0, typical: 1.5, size: false },
            Parameter { name: "b", unit: "1", lower: 0.5, upper: 1.0, typical: 0.75, size: false },
            Parameter { name: "short", unit: "1", lower: 0.0, upper: 20.0, typical: 0.5, size: false },
            Parameter { name: "long", unit: "1", lower: 0.0, upper: 20.0, typical: 0.5, size: false },
            Parameter { name: "ratio", unit: "1", lower: 1.5, upper: 40.0, typical: 4.0, size: false },
        ],
        states: 3,
        starts: &[&[0.1, 0.1, 2.0, 0.75, 0.3, 0.3, 5.0], &[1.5, 0.1, 2.0, 0.75, 0.3, 0.3, 5.0]],
        ..ElasticHysteresis::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            for (i, shape) in elements(k).into_iter().enumerate() {
                dx[i] = rate(&shape, x[i], m.velocity_rad_s);
            }
            let (short, long) = (k[4], k[5]);
            m.torque_nm -= k[0] * (short * x[0] + x[1] + long * x[2]) / (short + 1.0 + long);
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for (shape, x) in elements(k).into_iter().zip(x) {
            *x = match rest.arrival {
                Arrival::Free | Arrival::Held => held(k[0], rest.torque_nm),
                Arrival::Led(way_rad) => way_rad.windows(2).fold(S::zero(), |z, leg| along(&shape, z, leg[1] - leg[0])),
            };
        }
    }
}

/// d, n and b of each element.
fn elements<S: Scalar>(k: &[S]) -> [[S; 3]; 3] {
    let (d, n, b, ratio) = (k[1], k[2], k[3], k[6]);
    [[(d / ratio).at_least(LEAST_WAY_RAD), n, b], [d, n, b], [d * ratio, n, b]]
}

/// z' at a velocity; `shape`: d, n and b.
fn rate<S: Scalar>(shape: &[S], z: S, w: S) -> S {
    let (d, n, b) = (shape[0], shape[1], shape[2]);
    let bend = (z * z + SMALL * SMALL).powf((n - 1.0) * 0.5);
    (w - (b * w.abs() * z + (S::constant(1.0) - b) * w * z.abs()) * bend) / d
}

/// z at the end of a stroke, rad.
fn along<S: Scalar>(shape: &[S], mut z: S, way_rad: f64) -> S {
    let ways = way_rad.abs() / shape[0].value();
    if ways > FORGOTTEN {
        return S::constant(way_rad.signum());
    }
    let steps = (STEPS * ways).ceil();
    let h = way_rad / steps;
    for _ in 0..steps as usize {
        let each = |z: S| rate(shape, z, S::constant(h));
        let first = each(z);
        let second = each(z + first * 0.5);
        let third = each(z + second * 0.5);
        let fourth = each(z + third);
        z += (first + (second + third) * 2.0 + fourth) * (1.0 / 6.0);
    }
    z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::port::MechanicalPort;

    const WAY_RAD: [f64; 4] = [-0.6, 0.1, -0.05, 0.02];

    /// z of each element after moving along the way, a second a leg.
    fn moved<L: Law>(law: &L, k: &[f64], way_rad: &[f64]) -> Vec<f64> {
        let mut z = vec![0.0; L::HEADER.states];
        const STEPS: usize = 4000;
        for leg in way_rad.windows(2) {
            for _ in 0..STEPS {
                let mut dx = vec![0.0; z.len()];
                let mut port = MechanicalPort::at(0.0, 0.0, leg[1] - leg[0]);
                law.act(k, &z, &mut dx, &mut Port::Mechanical(&mut port));
                z.iter_mut().zip(dx).for_each(|(z, rate)| *z += rate / STEPS as f64);
            }
        }
        z
    }

    /// z of each element of a lever that was led along the way.
    fn at_rest<L: Law>(law: &L, k: &[f64], way_rad: &[f64]) -> Vec<f64> {
        let mut z = vec![f64::NAN; L::HEADER.states];
        let still = Rest {
            arrival: Arrival::Led(way_rad),
            ran: &[],
            angle_rad: way_rad[way_rad.len() - 1],
            pressure_bar: [2.0; 2],
            actuator_torque_nm: 0.0,
            torque_nm: 0.0,
            voltage_v: 0.0,
            brake_open: true,
            bypass_open: false,
        };
        law.rest(k, &still, &mut z);
        z
    }

    #[test]
    fn a_general_way_leads_where_moving_along_it_does_and_forgets_in_a_long_stroke() {
        for [d, n, b, ratio] in
            [[0.08, 2.0, 0.7, 4.0], [0.08, 1.0, 1.0, 2.0], [0.3, 5.0, 0.5, 1.5], [0.1, 1.5, 0.9, 10.0]]
        {
            let k = [0.5, d, n, b, 0.4, 0.7, ratio];
            let (by_motion, by_way) = (moved(&ThreeElements, &k, &WAY_RAD), at_rest(&ThreeElements, &k, &WAY_RAD));
            for (motion, way) in by_motion.iter().zip(&by_way) {
                assert!((motion - way).abs() < 3e-3, "{k:?}: {by_motion:?} {by_way:?}");
            }
        }
        let dahl = at_rest(&ElasticHysteresis, &[0.5, 0.08], &WAY_RAD)[0];
        assert!((at_rest(&ThreeElements, &[0.5, 0.08, 1.0, 1.0, 0.0, 0.0, 5.0], &WAY_RAD)[1] - dahl).abs() < 1e-3);
        assert_eq!(at_rest(&ThreeElements, &[0.5, 0.004, 2.0, 0.7, 0.4, 0.4, 2.0], &[0.5, -0.5]), [-1.0; 3]);
    }

    #[test]
    fn three_elements_hold_their_shares_of_the_torque() {
        let torque = |short: f64, long: f64| {
            let mut port = MechanicalPort::at(0.0, 0.0, 0.0);
            let z = [1.0, 0.5, 0.25];
            let k = [0.8, 0.1, 2.0, 0.7, short, long, 5.0];
            ThreeElements.act(&k, &z, &mut [0.0; 3], &mut Port::Mechanical(&mut port));
            port.torque_nm
        };
        for (short, long, expected) in [(0.0, 0.0, -0.4), (1.0, 0.0, -0.6), (0.0, 1.0, -0.3), (2.0, 1.0, -0.55)] {
            assert!((torque(short, long) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn a_way_leads_to_the_state_that_moving_along_it_does() {
        let (k, way) = ([0.5, 0.08], WAY_RAD);
        let z = moved(&ElasticHysteresis, &k, &way)[0];
        assert!((z - led(&way, k[1])).abs() < 2e-3, "{z:?} {}", led(&way, k[1]));
        assert!(
            led(&way, 0.08) < 0.8 && led(&way[..2], 0.08) > 0.99,
            "a long stroke saturates, a short way back does not"
        );
        assert_eq!((led(&way[..1], 0.08), led(&[], 0.08)), (0.0, 0.0), "no way is known");
    }

    #[test]
    fn walls_of_a_lever_that_came_there_nobody_knows_how_hold_what_the_clamp_does_not() {
        let base = crate::Parameters::example().to_vector();
        let input = crate::rec::Input {
            voltage_v: 0.0,
            brake_open: true,
            bypass_open: true,
            vertical: false,
            lever: crate::rec::Lever::Led { velocity_rad_s: 0.0 },
            circuit: crate::rec::Circuit::Pump,
        };
        let plain: (&'static dyn crate::effects::Effect, Vec<f64>) = (&ElasticHysteresis, vec![0.5, 0.08]);
        let general: (&'static dyn crate::effects::Effect, Vec<f64>) =
            (&ThreeElements, vec![0.5, 0.08, 1.5, 0.7, 0.4, 0.6, 5.0]);
        for effect in [plain, general] {
            let effects = crate::effects::EffectSet::new(crate::rec::STATES, [effect]);
            let mut x = vec![0.0; crate::rec::STATES + effects.states];
            (x[0], x[2], x[3]) = (0.3, 3.0, 2.4);
            let pressure_bar = [3.0, 2.4];
            let alone = crate::rec::derivative(&input, &base, &effects, 0.0, &x, &mut x.clone()).torque_nm;
            for by_walls_nm in [-0.4, 0.2, 0.45, 0.9] {
                let held = crate::port::Held { torque_nm: alone - by_walls_nm, pressure_bar };
                let before = crate::port::Before { held: Some(held), ..Default::default() };
                // the oil has not levelled out yet at first, and has when the torque is read
                x[2] = 3.1;
                crate::rec::rest_states_after(before, &input, &base, &effects, &mut x);
                x[2] = pressure_bar[0];
                let torque_nm = crate::rec::derivative(&input, &base, &effects, 0.0, &x, &mut x.clone()).torque_nm;
                let expected = alone - by_walls_nm.clamp(-0.5, 0.5);
                assert!((torque_nm - expected).abs() < 1e-3, "{torque_nm} and {expected}");
            }
        }
    }
}
