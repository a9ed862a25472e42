//! Play between actuator and lever.

use super::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// The actuator's side has no inertia of its own, and grease fills the gap: it passes the torque on at every instant and
/// yields by M/c meanwhile. The lever thus feels the same torque as without play, but the chambers have to fill the gap's
/// volume before a reversed torque can grow: C_v*2b over the pump's flow is the dead time of a reversal.
pub struct Backlash;

/// The sides come to rest against each other with this time constant, s: a hard stop would be stiff.
const CONTACT_S: f64 = 2e-3;
/// A torque at rest far below this (Nm) is measurement noise and says nothing of the side that is in contact.
const NOISE_NM: f64 = 0.05;

impl Law for Backlash {
    const HEADER: Header = Header {
        id: "backlash",
        balance: Balance::Torque,
        ports: &[PortKind::Hydraulic],
        summary: "there is play between actuator and lever",
        equation: "chambers displace by w + g', g' = M_act/c while abs(g) < b, g' = 0 in contact (approached within 2 ms); g: angle of the actuator's side ahead of the lever",
        validity: "actuator side without inertia; play small against the range of angles, so that M_act(phi + g) = M_act(phi)",
        measure: "reverse a slow stroke and look for the angle to rest while the pump delivers",
        literature: "Nordin and Gutman, Controlling mechanical systems with backlash: a survey, Automatica 38 (2002)",
        parameters: &[
            Parameter { name: "b", unit: "deg", lower: 0.0, upper: 5.0, typical: 0.1, size: true },
            Parameter { name: "c", unit: "Nm s/rad", lower: 0.3, upper: 30.0, typical: 1.0, size: false },
        ],
        states: 1,
        starts: &[&[0.05, 0.6], &[0.05, 3.0], &[0.5, 0.6], &[0.5, 3.0]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            let b = k[0] * (std::f64::consts::PI / 180.0);
            let (least, most) = ((-b - x[0]) / CONTACT_S, (b - x[0]) / CONTACT_S);
            let yielding = h.actuator_torque_nm / k[1];
            dx[0] = if yielding.value() >= most.value() {
                most
            } else if yielding.value() <= least.value() {
                least
            } else {
                yielding
            };
            for i in 0..2 {
                h.flow_ml_s[i] -= h.displacement_ml_rad[i] * dx[0];
            }
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = k[0] * (std::f64::consts::PI / 180.0) * (rest.actuator_torque_nm / NOISE_NM).tanh();
    }
}
