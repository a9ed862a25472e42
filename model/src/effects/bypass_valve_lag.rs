//! A bypass valve that takes its time.

use super::valve::{Late, Valve};
use crate::port::{ActuatorPort, Rest};

/// The valve.
pub struct Bypass;

/// See [`super::Law::HEADER`].
pub static BYPASS_VALVE_LAG: Late<Bypass> = Late::EFFECT;

impl Valve for Bypass {
    const ID: &'static str = "bypass_valve_lag";
    const SUMMARY: &'static str = "the bypass valve opens or closes late";
    const EQUATIONS: [&'static str; 2] = [
        "tau*y' = command - y with tau = tau_open or tau_close by the direction; k_b is that of the open valve times the opening y",
        "tau*y' = command - y with tau = tau_open or tau_close by the direction; k_b is that of the open valve times the opening (y - s)/(1 - 2*s), from 0 to 1; a dead time of tau*ln 2 where s comes near 0.5; with e above 0 y goes the share e of its way at one speed, and tau is the mean delay of y",
    ];
    const MEASURE: &'static str =
        "open and close the bypass while the lever holds the chambers at different pressures, and watch them";

    fn opening<S>(port: &mut ActuatorPort<S>) -> &mut S {
        &mut port.bypass_opening
    }

    fn is_open<S>(rest: &Rest<S>) -> bool {
        rest.bypass_open
    }
}
