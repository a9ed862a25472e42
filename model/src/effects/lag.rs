//! Lags of first and second order that several effects share, and a dead time, all down to none at all.

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

/// A lag of second order, `memory_s*tau_s*y'' + tau_s*y' + y = input`: (derivatives of the two states, what is passed on). The states are `y` and
/// what drives it, `tau_s*y'`. It swings where `memory_s` is more than a quarter of `tau_s`, is [`first_order`] where it is 0, and passes the input on
/// exactly at `tau_s` = 0.
#[inline(always)]
pub(super) fn second_order<S: Scalar>(tau_s: S, memory_s: S, input: S, state: [S; 2]) -> ([S; 2], S) {
    let [y, drive] = state;
    let (rate, drive) = first_order(memory_s, input - y, drive);
    let passed = if tau_s.value() > SHORTEST_S { y } else { input + (y - input) * (tau_s / SHORTEST_S) };
    ([drive / tau_s.at_least(SHORTEST_S), rate], passed)
}

/// `input` as it was `delay_s` ago: (derivatives of the two states, the delayed value). The rational function of degree 1 over 2 that agrees with
/// `exp(-s*delay_s)` to the third order in s (Pade): `(1 - T*s/3) / (1 + 2*T*s/3 + T^2*s^2/6)`. At rest the states are the input and 0.
#[inline(always)]
pub(super) fn dead_time<S: Scalar>(delay_s: S, input: S, state: [S; 2]) -> ([S; 2], S) {
    let [value, slope] = state;
    // the slope in units of 1/delay
    let whole = delay_s.at_least(SHORTEST_S);
    let rates = [slope / whole, ((input - value) * 6.0 - slope * 4.0) / whole];
    let late = value - slope / 3.0;
    if delay_s.value() > SHORTEST_S { (rates, late) } else { (rates, input + (late - input) * (delay_s / SHORTEST_S)) }
}
