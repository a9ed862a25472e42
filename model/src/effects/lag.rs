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
/// exactly at `tau_s` = 0. The least `tau_s` that is told from none falls with the memory, so that no mode is faster than about 1/[`SHORTEST_S`] and a slow
/// swing is none too fast to be one; up to a memory of twice [`SHORTEST_S`] it is that.
#[inline(always)]
pub(super) fn second_order<S: Scalar>(tau_s: S, memory_s: S, input: S, state: [S; 2]) -> ([S; 2], S) {
    let [y, drive] = state;
    let (rate, drive) = first_order(memory_s, input - y, drive);
    // a swing of 1/sqrt(memory*tau), which is below 1/SHORTEST_S at this tau
    let least = S::constant(SHORTEST_S) / ((memory_s / SHORTEST_S - 2.0).at_least(0.0) + 1.0);
    if tau_s.value() > least.value() {
        ([drive / tau_s, rate], y)
    } else {
        ([drive / least, rate], input + (y - input) * (tau_s / least))
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_mode_of_a_second_order_is_much_faster_than_a_millisecond() {
        for tau in [0.0, 1e-9, 1e-6, 1e-4, 3e-4, 1e-3, 3e-3, 0.1, 2.0] {
            for memory in [0.0, 1e-5, 1e-3, 2e-3, 3e-3, 0.02, 0.14, 1.0, 50.0] {
                let rates = |state: [f64; 2]| second_order(tau, memory, 0.0, state).0;
                let (by_y, by_drive) = (rates([1.0, 0.0]), rates([0.0, 1.0]));
                let (trace, determinant) = (by_y[0] + by_drive[1], by_y[0] * by_drive[1] - by_drive[0] * by_y[1]);
                let real = trace * trace - 4.0 * determinant;
                let fastest = if real > 0.0 { 0.5 * (real.sqrt() - trace) } else { determinant.sqrt() };
                assert!(trace < 0.0 && determinant > 0.0, "{tau} s, {memory} s: unstable");
                assert!(fastest * SHORTEST_S < 1.001, "{tau} s, {memory} s: {fastest} 1/s");
                if memory * tau > SHORTEST_S * SHORTEST_S && memory > 2.0 * SHORTEST_S {
                    assert!(
                        (determinant * memory * tau - 1.0).abs() < 1e-9,
                        "{tau} s, {memory} s: it swings as it is to"
                    );
                }
                assert_eq!(second_order(0.0, memory, 0.7, [-0.3, 4.0]).1, 0.7, "none at all");
            }
        }
    }

    #[test]
    fn a_memory_of_twice_the_lag_or_less_leaves_the_least_lag_as_it_is() {
        for tau in [0.0, 3e-4, 0.9e-3, 1e-3, 1.2e-3, 0.05] {
            for share in [0.0, 0.25, 1.0, 2.0] {
                let ([rate, _], passed) = second_order(tau, share * tau, 1.0, [0.4, 0.2]);
                let (_, drive) = first_order(share * tau, 0.6, 0.2);
                let expected = if tau > SHORTEST_S { 0.4 } else { 1.0 - 0.6 * (tau / SHORTEST_S) };
                assert_eq!((rate, passed), (drive / tau.max(SHORTEST_S), expected), "{tau} s, {share}");
            }
        }
    }
}
