//! Conditions on measured channels: what a hold waits for.

use crate::spread::SpreadWindow;
use rt_core::{Input, Measurement, PERIOD_NS, Tick};
use serde::Deserialize;
use std::fmt;

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
    /// As a script names it.
    pub fn as_str(self) -> &'static str {
        match self {
            Channel::AngleDeg => "angle_deg",
            Channel::Pressure1Bar => "pressure1_bar",
            Channel::Pressure2Bar => "pressure2_bar",
            Channel::TorqueNm => "torque_nm",
        }
    }

    /// The input that it looks at.
    fn input(self) -> Input {
        match self {
            Channel::AngleDeg => Input::Angle,
            Channel::Pressure1Bar => Input::Pressure1,
            Channel::Pressure2Bar => Input::Pressure2,
            Channel::TorqueNm => Input::Torque,
        }
    }

    /// This channel's value; NaN where it was not measured.
    pub fn of(self, measured: &Measurement) -> f64 {
        measured.value(self.input())
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
    /// Largest less smallest value over the last `ticks`.
    SteadyWithin {
        spread: f64,
        ticks: u64,
    },
}

/// A condition with its state. It is used by one hold only, so its state begins with that hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Condition {
    pub channel: Channel,
    pub limit: Limit,
    filter: Option<Filter>,
    /// What was last held against the limit.
    last: Option<f64>,
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
/// A reading that is older than this part of the window over which it is judged tells nothing of it: one that stands looks steady.
const STANDING_SHARE: f64 = 0.1;
/// Bounds of that age, ns: slow sensors have the first, beyond the second any reading stands.
const STANDING_NS: (f64, f64) = (20e6, 1e9);

impl Condition {
    pub fn new(channel: Channel, limit: Limit) -> Self {
        Condition { channel, limit, filter: None, last: None }
    }

    /// Ticks that its window must hold; 0 where it needs none.
    pub fn window_ticks(&self) -> u64 {
        if let Limit::SteadyWithin { ticks, .. } = self.limit { ticks } else { 0 }
    }

    /// What the limit was last compared with: a value, a rate per second or a spread, in the channel's unit. `None`: there was nothing to
    /// compare, because the channel was not measured, or not for long enough.
    pub fn last(&self) -> Option<f64> {
        self.last
    }

    /// Whether the reading is too old for a limit on how the channel changes.
    fn stands(&self, measured: &Measurement) -> bool {
        let window_ns = match self.limit {
            Limit::Above(_) | Limit::Below(_) => return false,
            Limit::RateBelow { window_s, .. } => window_s * 1e9,
            Limit::SteadyWithin { ticks, .. } => ticks as f64 * PERIOD_NS as f64,
        };
        let (least_ns, most_ns) = STANDING_NS;
        let age_ns = f64::from(measured.age_ns[self.channel.input() as usize]);
        age_ns > (STANDING_SHARE * window_ns).clamp(least_ns, most_ns)
    }

    /// Looks at this tick's measurement; to be called at every tick that is run while the condition is waited for. `window` is its own
    /// while its hold lasts, empty when that begins.
    pub fn met(&mut self, now: Tick, measured: &Measurement, window: &mut SpreadWindow) -> bool {
        let value = self.channel.of(measured);
        if value.is_nan() || self.stands(measured) {
            window.clear();
            return false;
        }
        match self.limit {
            Limit::Above(limit) => {
                self.last = Some(value);
                value > limit
            }
            Limit::Below(limit) => {
                self.last = Some(value);
                value < limit
            }
            Limit::SteadyWithin { spread, ticks } => match window.push(now.index, value, ticks) {
                Some(seen) => {
                    self.last = Some(seen);
                    seen <= spread
                }
                None => false,
            },
            Limit::RateBelow { per_s, window_s } => {
                let begin = Filter { first: value, second: value, seen_s: 0.0, until_tick: now.index };
                let filter = self.filter.get_or_insert(begin);
                let passed_s = (now.index + 1).saturating_sub(filter.until_tick) as f64 * (PERIOD_NS as f64 * 1e-9);
                let gain = passed_s / (window_s + passed_s);
                filter.first += gain * (value - filter.first);
                filter.second += gain * (filter.first - filter.second);
                filter.seen_s += passed_s;
                filter.until_tick = now.index + 1;
                let difference = (filter.first - filter.second).abs();
                let seen = filter.seen_s >= WINDOWS_BEFORE_STEADY * window_s;
                if seen {
                    self.last = Some(difference / window_s);
                }
                seen && difference < per_s * window_s
            }
        }
    }
}

/// For people, as in "waited for ...".
impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.channel.as_str();
        match self.limit {
            Limit::Above(limit) => write!(f, "{name} above {limit}"),
            Limit::Below(limit) => write!(f, "{name} below {limit}"),
            Limit::RateBelow { per_s, window_s } => {
                write!(f, "rate of {name} below {per_s} a second over {window_s} s")
            }
            Limit::SteadyWithin { spread, ticks } => {
                write!(f, "{name} steady within {spread} for {} s", Tick::at(ticks).seconds())
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
                let measured = angle(7.0 + slope_per_s * k as f64 * 1e-3);
                if condition.met(Tick::at(k), &measured, &mut SpreadWindow::for_ticks(0)) && met_at.is_none() {
                    met_at = Some(k);
                }
            }
            assert_eq!(met_at.is_some(), expected, "slope {slope_per_s}");
            assert!(met_at.is_none_or(|k| k >= 999), "before the window: {met_at:?}");
        }
    }

    #[test]
    fn a_channel_that_is_not_measured_meets_nothing() {
        for limit in [
            Limit::Above(-1e9),
            Limit::Below(1e9),
            Limit::RateBelow { per_s: 1e9, window_s: 1e-3 },
            Limit::SteadyWithin { spread: 1e9, ticks: 1 },
        ] {
            let mut condition = Condition::new(Channel::TorqueNm, limit);
            let mut window = SpreadWindow::for_ticks(condition.window_ticks());
            assert!((0..100).all(|k| !condition.met(Tick::at(k), &angle(0.0), &mut window)));
            assert_eq!(condition.last(), None, "nothing was compared");
        }
    }

    #[test]
    fn a_reading_that_only_grows_older_is_not_steady() {
        for limit in [Limit::SteadyWithin { spread: 0.1, ticks: 1000 }, Limit::RateBelow { per_s: 0.1, window_s: 1.0 }]
        {
            let met = |age_ns: fn(u64) -> u32| {
                let mut condition = Condition::new(Channel::AngleDeg, limit);
                let mut window = SpreadWindow::for_ticks(1000);
                (0..8000).any(|k| {
                    let mut measured = angle(3.0);
                    measured.age_ns[Input::Angle as usize] = age_ns(k);
                    condition.met(Tick::at(k), &measured, &mut window)
                })
            };
            assert!(met(|k| (k % 50) as u32 * 1_000_000), "{limit:?}: a slow sensor's comes anew");
            assert!(!met(|k| k.min(4000) as u32 * 1_000_000), "{limit:?}: stands since the beginning");
        }
    }

    #[test]
    fn a_gap_begins_the_window_anew() {
        let mut condition = Condition::new(Channel::AngleDeg, Limit::SteadyWithin { spread: 0.1, ticks: 10 });
        let mut window = SpreadWindow::for_ticks(10);
        let met: Vec<u64> = (0..40)
            .filter(|&k| {
                let value = if k == 15 { f64::NAN } else { 3.0 };
                condition.met(Tick::at(k), &angle(value), &mut window)
            })
            .collect();
        assert_eq!(met, (10..15).chain(26..40).collect::<Vec<_>>());
    }
}
