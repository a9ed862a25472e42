//! The values of a step: numbers with their variables, ranges, fixtures, conditions.

use crate::condition::{Channel, Condition, Limit};
use crate::controlled::Controlled;
use crate::error::{ScriptError, Source};
use crate::raw::{AmountName, FixtureName, Quantity, RawCondition, RawRandom, RawStep, at};
use crate::script::{ANGLE_LIMIT_DEG, End, FixtureChange, OperatorPart, RandomSteps};
use crate::target::Prepared;
use rt_core::{Amount, Fixture, PERIOD_NS};
use std::cell::Cell;
use std::ops::Range;
use toml::Spanned;

/// Longest single hold, s.
pub(crate) const MAX_HOLD_S: f64 = 86_400.0;
/// One tick of the loop, s: the shortest hold.
pub(crate) const TICK_S: f64 = PERIOD_NS as f64 * 1e-9;
/// Longest time over which a channel may be asked to be steady, s: the loop keeps the values of that time.
const MOST_STEADY_S: f64 = 600.0;
/// Longest text of an operator's step, characters: a terminal's line holds it.
const MOST_SAID: usize = 120;
/// Fastest ramp of the lever, degrees a second.
const MAX_RATE_DEG_S: f64 = 90.0;

/// Nearest whole number of ticks, at least one.
pub(crate) fn ticks(seconds: f64) -> u64 {
    ((seconds * 1e9 / PERIOD_NS as f64).round() as u64).max(1)
}

/// The first whole number of ticks that is not below.
pub(crate) fn ticks_at_least(seconds: f64) -> u64 {
    ((seconds * 1e9 / PERIOD_NS as f64).ceil() as u64).max(1)
}

/// What a value out of its range may have been meant as: the units that people mix up most.
fn remedy(key: &str, value: f64, low: f64, high: f64) -> String {
    let fits = |value: f64| (low..=high).contains(&value);
    let meant = |units: &[(&str, f64)], own: &str| -> String {
        let said = units
            .iter()
            .filter(|(_, of_own)| fits(value / of_own))
            .map(|(unit, of_own)| format!("{value} {unit} are {} {own}", (value / of_own * 1e6).round() / 1e6));
        let said: Vec<String> = said.collect();
        if said.is_empty() { String::new() } else { format!("; write it in {own}: {}", said.join(", ")) }
    };
    let share = ["voltage_u_max", "probability"].contains(&key) || key.ends_with("_share");
    if share && fits(value / 100.0) {
        format!("; it is a fraction: {value} % are {}", value / 100.0)
    } else if key.ends_with("_bar") {
        meant(&[("kPa", 100.0), ("mbar", 1000.0), ("psi", 14.503_774), ("Pa", 1e5)], "bar")
    } else if key.ends_with("_s") && !key.ends_with("_per_s") && !key.ends_with("_deg_s") && !key.ends_with("_ml_s") {
        meant(&[("ms", 1000.0)], "s")
    } else {
        String::new()
    }
}

/// What a channel can show at all, in its unit: beyond it a condition is always met or never.
fn shows(channel: Channel) -> (f64, f64) {
    match channel {
        Channel::AngleDeg => (-90.0, 90.0),
        Channel::Pressure1Bar | Channel::Pressure2Bar => (0.0, 20.0),
        Channel::TorqueNm => (-1000.0, 1000.0),
    }
}

/// A variable of a `for_each`, in one pass.
pub(crate) struct Variable {
    pub name: String,
    pub value: f64,
    pub used: Cell<bool>,
}

/// The keys that go with `fixture`.
pub(crate) struct FixtureKeys<'a> {
    pub angle_deg: Option<&'a Spanned<Quantity>>,
    pub rate_deg_s: Option<&'a Spanned<Quantity>>,
    pub pressure1_bar: Option<&'a Spanned<Quantity>>,
    pub pressure2_bar: Option<&'a Spanned<Quantity>>,
    pub release_ml_s: Option<&'a Spanned<Quantity>>,
}

impl<'a> FixtureKeys<'a> {
    pub fn named(&self) -> [(&'static str, Option<&'a Spanned<Quantity>>); 5] {
        [
            ("angle_deg", self.angle_deg),
            ("rate_deg_s", self.rate_deg_s),
            ("pressure1_bar", self.pressure1_bar),
            ("pressure2_bar", self.pressure2_bar),
            ("release_ml_s", self.release_ml_s),
        ]
    }
}

/// Turns raw values into checked numbers, with the variables in scope.
pub(crate) struct Reader<'a> {
    pub source: &'a Source<'a>,
    pub variables: &'a [Variable],
    pub prepared: &'a Prepared<'a>,
}

impl Reader<'_> {
    pub fn number(&self, key: &str, quantity: &Spanned<Quantity>) -> Result<f64, ScriptError> {
        let value = match quantity.get_ref() {
            Quantity::Number(value) => *value,
            Quantity::Variable(name) => match self.variables.iter().find(|v| v.name == *name) {
                Some(variable) => {
                    variable.used.set(true);
                    variable.value
                }
                None => {
                    let known: Vec<_> = self.variables.iter().map(|v| v.name.as_str()).collect();
                    let what = format!(
                        "`{key}` names the variable `{name}`, which no enclosing for_each sets (in scope: {})",
                        if known.is_empty() { "none".to_owned() } else { known.join(", ") }
                    );
                    return Err(self.source.error(quantity.span().start, what));
                }
            },
        };
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.source.error(quantity.span().start, format!("`{key}` must be a finite number, got {value}")))
        }
    }

    pub fn within(&self, key: &str, quantity: &Spanned<Quantity>, low: f64, high: f64) -> Result<f64, ScriptError> {
        let value = self.number(key, quantity)?;
        self.check(key, value, quantity.span().start, low, high)
    }

    fn check(&self, key: &str, value: f64, offset: usize, low: f64, high: f64) -> Result<f64, ScriptError> {
        if (low..=high).contains(&value) {
            Ok(value)
        } else {
            let remedy = remedy(key, value, low, high);
            Err(self.source.error(offset, format!("`{key}` must lie within {low} .. {high}, got {value}{remedy}")))
        }
    }

    fn angle(&self, key: &str, quantity: &Spanned<Quantity>) -> Result<f64, ScriptError> {
        self.within(key, quantity, -ANGLE_LIMIT_DEG, ANGLE_LIMIT_DEG)
    }

    pub fn pressure(&self, key: &str, quantity: &Spanned<Quantity>) -> Result<f64, ScriptError> {
        let (low, high) = Controlled::Pressure1Bar.bounds();
        self.within(key, quantity, low, high)
    }

    pub fn duration(&self, key: &str, quantity: &Spanned<Quantity>) -> Result<f64, ScriptError> {
        self.within(key, quantity, TICK_S, MAX_HOLD_S)
    }

    pub fn fixture(
        &self,
        name: FixtureName,
        place: Range<usize>,
        keys: &FixtureKeys,
    ) -> Result<FixtureChange, ScriptError> {
        let needed: &[&str] = match name {
            FixtureName::Free => &[],
            FixtureName::Clamped => &["angle_deg"],
            FixtureName::Driven => &["angle_deg", "rate_deg_s"],
            FixtureName::Filled => &["angle_deg", "pressure1_bar", "pressure2_bar"],
            FixtureName::Released => &["angle_deg", "release_ml_s"],
            FixtureName::PumpBench => &["pressure1_bar", "pressure2_bar"],
        };
        for (key, value) in keys.named() {
            if let Some(value) = value.filter(|_| !needed.contains(&key)) {
                let what = format!("the fixture `{}` has no `{key}`: remove it", name.as_str());
                return Err(self.source.error(value.span().start, what));
            }
        }
        let missing = |key: &str| {
            let what = format!("the fixture `{}` needs {}: `{key}` is missing", name.as_str(), needed.join(", "));
            self.source.error(place.start, what)
        };
        let angle = || self.angle("angle_deg", keys.angle_deg.ok_or_else(|| missing("angle_deg"))?);
        let pressure1 = || self.pressure("pressure1_bar", keys.pressure1_bar.ok_or_else(|| missing("pressure1_bar"))?);
        let pressure2 = || self.pressure("pressure2_bar", keys.pressure2_bar.ok_or_else(|| missing("pressure2_bar"))?);
        Ok(FixtureChange::To(match name {
            FixtureName::Free => Fixture::Free,
            FixtureName::Clamped => Fixture::Clamped { angle_deg: angle()? },
            FixtureName::Driven => {
                let rate = keys.rate_deg_s.ok_or_else(|| missing("rate_deg_s"))?;
                let rate_deg_s = self.within("rate_deg_s", rate, 0.01, MAX_RATE_DEG_S)?;
                return Ok(FixtureChange::Ramp { to_deg: angle()?, rate_deg_s });
            }
            FixtureName::Filled => {
                Fixture::Filled { angle_deg: angle()?, pressure1_bar: pressure1()?, pressure2_bar: pressure2()? }
            }
            FixtureName::Released => {
                let rate = keys.release_ml_s.ok_or_else(|| missing("release_ml_s"))?;
                let flow_ml_s = self.within("release_ml_s", rate, 0.0, 100.0)?;
                Fixture::Released { angle_deg: angle()?, flow_ml_s }
            }
            FixtureName::PumpBench => Fixture::PumpBench { pressure1_bar: pressure1()?, pressure2_bar: pressure2()? },
        }))
    }

    pub fn end(&self, raw: &RawStep, offset: usize) -> Result<End, ScriptError> {
        match (&raw.for_s, &raw.until, &raw.timeout_s) {
            (Some(seconds), None, None) => Ok(End::After { seconds: self.duration("for_s", seconds)? }),
            (None, Some(until), Some(timeout)) => {
                let any = self.conditions("until", until)?;
                let timeout_s = self.duration("timeout_s", timeout)?;
                if let Some(condition) = any.iter().find(|condition| condition.window_ticks() >= ticks(timeout_s)) {
                    let what = format!(
                        "`{condition}` can't be met within `timeout_s` = {timeout_s}: lengthen it, or shorten `for_s`"
                    );
                    return Err(self.source.error(timeout.span().start, what));
                }
                Ok(End::Until { any, timeout_s })
            }
            (None, Some(until), None) => {
                Err(self.source.error(until.span().start, "`until` needs a `timeout_s` beside it, got none"))
            }
            (Some(_), Some(until), _) => {
                Err(self.source.error(until.span().start, "a hold has either `for_s` or `until`, got both"))
            }
            (_, None, Some(timeout)) => {
                Err(self.source.error(timeout.span().start, "`timeout_s` belongs to `until`, which is missing"))
            }
            (None, None, None) => {
                Err(self.source.error(offset, "a hold needs `for_s`, or `until` with `timeout_s`, got neither"))
            }
        }
    }

    pub fn arrival(&self, raw: &RawStep, bound_s: f64) -> Result<End, ScriptError> {
        for (key, value) in [("for_s", &raw.for_s), ("timeout_s", &raw.timeout_s)] {
            if let Some(value) = value {
                let what = format!("a `driven` step ends when the lever has arrived: remove `{key}`");
                return Err(self.source.error(value.span().start, what));
            }
        }
        let any = raw.until.as_ref().map(|until| self.conditions("until", until)).transpose()?;
        Ok(End::Arrival { any: any.unwrap_or_default(), bound_s })
    }

    /// How a hold with `operator` ends: when that is confirmed.
    pub fn confirmed(&self, raw: &RawStep) -> Result<End, ScriptError> {
        if let Some(seconds) = &raw.for_s {
            let what = "a step with `operator` ends when it is confirmed: remove `for_s`, or give a `timeout_s`";
            return Err(self.source.error(seconds.span().start, what));
        }
        let any = raw.until.as_ref().map(|until| self.conditions("until", until)).transpose()?;
        let timeout_s = raw.timeout_s.as_ref().map(|timeout| self.duration("timeout_s", timeout)).transpose()?;
        Ok(End::Confirmed { any: any.unwrap_or_default(), timeout_s })
    }

    /// The operator's part of a hold, where it has one.
    pub fn operator(&self, raw: &RawStep) -> Result<Option<OperatorPart>, ScriptError> {
        let Some(text) = &raw.operator else {
            return match &raw.amount {
                Some(amount) => {
                    let what = "`amount` is what the operator confirms: it needs `operator` in the same step, got none";
                    Err(self.source.error(amount.span().start, what))
                }
                None => Ok(None),
            };
        };
        let said = text.get_ref().trim();
        // A journal's entry holds it, and a terminal's line.
        if said.is_empty() || said.chars().count() > MOST_SAID || said.contains(char::is_control) {
            let what = format!("`operator` must be one line of 1 .. {MOST_SAID} characters, got {said:?}");
            return Err(self.source.error(text.span().start, what));
        }
        let hands = match raw.fixture.as_ref().map(|name| *name.get_ref()) {
            // The lever is let go, or nothing is said of it: the pump may do what the script wants.
            None | Some(FixtureName::Free) => None,
            Some(name) => Some(name),
        };
        let drives = [at(&raw.voltage_v), at(&raw.voltage_u_max), at(&raw.flow_ml_s), at(&raw.target)];
        if let (Some(name), Some(drive)) = (hands, drives.into_iter().flatten().next()) {
            let what = format!(
                "a step with `operator` and the fixture `{}` has people at the rig and the pump at 0 V: remove its target",
                name.as_str()
            );
            return Err(self.source.error(drive.start, what));
        }
        let amount = raw.amount.as_ref().map(|amount| match amount.get_ref() {
            AmountName::VolumeMl => Amount::VolumeMl,
        });
        Ok(Some(OperatorPart { text: said.to_owned(), amount }))
    }

    pub fn conditions(
        &self,
        key: &str,
        raw: &Spanned<Vec<Spanned<RawCondition>>>,
    ) -> Result<Vec<Condition>, ScriptError> {
        if raw.get_ref().is_empty() {
            return Err(self.source.error(raw.span().start, format!("`{key}` needs at least one condition, got none")));
        }
        raw.get_ref().iter().map(|condition| self.condition(key, condition)).collect()
    }

    fn condition(&self, key: &str, raw: &Spanned<RawCondition>) -> Result<Condition, ScriptError> {
        let RawCondition { channel, above, below, rate_below, window_s, steady_within, for_s } = raw.get_ref();
        let (low, high) = shows(*channel);
        // In the words of the channel, so that the remedy knows its unit.
        let limit_of = |side: &str, value: &Spanned<Quantity>| {
            let limit = self.number(side, value)?;
            self.check(&format!("{side} of {}", channel.as_str()), limit, value.span().start, low, high)
        };
        let limit = match (above, below, rate_below, window_s, steady_within, for_s) {
            (Some(limit), None, None, None, None, None) => Limit::Above(limit_of("above", limit)?),
            (None, Some(limit), None, None, None, None) => Limit::Below(limit_of("below", limit)?),
            // A rate and a spread need ticks to be seen; `stop_when` looks at one.
            (None, None, Some(rate), Some(window), None, None) if key == "until" => Limit::RateBelow {
                per_s: self.within("rate_below", rate, 1e-9, 1e9)?,
                window_s: self.duration("window_s", window)?,
            },
            (None, None, None, None, Some(spread), Some(window)) if key == "until" => Limit::SteadyWithin {
                spread: self.within("steady_within", spread, 1e-9, high - low)?,
                ticks: ticks(self.within("for_s", window, TICK_S, MOST_STEADY_S)?),
            },
            _ => {
                let more = if key == "until" {
                    ", `rate_below` with `window_s`, and `steady_within` with `for_s`"
                } else {
                    ""
                };
                let what = format!("a condition of `{key}` needs exactly one of `above` and `below`{more}");
                return Err(self.source.error(raw.span().start, what));
            }
        };
        Ok(Condition::new(*channel, limit))
    }

    pub fn random(&self, raw: &RawRandom) -> Result<RandomSteps, ScriptError> {
        let pair = |key: &str, value: &Spanned<[f64; 2]>, low: f64, high: f64| {
            let [from, to] = *value.get_ref();
            if from.is_finite() && to.is_finite() && low <= from && from <= to && to <= high {
                return Ok([from, to]);
            }
            let what = format!("`{key}` must be [smallest, largest] within {low} .. {high}, got [{from}, {to}]");
            Err(self.source.error(value.span().start, what))
        };
        let share = |key: &str, value: &Spanned<f64>| self.check(key, *value.get_ref(), value.span().start, 0.0, 1.0);
        let steps = RandomSteps {
            total_s: self.duration("total_s", &raw.total_s)?,
            length_s: pair("length_s", &raw.length_s, 0.01, MAX_HOLD_S)?,
            voltage_u_max: pair("voltage_u_max", &raw.voltage_u_max, 0.0, 1.0)?,
            zero_share: share("zero_share", &raw.zero_share)?,
            brake_closed_share: share("brake_closed_share", &raw.brake_closed_share)?,
            bypass_open_share: share("bypass_open_share", &raw.bypass_open_share)?,
            guard_deg: self.within("guard_deg", &raw.guard_deg, 1.0, ANGLE_LIMIT_DEG)?,
        };
        let valves = steps.brake_closed_share + steps.bypass_open_share;
        self.check("brake_closed_share + bypass_open_share", valves, raw.bypass_open_share.span().start, 0.0, 1.0)?;
        Ok(steps)
    }
}
