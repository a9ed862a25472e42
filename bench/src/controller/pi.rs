//! PI control by flow: the law that the angle and every pressure share.
//!
//! The pump moves oil, and oil moves the controlled quantity: oil = D * quantity, with D (ml per unit) from the
//! identified model at the present angle and pressures. So in ml and ml/s every loop is the same integrator:
//!
//! ```text
//! Q* = Q_ff + kp e + I            e: oil that is missing, ml;  kp = 2 pi * bandwidth
//! u  = eq. (10) solved for u at the measured p1 - p2, clamped to +-u_max
//! Q  = eq. (10) at this u: what the pump really gives
//! dI/dt = ki (Q - I - d(oil)/dt)                         ki = 2 pi * integral
//! ```
//!
//! I is the flow that the model has wrong: what the pump was said to give and the rig did not show. While u is not clamped,
//! this is the PI controller with proportional gain (kp + ki) D, integral gain kp ki D and set-point weight kp/(kp + ki).
//! On the model its poles are -kp and -ki, and -ki does not show in the answer to the reference: a step has no overshoot of
//! its own. While u is clamped, Q is the flow that the clamped voltage gives, and I does not wind up.

use super::feed_forward::Oil;
use super::seen::Seen;
use rt_core::Tick;

/// Error and integrator are smoothed at this multiple of the bandwidth: it costs 6 degrees of phase there and keeps two
/// thirds and more of the sensors' noise from the pump.
const SMOOTHING_SHARE: f64 = 10.0;

/// Rates of one loop, 1/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Of the error.
    pub kp_per_s: f64,
    /// Of the integrator.
    pub ki_per_s: f64,
}

impl Rates {
    /// From frequencies, Hz.
    pub fn from_hz(bandwidth_hz: f64, integral_hz: f64) -> Self {
        Rates { kp_per_s: std::f64::consts::TAU * bandwidth_hz, ki_per_s: std::f64::consts::TAU * integral_hz }
    }
}

/// A tick as a loop sees it.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    pub now: Tick,
    pub seen: &'a Seen,
    /// By the model at what was seen.
    pub oil: Oil,
}

/// What a reference asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Q_ff: flow for the reference's own motion, ml/s.
    pub feed_forward_ml_s: f64,
    /// Oil that is missing, ml.
    pub missing_ml: f64,
    /// What is no error yet, ml.
    pub close_ml: f64,
}

/// What remains of a first-order lag after `elapsed_s`.
pub fn decay(rate_per_s: f64, elapsed_s: f64) -> f64 {
    (-rate_per_s * elapsed_s).exp()
}

/// State of a closed loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pi {
    /// I, ml/s, with the sensors' noise.
    learnt_ml_s: f64,
    /// I, ml/s, without it.
    integral_ml_s: f64,
    /// What is left of the difference to the flow before the loop was closed, ml/s: it fades with the loop's own
    /// bandwidth, so that closing the loop is no jump.
    transfer_ml_s: f64,
    /// The missing oil without the sensors' noise, ml.
    smooth_ml: f64,
}

impl Pi {
    /// Closes the loop: the first answer is `flow_ml_s`, whatever error and feed-forward say.
    pub fn closed_at(flow_ml_s: f64, demand: Demand, rates: Rates) -> Self {
        let open = Pi { learnt_ml_s: 0.0, integral_ml_s: 0.0, transfer_ml_s: 0.0, smooth_ml: demand.missing_ml };
        Pi { transfer_ml_s: flow_ml_s - open.flow_ml_s(demand, rates), ..open }
    }

    /// `elapsed_s` ago the pump was set to deliver `delivered_ml_s`; `moved_ml` of oil is what the rig shows of it.
    pub fn learn(&mut self, elapsed_s: f64, delivered_ml_s: f64, moved_ml: f64, demand: Demand, rates: Rates) {
        if elapsed_s <= 0.0 {
            return;
        }
        // Exact for flows that are constant meanwhile: stable however many ticks were skipped.
        let unseen_ml_s = delivered_ml_s - moved_ml / elapsed_s;
        self.learnt_ml_s += (1.0 - decay(rates.ki_per_s, elapsed_s)) * (unseen_ml_s - self.learnt_ml_s);
        self.transfer_ml_s *= decay(rates.kp_per_s, elapsed_s);
        let followed = 1.0 - decay(SMOOTHING_SHARE * rates.kp_per_s, elapsed_s);
        self.smooth_ml += followed * (demand.missing_ml - self.smooth_ml);
        self.integral_ml_s += followed * (self.learnt_ml_s - self.integral_ml_s);
    }

    /// Q*, ml/s.
    pub fn flow_ml_s(&self, demand: Demand, rates: Rates) -> f64 {
        let error_ml = self.smooth_ml - self.smooth_ml.clamp(-demand.close_ml, demand.close_ml);
        demand.feed_forward_ml_s + rates.kp_per_s * error_ml + self.integral_ml_s + self.transfer_ml_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TICK_S: f64 = 1e-3;

    /// What is missing of `wanted_ml` after each tick, on a rig that is what the model says but for a flow that the
    /// model does not know. `most_ml_s` is what the pump can give.
    fn play(rates: Rates, wanted_ml: f64, unknown_ml_s: f64, most_ml_s: f64, ticks: usize) -> Vec<f64> {
        let mut moved_ml = 0.0;
        let mut pi = None::<Pi>;
        let mut last = (0.0, 0.0);
        (0..ticks)
            .map(|_| {
                let missing_ml = wanted_ml - moved_ml;
                let demand = Demand { feed_forward_ml_s: 0.0, missing_ml, close_ml: 0.0 };
                let pi = pi.get_or_insert_with(|| Pi::closed_at(0.0, demand, rates));
                pi.learn(TICK_S, last.0, moved_ml - last.1, demand, rates);
                let given_ml_s = pi.flow_ml_s(demand, rates).clamp(-most_ml_s, most_ml_s);
                last = (given_ml_s, moved_ml);
                moved_ml += TICK_S * (given_ml_s - unknown_ml_s);
                missing_ml
            })
            .collect()
    }

    fn rates() -> impl Strategy<Value = Rates> {
        (0.2..4.0_f64, 0.05..0.5_f64).prop_map(|(hz, share)| Rates::from_hz(hz, share * hz))
    }

    proptest! {
        #[test]
        fn a_step_has_no_overshoot_however_far_and_however_weak_the_pump(
            rates in rates(), wanted_ml in 0.01..100.0_f64, most_ml_s in 1.0..100.0_f64,
        ) {
            let missing = play(rates, wanted_ml, 0.0, most_ml_s, 5000);
            // What is left of smoothing and of the tick's own delay.
            let least_ml = missing.iter().copied().fold(f64::INFINITY, f64::min);
            prop_assert!(least_ml > -0.02 * wanted_ml.min(most_ml_s / rates.kp_per_s), "{least_ml} ml");
        }

        #[test]
        fn what_the_model_has_wrong_is_learnt(rates in rates(), unknown_ml_s in -3.0..3.0_f64) {
            let time_s = 12.0 / rates.ki_per_s;
            let missing = play(rates, 1.0, unknown_ml_s, 50.0, (time_s / TICK_S) as usize);
            let last_ml = missing.last().copied().expect("ran");
            prop_assert!(last_ml.abs() < 1e-3, "{last_ml} ml");
        }

        #[test]
        fn the_first_answer_is_the_flow_that_acts(
            rates in rates(), flow_ml_s in -14.0..14.0_f64, missing_ml in -50.0..50.0_f64, feed_forward_ml_s in -14.0..14.0_f64,
        ) {
            let demand = Demand { feed_forward_ml_s, missing_ml, close_ml: 0.1 };
            let pi = Pi::closed_at(flow_ml_s, demand, rates);
            prop_assert!((pi.flow_ml_s(demand, rates) - flow_ml_s).abs() < 1e-9);
        }

        #[test]
        fn skipped_ticks_are_told_by_the_time_that_passed(rates in rates(), skipped in 1..200_u32) {
            let demand = Demand { feed_forward_ml_s: 0.0, missing_ml: 0.0, close_ml: 0.0 };
            let mut every = Pi::closed_at(0.0, demand, rates);
            let mut once = every;
            for _ in 0..skipped {
                every.learn(TICK_S, 3.0, 2.0 * TICK_S, demand, rates);
            }
            once.learn(TICK_S * f64::from(skipped), 3.0, 2.0 * TICK_S * f64::from(skipped), demand, rates);
            prop_assert!((every.learnt_ml_s - once.learnt_ml_s).abs() < 1e-9);
        }
    }
}
