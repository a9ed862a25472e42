//! Hysteresis of the chamber walls: the torque at an angle depends on the way there, not on the velocity.

use super::{Balance, Header, Law, Parameter};
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
        equation: "M -= k*z, d*z' = w - abs(w)*z (Dahl); abs(z) <= 1; of a free lever at rest z holds the torque that is left, as far as k reaches; where the lever was led, z follows from its way",
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

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let w = m.velocity_rad_s;
            dx[0] = (w - w.abs() * x[0]) / k[1];
            m.torque_nm -= k[0] * x[0];
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = match rest.arrival {
            Arrival::Free => {
                // torque/k for k far above the noise, 0 for k -> 0
                let held = rest.torque_nm * k[0] / (k[0] * k[0] + NOISE_NM * NOISE_NM);
                if held.value().abs() <= 1.0 { held } else { S::constant(held.value().signum()) }
            }
            Arrival::Led(way_rad) => led(way_rad, k[1]),
        };
    }
}

/// z at the end of a way from z = 0 on: dz/dphi = (1 - z*sign(w))/d along each stroke.
fn led<S: Scalar>(way_rad: &[f64], d: S) -> S {
    way_rad.windows(2).fold(S::zero(), |z, leg| {
        let side = (leg[1] - leg[0]).signum();
        (z - side) * (S::constant(-(leg[1] - leg[0]).abs()) / d).exp() + side
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::port::MechanicalPort;

    #[test]
    fn a_way_leads_to_the_state_that_moving_along_it_does() {
        let (k, way) = ([0.5, 0.08], [-0.6, 0.1, -0.05, 0.02]);
        let mut z = [0.0];
        const STEPS: usize = 4000;
        for leg in way.windows(2) {
            let velocity_rad_s = leg[1] - leg[0];
            for _ in 0..STEPS {
                let mut dx = [0.0];
                let mut port = MechanicalPort::at(0.0, 0.0, velocity_rad_s);
                ElasticHysteresis.act(&k, &z, &mut dx, &mut Port::Mechanical(&mut port));
                z[0] += dx[0] / STEPS as f64;
            }
        }
        assert!((z[0] - led(&way, k[1])).abs() < 2e-3, "{z:?} {}", led(&way, k[1]));
        assert!(
            led(&way, 0.08) < 0.8 && led(&way[..2], 0.08) > 0.99,
            "a long stroke saturates, a short way back does not"
        );
        assert_eq!((led(&way[..1], 0.08), led(&[], 0.08)), (0.0, 0.0), "no way is known");
    }
}
