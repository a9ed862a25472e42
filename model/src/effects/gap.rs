//! Oil through a gap of any kind, as general forms of leaks have it.

use crate::scalar::Scalar;

/// A pressure difference that is none, bar: it smooths abs(dp), a power of which has no slope at 0.
const SMALL_BAR: f64 = 1e-4;

/// Flow in terms of what passes at 1 bar far above `d`: dp*(abs(dp)^s + d^s)^((m - 1)/s). `m` is 0.5 of a turbulent gap and 1 of a laminar one; below the
/// transition pressure `d` (bar) it is laminar, and the transition is the more gradual the smaller `s` is: some 0.7 for a laminar gap with an orifice behind it.
pub(super) fn through_a_gap<S: Scalar>(dp_bar: S, m: S, d: S, s: S) -> S {
    let within = (dp_bar * dp_bar + SMALL_BAR * SMALL_BAR).powf(s * 0.5) + d.powf(s);
    dp_bar * within.powf((m - 1.0) / s)
}
