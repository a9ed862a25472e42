//! A brake valve that takes its time.

use super::valve::{Late, Valve};
use crate::port::{ActuatorPort, Rest};

/// The valve.
pub struct Brake;

/// See [`super::Law::HEADER`].
pub static BRAKE_VALVE_LAG: Late<Brake> = Late::EFFECT;

impl Valve for Brake {
    const ID: &'static str = "brake_valve_lag";
    const SUMMARY: &'static str = "the brake valve opens or closes late";
    const EQUATIONS: [&'static str; 2] = [
        "tau*y' = command - y with tau = tau_open or tau_close by the direction; Q_p goes through the opening y",
        "tau*y' = command - y with tau = tau_open or tau_close by the direction; Q_p goes through the opening (y - s)/(1 - 2*s), from 0 to 1; a dead time of tau*ln 2 where s comes near 0.5; with e above 0 y goes the share e of its way at one speed, and tau is the mean delay of y",
    ];
    const MEASURE: &'static str =
        "switch the brake under constant voltage with the lever clamped and watch the pressures";

    fn opening<S>(port: &mut ActuatorPort<S>) -> &mut S {
        &mut port.brake_opening
    }

    fn is_open<S>(rest: &Rest<S>) -> bool {
        rest.brake_open
    }
}
