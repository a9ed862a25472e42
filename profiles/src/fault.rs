//! `[[fault]]`: what is made to go wrong in the run. No part of what is driven: a replay has it in its recorded inputs.

use crate::error::ScriptError;
use crate::raw::{Quantity, Valve, at};
use crate::values::{MAX_HOLD_S, Reader, TICK_S, ticks};
use rt_core::fault::{
    self, AMPLIFIER_TIMEOUT_TICKS, Fault, FaultKind, MOST_DELAY_TICKS, MOST_FAULTS, NODE_TIMEOUT_TICKS, RAW_BITS, Route,
};
use rt_core::{Input, PERIOD_NS};
use serde::Deserialize;
use std::ops::Range;
use toml::Spanned;

/// Longest time-out of an amplifier or a node, ms.
const MOST_TIMEOUT_MS: f64 = 10_000.0;
/// Fastest drift, units of the input a second.
const MOST_DRIFT_PER_S: f64 = 1e4;
/// Most of a raw value's range, in the unit of the input.
const MOST_RANGE: f64 = 1e6;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawFault {
    pub kind: Spanned<FaultName>,
    pub at_s: Spanned<Quantity>,
    pub for_s: Option<Spanned<Quantity>>,
    pub input: Option<Spanned<InputName>>,
    pub output: Option<Spanned<OutputName>>,
    pub valve: Option<Spanned<ValveName>>,
    pub probability: Option<Spanned<Quantity>>,
    pub delay_ms: Option<Spanned<Quantity>>,
    pub unnoticed: Option<Spanned<bool>>,
    pub bit: Option<Spanned<u8>>,
    pub range: Option<Spanned<[Spanned<Quantity>; 2]>>,
    pub rate_per_s: Option<Spanned<Quantity>>,
    pub timeout_ms: Option<Spanned<Quantity>>,
    pub code: Option<Spanned<u16>>,
    pub stands: Option<Spanned<Valve>>,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum FaultName {
    Lost,
    Late,
    Repeated,
    Swapped,
    BitFlip,
    CrcError,
    Stuck,
    Drift,
    Nan,
    PortGone,
    BusOff,
    AmplifierFault,
    ValveStuck,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub(crate) enum InputName {
    AngleDeg,
    Pressure1Bar,
    Pressure2Bar,
    TorqueNm,
    VolumeMl,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub(crate) enum OutputName {
    Voltage,
    Valves,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub(crate) enum ValveName {
    Brake,
    Bypass,
}

impl FaultName {
    #[cfg(test)]
    pub const ALL: [FaultName; 13] = [
        FaultName::Lost,
        FaultName::Late,
        FaultName::Repeated,
        FaultName::Swapped,
        FaultName::BitFlip,
        FaultName::CrcError,
        FaultName::Stuck,
        FaultName::Drift,
        FaultName::Nan,
        FaultName::PortGone,
        FaultName::BusOff,
        FaultName::AmplifierFault,
        FaultName::ValveStuck,
    ];

    /// The keys that it needs, and those that it can have, beside `kind`, `at_s` and `for_s`.
    pub fn keys(self) -> (&'static [&'static str], &'static [&'static str]) {
        match self {
            FaultName::Lost => (&[], &["input", "output", "probability", "timeout_ms"]),
            FaultName::Late => (&["delay_ms"], &["input", "output", "probability", "unnoticed", "timeout_ms"]),
            FaultName::Repeated | FaultName::Swapped => (&["input"], &["probability", "unnoticed"]),
            FaultName::BitFlip => (&["input"], &["probability", "bit", "range"]),
            FaultName::CrcError | FaultName::Nan => (&["input"], &["probability"]),
            FaultName::Stuck => (&["input"], &[]),
            FaultName::Drift => (&["input", "rate_per_s"], &[]),
            FaultName::PortGone | FaultName::BusOff => (&[], &["timeout_ms"]),
            FaultName::AmplifierFault => (&["code"], &[]),
            FaultName::ValveStuck => (&["valve"], &["stands"]),
        }
    }

    pub fn as_str(self) -> &'static str {
        match self {
            FaultName::Lost => "lost",
            FaultName::Late => "late",
            FaultName::Repeated => "repeated",
            FaultName::Swapped => "swapped",
            FaultName::BitFlip => "bit-flip",
            FaultName::CrcError => "crc-error",
            FaultName::Stuck => "stuck",
            FaultName::Drift => "drift",
            FaultName::Nan => "nan",
            FaultName::PortGone => "port-gone",
            FaultName::BusOff => "bus-off",
            FaultName::AmplifierFault => "amplifier-fault",
            FaultName::ValveStuck => "valve-stuck",
        }
    }
}

impl InputName {
    fn input(self) -> Input {
        match self {
            InputName::AngleDeg => Input::Angle,
            InputName::Pressure1Bar => Input::Pressure1,
            InputName::Pressure2Bar => Input::Pressure2,
            InputName::TorqueNm => Input::Torque,
            InputName::VolumeMl => Input::Volume,
        }
    }
}

impl RawFault {
    /// The keys that this fault carries beside those that every fault has, with their places.
    fn keys(&self) -> impl Iterator<Item = (&'static str, Range<usize>)> {
        [
            ("input", at(&self.input)),
            ("output", at(&self.output)),
            ("valve", at(&self.valve)),
            ("probability", at(&self.probability)),
            ("delay_ms", at(&self.delay_ms)),
            ("unnoticed", at(&self.unnoticed)),
            ("bit", at(&self.bit)),
            ("range", at(&self.range)),
            ("rate_per_s", at(&self.rate_per_s)),
            ("timeout_ms", at(&self.timeout_ms)),
            ("code", at(&self.code)),
            ("stands", at(&self.stands)),
        ]
        .into_iter()
        .filter_map(|(name, span)| span.map(|span| (name, span)))
    }
}

/// Checks the faults of a script; `reader` has no variables, as no loop encloses them.
pub(crate) fn faults(raw: &[Spanned<RawFault>], reader: &Reader) -> Result<Vec<Fault>, ScriptError> {
    if let Some(beyond) = raw.get(MOST_FAULTS) {
        let what = format!("a script has at most {MOST_FAULTS} faults, got {}", raw.len());
        return Err(reader.source.error(beyond.span().start, what));
    }
    raw.iter().map(|fault| one(fault.get_ref(), reader)).collect()
}

fn one(raw: &RawFault, reader: &Reader) -> Result<Fault, ScriptError> {
    let name = *raw.kind.get_ref();
    let place = raw.kind.span().start;
    let (needed, allowed) = name.keys();
    for (key, span) in raw.keys() {
        if !needed.contains(&key) && !allowed.contains(&key) {
            let what = format!("the fault `{}` has no `{key}`: remove it", name.as_str());
            return Err(reader.source.error(span.start, what));
        }
    }
    let missing = |key: &str| {
        let what = format!("the fault `{}` needs {}: `{key}` is missing", name.as_str(), needed.join(", "));
        reader.source.error(place, what)
    };
    let input = || raw.input.as_ref().map(|name| name.get_ref().input()).ok_or_else(|| missing("input"));
    let unnoticed = raw.unnoticed.as_ref().is_some_and(|value| *value.get_ref());
    let kind = match name {
        FaultName::Lost => FaultKind::Lost { route: route(raw, reader)? },
        FaultName::Late => {
            let route = route(raw, reader)?;
            if let (Some(value), false) = (&raw.unnoticed, matches!(route, Route::Input(_))) {
                let what = "`unnoticed` belongs to `input`; the rig hears commands by their counter: remove it";
                return Err(reader.source.error(value.span().start, what));
            }
            let delay = raw.delay_ms.as_ref().ok_or_else(|| missing("delay_ms"))?;
            let ticks = in_ticks(reader, "delay_ms", delay, f64::from(MOST_DELAY_TICKS) * TICK_S * 1e3)?;
            FaultKind::Late { route, ticks, unnoticed }
        }
        FaultName::Repeated => FaultKind::Repeated { input: input()?, unnoticed },
        FaultName::Swapped => FaultKind::Swapped { input: input()?, unnoticed },
        FaultName::BitFlip => {
            let input = input()?;
            let (low, high) = range(raw, input, reader)?;
            FaultKind::BitFlip { input, bit: bit(raw, reader)?, low, high }
        }
        FaultName::CrcError => FaultKind::CrcError { input: input()? },
        FaultName::Stuck => FaultKind::Stuck { input: input()? },
        FaultName::Drift => {
            let input = input()?;
            let rate = raw.rate_per_s.as_ref().ok_or_else(|| missing("rate_per_s"))?;
            let per_s = reader.within("rate_per_s", rate, -MOST_DRIFT_PER_S, MOST_DRIFT_PER_S)?;
            if per_s == 0.0 {
                return Err(reader.source.error(rate.span().start, "`rate_per_s` must not be 0: nothing would drift"));
            }
            FaultKind::Drift { input, per_s }
        }
        FaultName::Nan => FaultKind::Nan { input: input()? },
        FaultName::PortGone => FaultKind::PortGone { timeout_ticks: timeout(raw, reader, AMPLIFIER_TIMEOUT_TICKS)? },
        FaultName::BusOff => FaultKind::BusOff { timeout_ticks: timeout(raw, reader, NODE_TIMEOUT_TICKS)? },
        FaultName::AmplifierFault => {
            FaultKind::AmplifierFault { code: *raw.code.as_ref().ok_or_else(|| missing("code"))?.get_ref() }
        }
        FaultName::ValveStuck => {
            let valve = match raw.valve.as_ref().ok_or_else(|| missing("valve"))?.get_ref() {
                ValveName::Brake => fault::Valve::Brake,
                ValveName::Bypass => fault::Valve::Bypass,
            };
            FaultKind::ValveStuck { valve, open: raw.stands.as_ref().map(|stands| *stands.get_ref() == Valve::Open) }
        }
    };
    let share = |value| {
        let share = reader.within("probability", value, 0.0, 1.0)?;
        if share > 0.0 {
            return Ok(share);
        }
        Err(reader.source.error(value.span().start, "`probability` must be above 0: the fault would never strike"))
    };
    let probability = raw.probability.as_ref().map_or(Ok(1.0), share)?;
    let at_s = reader.within("at_s", &raw.at_s, 0.0, MAX_HOLD_S)?;
    let from_tick = (at_s * 1e9 / PERIOD_NS as f64).round() as u64;
    let length = raw.for_s.as_ref().map(|value| reader.duration("for_s", value)).transpose()?;
    Ok(Fault { kind, from_tick, ticks: length.map(ticks), probability })
}

/// What is lost or late: one input or one output.
fn route(raw: &RawFault, reader: &Reader) -> Result<Route, ScriptError> {
    match (&raw.input, &raw.output) {
        (Some(input), None) => match &raw.timeout_ms {
            None => Ok(Route::Input(input.get_ref().input())),
            Some(timeout) => {
                let what = "`timeout_ms` belongs to `output`: it is the rig that times out";
                Err(reader.source.error(timeout.span().start, what))
            }
        },
        (None, Some(output)) => Ok(match output.get_ref() {
            OutputName::Voltage => Route::Voltage { timeout_ticks: timeout(raw, reader, AMPLIFIER_TIMEOUT_TICKS)? },
            OutputName::Valves => Route::Valves { timeout_ticks: timeout(raw, reader, NODE_TIMEOUT_TICKS)? },
        }),
        (input, output) => {
            let got = if input.is_some() && output.is_some() { "both" } else { "neither" };
            let what =
                format!("the fault `{}` hits either an `input` or an `output`, got {got}", raw.kind.get_ref().as_str());
            Err(reader.source.error(raw.kind.span().start, what))
        }
    }
}

fn timeout(raw: &RawFault, reader: &Reader, otherwise: u32) -> Result<u32, ScriptError> {
    raw.timeout_ms.as_ref().map_or(Ok(otherwise), |value| in_ticks(reader, "timeout_ms", value, MOST_TIMEOUT_MS))
}

fn in_ticks(reader: &Reader, key: &str, value: &Spanned<Quantity>, most_ms: f64) -> Result<u32, ScriptError> {
    let ms = reader.within(key, value, TICK_S * 1e3, most_ms)?;
    // Within 1 ..= 10,000, as checked.
    Ok(ticks(ms * 1e-3) as u32)
}

fn bit(raw: &RawFault, reader: &Reader) -> Result<Option<u8>, ScriptError> {
    match &raw.bit {
        Some(bit) if *bit.get_ref() >= RAW_BITS => {
            let what = format!("`bit` must lie within 0 .. {}, got {}", RAW_BITS - 1, bit.get_ref());
            Err(reader.source.error(bit.span().start, what))
        }
        bit => Ok(bit.as_ref().map(|bit| *bit.get_ref())),
    }
}

fn range(raw: &RawFault, input: Input, reader: &Reader) -> Result<(f64, f64), ScriptError> {
    let Some(range) = &raw.range else { return Ok(fault::full_scale(input)) };
    let [low, high] = range.get_ref();
    let (from, to) =
        (reader.within("range", low, -MOST_RANGE, MOST_RANGE)?, reader.within("range", high, -MOST_RANGE, MOST_RANGE)?);
    if from < to {
        return Ok((from, to));
    }
    let what = format!("`range` must be [value at raw 0, larger value at raw 65535], got [{from}, {to}]");
    Err(reader.source.error(range.span().start, what))
}
