//! A brake valve that takes its time.

use super::lag::{armature, overlapped, valve};
use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct BrakeValveLag;

impl Law for BrakeValveLag {
    const HEADER: Header = Header {
        id: "brake_valve_lag",
        balance: Balance::Pump,
        ports: &[PortKind::Actuator],
        summary: "the brake valve opens or closes late",
        equation: "tau*y' = command - y with tau = tau_open or tau_close by the direction; Q_p goes through the opening y",
        validity: "first-order stand-in for coil delay and travel of the armature; flow proportional to the opening",
        measure: "switch the brake under constant voltage with the lever clamped and watch the pressures",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 5 (valve dynamics)",
        parameters: &[
            Parameter { name: "tau_open", unit: "s", lower: 0.0, upper: 1.0, typical: 0.01, size: true },
            Parameter { name: "tau_close", unit: "s", lower: 0.0, upper: 1.0, typical: 0.01, size: true },
        ],
        states: 1,
        starts: &[&[0.01, 0.01], &[0.02, 0.0], &[0.0, 0.02], &[0.1, 0.1]],
        passive: false,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Overlapped,
        neutral: &[0.0, 0.0],
        starts: &[&[0.1, 0.0], &[0.3, 0.0], &[0.45, 0.0], &[0.0, 0.7]],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            (dx[0], a.brake_opening) = valve([k[0], k[1]], a.brake_opening, x[0]);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = S::constant(f64::from(u8::from(rest.brake_open)));
    }
}

/// An armature that has to travel before oil flows, and that has opened all when it has not yet arrived: from a first-order lag to a dead time. It
/// may go most of its way at one speed.
struct Overlapped;

impl Law for Overlapped {
    const HEADER: Header = Header {
        equation: "tau*y' = command - y with tau = tau_open or tau_close by the direction; Q_p goes through the opening (y - s)/(1 - 2*s), from 0 to 1; a dead time of tau*ln 2 where s comes near 0.5; with e above 0 y goes the share e of its way at one speed, and tau is the mean delay of y",
        validity: "overlap alike on both sides; flow proportional to the opening",
        parameters: &[
            BrakeValveLag::HEADER.parameters[0],
            BrakeValveLag::HEADER.parameters[1],
            Parameter { name: "s", unit: "1", lower: 0.0, upper: 0.48, typical: 0.2, size: false },
            Parameter { name: "e", unit: "1", lower: 0.0, upper: 0.8, typical: 0.5, size: false },
        ],
        starts: &[&[0.02, 0.02, 0.3, 0.0]],
        ..BrakeValveLag::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            let way;
            (dx[0], way) = armature([k[0], k[1]], k[3], a.brake_opening, x[0]);
            a.brake_opening = overlapped(way, k[2]);
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        BrakeValveLag.rest(&k[..2], rest, x);
    }
}
