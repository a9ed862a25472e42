//! A script in words, step by step as it is written: loops are not unrolled.

use crate::condition::Channel;
use crate::raw::{
    FixtureName, Quantity, RawCondition, RawRandom, RawScript, RawStart, RawStep, RawTarget, RawValues, Valve, WaveName,
};
use crate::script::Script;
use std::fmt::Write;
use toml::Spanned;

/// A row of an outline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutlineRow {
    /// Line of the script where the step begins, from 1.
    pub line: usize,
    /// Loops around it.
    pub depth: usize,
    /// What is done, or how often the rows below are.
    pub what: String,
    /// When it ends; empty for a loop.
    pub ends: String,
    /// What the operator is asked for in the script's own words; empty where nothing is.
    pub operator: String,
}

impl Script {
    /// The script in words: the start, then its steps as they are written.
    pub fn outline(&self) -> Vec<OutlineRow> {
        // The text was read once before; where it could not be, there would be no script.
        let Ok(raw) = toml::from_str::<RawScript>(&self.text) else { return Vec::new() };
        let mut outline = Outline { text: &self.text, rows: Vec::new() };
        outline.start(&raw.start);
        outline.steps(&raw.step, 0);
        outline.rows
    }
}

struct Outline<'a> {
    text: &'a str,
    rows: Vec<OutlineRow>,
}

impl Outline<'_> {
    fn row(&mut self, offset: usize, depth: usize, what: String, ends: String) {
        let before = &self.text.as_bytes()[..offset.min(self.text.len())];
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        self.rows.push(OutlineRow { line, depth, what, ends, operator: String::new() });
    }

    fn start(&mut self, start: &Spanned<RawStart>) {
        let RawStart { fixture, brake, bypass, fill_bar, angle_deg, pressure1_bar, pressure2_bar } = start.get_ref();
        let mut parts =
            vec![fixture_words(*fixture.get_ref(), [angle_deg, &None, pressure1_bar, pressure2_bar, &None])];
        parts.push(format!("brake {}", valve(*brake)));
        parts.push(format!("bypass {}", valve(*bypass)));
        parts.extend(fill_bar.as_ref().map(|bar| format!("both chambers at {} bar", said(bar))));
        self.row(start.span().start, 0, format!("start: {}", parts.join(", ")), String::new());
    }

    fn steps(&mut self, steps: &[Spanned<RawStep>], depth: usize) {
        for step in steps {
            let raw = step.get_ref();
            let offset = step.span().start;
            if let Some(lists) = &raw.for_each {
                let walked: Vec<String> = lists
                    .get_ref()
                    .iter()
                    .map(|(name, values)| format!("{name} {}", values_words(values.get_ref())))
                    .collect();
                self.row(offset, depth, format!("for each {}", walked.join(", with ")), String::new());
            } else if let Some(times) = &raw.repeat {
                let stop =
                    raw.stop_when.as_ref().map_or(String::new(), |stop| format!(", unless {}", any_of(stop.get_ref())));
                self.row(offset, depth, format!("repeat {} times{stop}", times.get_ref()), String::new());
            } else if let Some(random) = &raw.random {
                let (what, ends) = random_words(random.get_ref());
                self.row(offset, depth, what, ends);
            } else {
                self.row(offset, depth, hold_words(raw), ends_words(raw));
                if let (Some(row), Some(text)) = (self.rows.last_mut(), &raw.operator) {
                    row.operator = text.get_ref().trim().to_owned();
                }
            }
            self.steps(raw.step.as_deref().unwrap_or_default(), depth + 1);
        }
    }
}

fn said(value: &Spanned<Quantity>) -> String {
    match value.get_ref() {
        Quantity::Number(number) => number.to_string(),
        Quantity::Variable(name) => format!("${name}"),
    }
}

/// With this unit, where it is said at all.
fn unit(value: &Option<Spanned<Quantity>>, unit: &str) -> String {
    value.as_ref().map_or_else(|| format!("? {unit}"), |value| format!("{} {unit}", said(value)))
}

fn valve(valve: Valve) -> &'static str {
    if valve == Valve::Open { "open" } else { "closed" }
}

fn values_words(values: &RawValues) -> String {
    match values {
        RawValues::List(list) => {
            let words: Vec<String> = list.iter().map(|value| value.get_ref().to_string()).collect();
            match words.as_slice() {
                [first, .., last] if words.len() > 8 => format!("= {first} .. {last} ({} values)", words.len()),
                _ => format!("= {}", words.join(", ")),
            }
        }
        RawValues::Range(range) => {
            let (from, to) = (said(&range.from), said(&range.to));
            match (&range.step, &range.count) {
                (Some(step), _) => format!("= {from} .. {to} by {}", said(step)),
                (None, Some(count)) => format!("= {from} .. {to} ({} values)", count.get_ref()),
                (None, None) => format!("= {from} .. {to}"),
            }
        }
    }
}

/// `numbers`: angle, rate, both pressures, release.
fn fixture_words(name: FixtureName, numbers: [&Option<Spanned<Quantity>>; 5]) -> String {
    let [angle_deg, rate_deg_s, pressure1_bar, pressure2_bar, release_ml_s] = numbers;
    let angle = unit(angle_deg, "deg");
    let both = || format!("{} and {}", unit(pressure1_bar, "bar"), unit(pressure2_bar, "bar"));
    match name {
        FixtureName::Free => "lever free".to_owned(),
        FixtureName::Clamped => format!("lever clamped at {angle}"),
        FixtureName::Driven => format!("lever led to {angle} at {}", unit(rate_deg_s, "deg/s")),
        FixtureName::Filled => format!("lever held at {angle}, chambers filled to {}", both()),
        FixtureName::Released => {
            format!("lever held at {angle}, oil released from chamber 1 at {}", unit(release_ml_s, "ml/s"))
        }
        FixtureName::PumpBench => format!("pump alone between {}", both()),
    }
}

fn hold_words(raw: &RawStep) -> String {
    let drives = [(&raw.voltage_v, "V"), (&raw.voltage_u_max, "u_max"), (&raw.flow_ml_s, "ml/s")];
    let mut parts: Vec<String> = drives
        .into_iter()
        .filter_map(|(value, unit)| value.as_ref().map(|value| format!("{} {unit}", said(value))))
        .collect();
    parts.extend(raw.target.as_ref().map(|target| target_words(target.get_ref())));
    parts.extend(raw.brake.as_ref().map(|state| format!("brake {}", valve(*state.get_ref()))));
    parts.extend(raw.bypass.as_ref().map(|state| format!("bypass {}", valve(*state.get_ref()))));
    let numbers = [&raw.angle_deg, &raw.rate_deg_s, &raw.pressure1_bar, &raw.pressure2_bar, &raw.release_ml_s];
    parts.extend(raw.fixture.as_ref().map(|name| fixture_words(*name.get_ref(), numbers)));
    if parts.is_empty() { "as before".to_owned() } else { parts.join(", ") }
}

fn target_words(raw: &RawTarget) -> String {
    if let Some((quantity, value)) = raw.constants().next() {
        return format!("{} = {}", quantity.as_str(), said(value));
    }
    let (Some(quantity), Some(name)) = (raw.quantity, raw.wave) else { return "target".to_owned() };
    let pair = |pair: &Option<Spanned<[Spanned<Quantity>; 2]>>| {
        pair.as_ref().map_or_else(String::new, |pair| {
            let [low, high] = pair.get_ref();
            format!("{} .. {}", said(low), said(high))
        })
    };
    let of = |value: &Option<Spanned<Quantity>>| value.as_ref().map_or_else(|| "?".to_owned(), said);
    let mean = raw.mean.as_ref().map_or_else(String::new, |mean| format!(" about {}", said(mean)));
    let wave = match name {
        WaveName::Step => format!("= {}", of(&raw.value)),
        WaveName::Ramp => {
            let from = raw.from.as_ref().map_or_else(String::new, |from| format!("from {} ", said(from)));
            let rate = raw.rate_per_s.as_ref().map_or_else(String::new, |rate| format!(" at {} a second", said(rate)));
            format!("ramp {from}to {}{rate}", of(&raw.to))
        }
        WaveName::Sine => format!("sine of {}{mean}, {} Hz", of(&raw.amplitude), of(&raw.frequency_hz)),
        WaveName::Chirp => {
            format!("chirp of {}{mean}, {} .. {} Hz", of(&raw.amplitude), of(&raw.from_hz), of(&raw.to_hz))
        }
        WaveName::Multisine => match &raw.frequencies_hz {
            Some(list) => format!("multisine of {}{mean}, {} frequencies", of(&raw.amplitude), list.get_ref().len()),
            None => format!("multisine of {}{mean}, {} Hz", of(&raw.amplitude), pair(&raw.band_hz)),
        },
        WaveName::RandomSteps => format!("random steps within {}, each {} s", pair(&raw.range), pair(&raw.length_s)),
        WaveName::File => format!("table {}", raw.file.as_ref().map_or("?", |file| file.get_ref().as_str())),
    };
    format!("{} {wave}", quantity.as_str())
}

fn random_words(raw: &RawRandom) -> (String, String) {
    let [shortest, longest] = *raw.length_s.get_ref();
    let [low, high] = *raw.voltage_u_max.get_ref();
    let guard = said(&raw.guard_deg);
    let what =
        format!("random steps of {low} .. {high} u_max, each {shortest} .. {longest} s, inward beyond {guard} deg");
    (what, format!("for {} s", said(&raw.total_s)))
}

/// When a hold ends.
fn ends_words(raw: &RawStep) -> String {
    let mut ends: Vec<String> = Vec::new();
    if raw.operator.is_some() {
        let with = if raw.amount.is_some() { " with the volume in ml" } else { "" };
        ends.push(format!("until confirmed{with}"));
    }
    let driven = raw.fixture.as_ref().is_some_and(|name| *name.get_ref() == FixtureName::Driven);
    if driven {
        ends.push("until there".to_owned());
    }
    if let Some(until) = &raw.until {
        let until = any_of(until.get_ref());
        ends.push(if ends.is_empty() { format!("until {until}") } else { format!("or {until}") });
    }
    let mut words = ends.join(" ");
    if let Some(timeout) = &raw.timeout_s {
        let _ = write!(words, ", at most {} s", said(timeout));
    }
    if let Some(seconds) = &raw.for_s {
        let _ = write!(words, "for {} s", said(seconds));
    }
    words
}

fn any_of(conditions: &[Spanned<RawCondition>]) -> String {
    conditions.iter().map(|condition| condition_words(condition.get_ref())).collect::<Vec<_>>().join(" or ")
}

fn condition_words(raw: &RawCondition) -> String {
    let channel: Channel = raw.channel;
    let name = channel.as_str();
    let of = |value: &Option<Spanned<Quantity>>| value.as_ref().map_or_else(|| "?".to_owned(), said);
    if raw.above.is_some() {
        format!("{name} above {}", of(&raw.above))
    } else if raw.below.is_some() {
        format!("{name} below {}", of(&raw.below))
    } else if raw.rate_below.is_some() {
        format!("{name} changes by less than {} a second", of(&raw.rate_below))
    } else {
        format!("{name} steady within {} for {} s", of(&raw.steady_within), of(&raw.for_s))
    }
}
