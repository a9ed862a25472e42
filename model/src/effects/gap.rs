//! Oil through a gap of any kind, as general forms of leaks have it.

use crate::scalar::Scalar;

/// A pressure difference that is none, bar: it smooths abs(dp), a power of which has no slope at 0.
const SMALL_BAR: f64 = 1e-4;
/// A gap opens over this pressure difference, bar: its flow has no corner in it.
const OPENING_BAR: f64 = 0.05;

/// Flow in terms of what passes at 1 bar far above `d`: dp*(abs(dp)^s + d^s)^((m - 1)/s). `m` is 0.5 of a turbulent gap and 1 of a laminar one; below the
/// transition pressure `d` (bar) it is laminar, and the transition is the more gradual the smaller `s` is: some 0.7 for a laminar gap with an orifice behind it.
pub(super) fn through_a_gap<S: Scalar>(dp_bar: S, m: S, d: S, s: S) -> S {
    let within = (dp_bar * dp_bar + SMALL_BAR * SMALL_BAR).powf(s * 0.5) + d.powf(s);
    dp_bar * within.powf((m - 1.0) / s)
}

/// What of a pressure difference is beyond `p_c` (bar), that below which a lip or a spring keeps a gap shut, in either direction; all of it where `p_c` is 0.
pub(super) fn beyond_cracking<S: Scalar>(dp_bar: S, p_c: S) -> S {
    let ramp = |over: S| {
        if over.value() <= -0.5 * OPENING_BAR {
            S::constant(0.0)
        } else if over.value() < 0.5 * OPENING_BAR {
            let opened = over + 0.5 * OPENING_BAR;
            opened * opened / (2.0 * OPENING_BAR)
        } else {
            over
        }
    };
    ramp(dp_bar - p_c) - ramp(-dp_bar - p_c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_shut_below_its_cracking_pressure_and_any_without_one_is_open() {
        for dp in [-3.0, -0.7, -0.01, 0.0, 0.01, 0.7, 3.0] {
            assert!((beyond_cracking(dp, 0.0) - dp).abs() < 1e-12, "{dp}");
            let (there, back) = (beyond_cracking(dp, 1.0), beyond_cracking(-dp, 1.0));
            assert_eq!(there, -back, "alike in both directions");
            let beyond = (f64::abs(dp) - 1.0).max(0.0);
            assert!((there.abs() - beyond).abs() < 1e-12, "{dp}: {there}");
        }
        let step = 1e-6;
        for dp in [0.97, 0.975, 0.99, 1.0, 1.02, 1.025, 1.03] {
            let slope = (beyond_cracking(dp + step, 1.0) - beyond_cracking(dp - step, 1.0)) / (2.0 * step);
            let opened = ((dp - 0.975) / 0.05).clamp(0.0, 1.0);
            assert!((slope - opened).abs() < 1e-4, "no corner at {dp}: {slope} and {opened}");
        }
    }
}
