//! Lags of first and second order that several effects share, and a dead time, all down to none at all.

use crate::scalar::Scalar;

/// Time constants below this are blended linearly into no lag, s: such a lag cannot be told from none at a sampling time
/// of a millisecond, and its state would be stiff.
pub(super) const SHORTEST_S: f64 = 1e-3;

/// A lag of none passes its input on, whatever its state does: that follows within so many times [`SHORTEST_S`], so that no step of an integration need be
/// shorter for it. Towards the shortest lag that is one it follows as that does.
const IDLE: f64 = 5.0;

/// The time in which the state of a lag of `tau_s` follows, where that is at most `shortest_s` and thus blended into none.
#[inline(always)]
fn idle<S: Scalar>(tau_s: S, shortest_s: S) -> S {
    shortest_s * IDLE - tau_s * (IDLE - 1.0)
}

/// A lag of `tau_s` between `input` and what is passed on, with `state` as its memory: (derivative of the state, what is
/// passed on). At `tau_s` = 0 it passes the input on exactly; derivatives by `tau_s` exist there too.
#[inline(always)]
pub(super) fn first_order<S: Scalar>(tau_s: S, input: S, state: S) -> (S, S) {
    if tau_s.value() > SHORTEST_S {
        ((input - state) / tau_s, state)
    } else {
        // to first order in tau: the state follows within some time, and tau over that of its distance is passed on
        let follows_s = idle(tau_s, S::constant(SHORTEST_S));
        ((input - state) / follows_s, input + (state - input) * (tau_s / follows_s))
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
        let follows_s = idle(tau_s, least);
        ([drive / follows_s, rate], input + (y - input) * (tau_s / follows_s))
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
    fn a_lag_of_less_than_a_millisecond_shows_a_ramp_as_late_as_it_is_and_its_state_need_not_hurry() {
        for tau in [0.0, 1e-4, 5e-4, 0.999e-3, 1e-3, 1.001e-3, 4e-3] {
            let (mut state, mut shown, step) = (0.0, 0.0, 1e-5);
            for n in 0..10_000 {
                let (rate, passed) = first_order(tau, step * f64::from(n), state);
                assert!(rate.abs() < 1.001, "{tau} s: {rate}");
                (state, shown) = (state + step * rate, passed);
            }
            assert!((step * 9_999.0 - shown - tau).abs() < 2e-5, "{tau} s: {shown}");
            let decay = -(first_order(tau, 0.0, 1.0).0 - first_order(tau, 0.0, 0.0).0);
            assert!(decay * SHORTEST_S < 1.001 && (tau > 0.0 || decay * SHORTEST_S < 0.201), "{tau} s: {decay} 1/s");
        }
        // the one meets the other
        let [below, above] = [0.999_999e-3, 1.000_001e-3].map(|tau: f64| first_order(tau, 1.0, 0.3));
        assert!((below.0 / above.0 - 1.0).abs() < 1e-4 && (below.1 - above.1).abs() < 1e-4, "{below:?} {above:?}");
    }

    #[test]
    fn a_memory_of_twice_the_lag_or_less_leaves_the_least_lag_as_it_is() {
        for tau in [0.0, 3e-4, 0.9e-3, 1e-3, 1.2e-3, 0.05] {
            for share in [0.0, 0.25, 1.0, 2.0] {
                let ([rate, _], passed) = second_order(tau, share * tau, 1.0, [0.4, 0.2]);
                let (_, drive) = first_order(share * tau, 0.6, 0.2);
                let follows_s = if tau > SHORTEST_S { tau } else { 5.0 * SHORTEST_S - 4.0 * tau };
                let expected = if tau > SHORTEST_S { 0.4 } else { 1.0 - 0.6 * (tau / follows_s) };
                assert!((rate - drive / follows_s).abs() < 1e-9 * rate.abs(), "{tau} s, {share}: {rate}");
                assert!((passed - expected).abs() < 1e-12, "{tau} s, {share}: {passed}");
            }
        }
    }
}
