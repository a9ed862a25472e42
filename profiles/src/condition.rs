//! Conditions on measured channels: what a hold waits for.

use rt_core::{Measurement, PERIOD_NS, Tick};
use serde::Deserialize;

/// A measured channel that a condition may look at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Absolute encoder, degrees.
    AngleDeg,
    /// Chamber 1 (pump bench: port 1), bar absolute.
    #[serde(rename = "pressure1_bar")]
    Pressure1Bar,
    /// Chamber 2 (pump bench: port 2), bar absolute.
    #[serde(rename = "pressure2_bar")]
    Pressure2Bar,
    /// Torque that the clamp holds, Nm.
    TorqueNm,
}

impl Channel {
    /// This channel's value; NaN where it was not measured.
    pub fn of(self, measured: &Measurement) -> f64 {
        match self {
            Channel::AngleDeg => measured.angle_deg,
            Channel::Pressure1Bar => measured.pressure1_bar,
            Channel::Pressure2Bar => measured.pressure2_bar,
            Channel::TorqueNm => measured.torque_nm,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Limit {
    Above(f64),
    Below(f64),
    /// Absolute rate per second of the channel after two low-pass filters with this time constant.
    RateBelow {
        per_s: f64,
        window_s: f64,
    },
}

/// A condition with the state of its filter. It is used by one hold only, so its state begins with that hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Condition {
    pub channel: Channel,
    pub limit: Limit,
    filter: Option<Filter>,
}

/// Two first-order filters in series: behind a ramp of slope r their outputs differ by r times the time constant.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Filter {
    first: f64,
    second: f64,
    seen_s: f64,
    /// The first tick that it does not know of.
    until_tick: u64,
}

/// The filters have forgotten their start after this many time constants (their error is below 5 % of the first step).
const WINDOWS_BEFORE_STEADY: f64 = 5.0;

impl Condition {
    pub fn new(channel: Channel, limit: Limit) -> Self {
        Condition { channel, limit, filter: None }
    }

    /// Looks at this tick's measurement; to be called at every tick that is run while the condition is waited for.
    pub fn met(&mut self, now: Tick, measured: &Measurement) -> bool {
        let value = self.channel.of(measured);
        if value.is_nan() {
            return false;
        }
        match self.limit {
            Limit::Above(limit) => value > limit,
            Limit::Below(limit) => value < limit,
            Limit::RateBelow { per_s, window_s } => {
                let begin = Filter { first: value, second: value, seen_s: 0.0, until_tick: now.index };
                let filter = self.filter.get_or_insert(begin);
                let passed_s = (now.index + 1).saturating_sub(filter.until_tick) as f64 * (PERIOD_NS as f64 * 1e-9);
                let gain = passed_s / (window_s + passed_s);
                filter.first += gain * (value - filter.first);
                filter.second += gain * (filter.first - filter.second);
                filter.seen_s += passed_s;
                filter.until_tick = now.index + 1;
                filter.seen_s >= WINDOWS_BEFORE_STEADY * window_s
                    && (filter.first - filter.second).abs() < per_s * window_s
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angle(angle_deg: f64) -> Measurement {
        Measurement { angle_deg, ..Measurement::NONE }
    }

    #[test]
    fn rate_condition_separates_slopes_and_needs_its_window() {
        for (slope_per_s, expected) in [(0.9, true), (1.1, false), (-0.9, true), (-1.1, false)] {
            let mut condition = Condition::new(Channel::AngleDeg, Limit::RateBelow { per_s: 1.0, window_s: 0.2 });
            let mut met_at = None;
            for k in 0..5000 {
                if condition.met(Tick::at(k), &angle(7.0 + slope_per_s * k as f64 * 1e-3)) && met_at.is_none() {
                    met_at = Some(k);
                }
            }
            assert_eq!(met_at.is_some(), expected, "slope {slope_per_s}");
            assert!(met_at.is_none_or(|k| k >= 999), "before the window: {met_at:?}");
        }
    }

    #[test]
    fn a_channel_that_is_not_measured_meets_nothing() {
        for limit in [Limit::Above(-1e9), Limit::Below(1e9), Limit::RateBelow { per_s: 1e9, window_s: 1e-3 }] {
            let mut condition = Condition::new(Channel::TorqueNm, limit);
            assert!((0..100).all(|k| !condition.met(Tick::at(k), &angle(0.0))));
        }
    }
}
