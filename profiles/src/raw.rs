//! The shape of a script as TOML, before any meaning is given to it. Every value keeps its place in the text.

use crate::condition::Channel;
use crate::controlled::Controlled;
use crate::fault::RawFault;
use crate::script::{Plane, Protocol, Role};
use crate::signal::Sweep;
use crate::table::Interpolation;
use serde::Deserialize;
use serde::de::{self, Visitor};
use std::collections::BTreeMap;
use std::ops::Range;
use toml::Spanned;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawScript {
    pub name: Spanned<String>,
    pub protocol: Protocol,
    pub role: Role,
    pub plane: Plane,
    pub about: Option<String>,
    pub overrun: Option<Spanned<String>>,
    pub files: Option<BTreeMap<String, String>>,
    pub start: Spanned<RawStart>,
    pub envelope: Option<Spanned<RawEnvelope>>,
    #[serde(default)]
    pub step: Vec<Spanned<RawStep>>,
    #[serde(default)]
    pub fault: Vec<Spanned<RawFault>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawStart {
    pub fixture: Spanned<FixtureName>,
    pub brake: Valve,
    pub bypass: Valve,
    pub fill_bar: Option<Spanned<Quantity>>,
    pub angle_deg: Option<Spanned<Quantity>>,
    pub pressure1_bar: Option<Spanned<Quantity>>,
    pub pressure2_bar: Option<Spanned<Quantity>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawEnvelope {
    pub pressure_min_bar: Option<Spanned<Quantity>>,
    pub pressure_max_bar: Option<Spanned<Quantity>>,
    pub angle_max_deg: Option<Spanned<Quantity>>,
    pub velocity_max_deg_s: Option<Spanned<Quantity>>,
    pub torque_max_nm: Option<Spanned<Quantity>>,
    pub voltage_max_v: Option<Spanned<Quantity>>,
}

/// The values of a `for_each` by variable.
pub(crate) type Lists = BTreeMap<String, Spanned<RawValues>>;

/// What a variable of a `for_each` walks through.
pub(crate) enum RawValues {
    List(Vec<Spanned<f64>>),
    Range(RawRange),
}

/// Values at equal distances, both ends included.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawRange {
    pub from: Spanned<Quantity>,
    pub to: Spanned<Quantity>,
    pub step: Option<Spanned<Quantity>>,
    pub count: Option<Spanned<u32>>,
}

impl<'de> Deserialize<'de> for RawValues {
    fn deserialize<D: de::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ValuesVisitor;
        impl<'de> Visitor<'de> for ValuesVisitor {
            type Value = RawValues;
            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("a list of numbers, or { from = A, to = B } with `step` or `count`")
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, mut seq: A) -> Result<RawValues, A::Error> {
                let mut list = Vec::new();
                while let Some(value) = seq.next_element()? {
                    list.push(value);
                }
                Ok(RawValues::List(list))
            }
            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<RawValues, A::Error> {
                RawRange::deserialize(de::value::MapAccessDeserializer::new(map)).map(RawValues::Range)
            }
        }
        deserializer.deserialize_any(ValuesVisitor)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawStep {
    pub for_each: Option<Spanned<Lists>>,
    pub repeat: Option<Spanned<u32>>,
    pub stop_when: Option<Spanned<Vec<Spanned<RawCondition>>>>,
    pub step: Option<Vec<Spanned<RawStep>>>,
    pub random: Option<Spanned<RawRandom>>,
    pub voltage_v: Option<Spanned<Quantity>>,
    pub voltage_u_max: Option<Spanned<Quantity>>,
    pub flow_ml_s: Option<Spanned<Quantity>>,
    pub target: Option<Spanned<RawTarget>>,
    pub brake: Option<Spanned<Valve>>,
    pub bypass: Option<Spanned<Valve>>,
    pub fixture: Option<Spanned<FixtureName>>,
    pub angle_deg: Option<Spanned<Quantity>>,
    pub rate_deg_s: Option<Spanned<Quantity>>,
    pub pressure1_bar: Option<Spanned<Quantity>>,
    pub pressure2_bar: Option<Spanned<Quantity>>,
    pub release_ml_s: Option<Spanned<Quantity>>,
    pub operator: Option<Spanned<String>>,
    pub amount: Option<Spanned<AmountName>>,
    pub for_s: Option<Spanned<Quantity>>,
    pub until: Option<Spanned<Vec<Spanned<RawCondition>>>>,
    pub timeout_s: Option<Spanned<Quantity>>,
    pub new_segment: Option<Spanned<bool>>,
}

pub(crate) fn at<T>(value: &Option<Spanned<T>>) -> Option<Range<usize>> {
    value.as_ref().map(Spanned::span)
}

impl RawStep {
    /// The keys of a hold that this step carries, with their places.
    pub fn hold_keys(&self) -> impl Iterator<Item = (&'static str, Range<usize>)> {
        [
            ("voltage_v", at(&self.voltage_v)),
            ("voltage_u_max", at(&self.voltage_u_max)),
            ("flow_ml_s", at(&self.flow_ml_s)),
            ("target", at(&self.target)),
            ("brake", at(&self.brake)),
            ("bypass", at(&self.bypass)),
            ("fixture", at(&self.fixture)),
            ("angle_deg", at(&self.angle_deg)),
            ("rate_deg_s", at(&self.rate_deg_s)),
            ("pressure1_bar", at(&self.pressure1_bar)),
            ("pressure2_bar", at(&self.pressure2_bar)),
            ("release_ml_s", at(&self.release_ml_s)),
            ("operator", at(&self.operator)),
            ("amount", at(&self.amount)),
            ("for_s", at(&self.for_s)),
            ("until", at(&self.until)),
            ("timeout_s", at(&self.timeout_s)),
            ("new_segment", at(&self.new_segment)),
        ]
        .into_iter()
        .filter_map(|(name, span)| span.map(|span| (name, span)))
    }
}

/// Either one quantity with its value, or `quantity` and `wave` with the wave's keys.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawTarget {
    pub voltage_v: Option<Spanned<Quantity>>,
    pub voltage_u_max: Option<Spanned<Quantity>>,
    pub flow_ml_s: Option<Spanned<Quantity>>,
    pub pressure1_bar: Option<Spanned<Quantity>>,
    pub pressure2_bar: Option<Spanned<Quantity>>,
    pub pressure_difference_bar: Option<Spanned<Quantity>>,
    pub angle_deg: Option<Spanned<Quantity>>,
    pub quantity: Option<Controlled>,
    pub wave: Option<WaveName>,
    pub value: Option<Spanned<Quantity>>,
    pub from: Option<Spanned<Quantity>>,
    pub to: Option<Spanned<Quantity>>,
    pub rate_per_s: Option<Spanned<Quantity>>,
    pub mean: Option<Spanned<Quantity>>,
    pub amplitude: Option<Spanned<Quantity>>,
    pub frequency_hz: Option<Spanned<Quantity>>,
    pub phase_deg: Option<Spanned<Quantity>>,
    pub from_hz: Option<Spanned<Quantity>>,
    pub to_hz: Option<Spanned<Quantity>>,
    pub sweep: Option<Spanned<Sweep>>,
    pub frequencies_hz: Option<Spanned<Vec<Spanned<Quantity>>>>,
    pub band_hz: Option<Spanned<[Spanned<Quantity>; 2]>>,
    pub period_s: Option<Spanned<Quantity>>,
    pub range: Option<Spanned<[Spanned<Quantity>; 2]>>,
    pub length_s: Option<Spanned<[Spanned<Quantity>; 2]>>,
    pub file: Option<Spanned<String>>,
    pub interpolation: Option<Spanned<Interpolation>>,
}

impl RawTarget {
    /// The quantities that are given a value.
    pub fn constants(&self) -> impl Iterator<Item = (Controlled, &Spanned<Quantity>)> {
        [
            (Controlled::VoltageV, &self.voltage_v),
            (Controlled::VoltageUMax, &self.voltage_u_max),
            (Controlled::FlowMlS, &self.flow_ml_s),
            (Controlled::Pressure1Bar, &self.pressure1_bar),
            (Controlled::Pressure2Bar, &self.pressure2_bar),
            (Controlled::PressureDifferenceBar, &self.pressure_difference_bar),
            (Controlled::AngleDeg, &self.angle_deg),
        ]
        .into_iter()
        .filter_map(|(quantity, value)| value.as_ref().map(|value| (quantity, value)))
    }

    /// The keys of a wave that this target carries, with their places.
    pub fn wave_keys(&self) -> impl Iterator<Item = (&'static str, Range<usize>)> {
        [
            ("value", at(&self.value)),
            ("from", at(&self.from)),
            ("to", at(&self.to)),
            ("rate_per_s", at(&self.rate_per_s)),
            ("mean", at(&self.mean)),
            ("amplitude", at(&self.amplitude)),
            ("frequency_hz", at(&self.frequency_hz)),
            ("phase_deg", at(&self.phase_deg)),
            ("from_hz", at(&self.from_hz)),
            ("to_hz", at(&self.to_hz)),
            ("sweep", at(&self.sweep)),
            ("frequencies_hz", at(&self.frequencies_hz)),
            ("band_hz", at(&self.band_hz)),
            ("period_s", at(&self.period_s)),
            ("range", at(&self.range)),
            ("length_s", at(&self.length_s)),
            ("file", at(&self.file)),
            ("interpolation", at(&self.interpolation)),
        ]
        .into_iter()
        .filter_map(|(name, span)| span.map(|span| (name, span)))
    }
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum WaveName {
    Step,
    Ramp,
    Sine,
    Chirp,
    Multisine,
    RandomSteps,
    File,
}

impl WaveName {
    #[cfg(test)]
    pub const ALL: [WaveName; 7] = [
        WaveName::Step,
        WaveName::Ramp,
        WaveName::Sine,
        WaveName::Chirp,
        WaveName::Multisine,
        WaveName::RandomSteps,
        WaveName::File,
    ];

    pub fn as_str(self) -> &'static str {
        match self {
            WaveName::Step => "step",
            WaveName::Ramp => "ramp",
            WaveName::Sine => "sine",
            WaveName::Chirp => "chirp",
            WaveName::Multisine => "multisine",
            WaveName::RandomSteps => "random-steps",
            WaveName::File => "file",
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawRandom {
    pub total_s: Spanned<Quantity>,
    pub length_s: Spanned<[f64; 2]>,
    pub voltage_u_max: Spanned<[f64; 2]>,
    pub zero_share: Spanned<f64>,
    pub brake_closed_share: Spanned<f64>,
    pub bypass_open_share: Spanned<f64>,
    pub guard_deg: Spanned<Quantity>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawCondition {
    pub channel: Channel,
    pub above: Option<Spanned<Quantity>>,
    pub below: Option<Spanned<Quantity>>,
    pub rate_below: Option<Spanned<Quantity>>,
    pub window_s: Option<Spanned<Quantity>>,
    pub steady_within: Option<Spanned<Quantity>>,
    pub for_s: Option<Spanned<Quantity>>,
}

#[derive(Clone, Copy, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Valve {
    Open,
    Closed,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum FixtureName {
    Free,
    Clamped,
    Driven,
    Filled,
    Released,
    PumpBench,
}

impl FixtureName {
    pub fn as_str(self) -> &'static str {
        match self {
            FixtureName::Free => "free",
            FixtureName::Clamped => "clamped",
            FixtureName::Driven => "driven",
            FixtureName::Filled => "filled",
            FixtureName::Released => "released",
            FixtureName::PumpBench => "pump-bench",
        }
    }
}

/// The number that an operator's confirmation must bring.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub(crate) enum AmountName {
    VolumeMl,
}

/// A number, or a variable of an enclosing `for_each` (`"$name"`).
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Quantity {
    Number(f64),
    Variable(String),
}

impl<'de> Deserialize<'de> for Quantity {
    fn deserialize<D: de::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct QuantityVisitor;
        impl Visitor<'_> for QuantityVisitor {
            type Value = Quantity;
            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("a number, or \"$name\" of a for_each variable")
            }
            fn visit_f64<E: de::Error>(self, value: f64) -> Result<Quantity, E> {
                Ok(Quantity::Number(value))
            }
            fn visit_i64<E: de::Error>(self, value: i64) -> Result<Quantity, E> {
                Ok(Quantity::Number(value as f64))
            }
            fn visit_str<E: de::Error>(self, value: &str) -> Result<Quantity, E> {
                match value.strip_prefix('$') {
                    Some(name) if !name.is_empty() => Ok(Quantity::Variable(name.to_owned())),
                    _ => Err(E::invalid_value(de::Unexpected::Str(value), &self)),
                }
            }
        }
        deserializer.deserialize_any(QuantityVisitor)
    }
}
