//! The first-order lag that several effects share, down to no lag at all.

use crate::scalar::Scalar;

/// Time constants below this are blended linearly into no lag, s: such a lag cannot be told from none at a sampling time
/// of a millisecond, and its state would be stiff.
pub(super) const SHORTEST_S: f64 = 1e-3;

/// A lag of `tau_s` between `input` and what is passed on, with `state` as its memory: (derivative of the state, what is
/// passed on). At `tau_s` = 0 it passes the input on exactly; derivatives by `tau_s` exist there too.
#[inline(always)]
pub(super) fn first_order<S: Scalar>(tau_s: S, input: S, state: S) -> (S, S) {
    if tau_s.value() > SHORTEST_S {
        ((input - state) / tau_s, state)
    } else {
        // to first order in tau: the state follows within SHORTEST_S, and tau/SHORTEST_S of its distance is passed on
        ((input - state) / SHORTEST_S, input + (state - input) * (tau_s / SHORTEST_S))
    }
}
