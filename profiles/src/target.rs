//! A step's target: what is controlled, and the wave that it follows.

use crate::controlled::Controlled;
use crate::error::ScriptError;
use crate::raw::{Quantity, RawStep, RawTarget, WaveName};
use crate::script::{Drive, RandomWave, Wave};
use crate::signal::{Pace, Point, Signal, Sweep, TICKS_PER_S, multisine};
use crate::table::{Interpolation, Tables};
use crate::values::{MAX_HOLD_S, Reader, ticks};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;
use toml::Spanned;

/// Highest frequency of a wave, Hz: five ticks a period.
const MAX_FREQUENCY_HZ: f64 = 200.0;
/// Longest period of a multisine, s.
const MAX_PERIOD_S: f64 = 600.0;
/// A multisine with more lines times ticks than this takes too long to prepare.
const MAX_LINE_TICKS: u64 = 50_000_000;
/// More steps than this in one wave are taken for a mistake.
const MAX_STEPS: f64 = 100_000.0;

impl WaveName {
    /// The keys that it needs, and those that it may have.
    pub fn keys(self) -> (&'static [&'static str], &'static [&'static str]) {
        match self {
            WaveName::Step => (&["value"], &[]),
            WaveName::Ramp => (&["to"], &["from", "rate_per_s"]),
            WaveName::Sine => (&["amplitude", "frequency_hz"], &["mean", "phase_deg"]),
            WaveName::Chirp => (&["amplitude", "from_hz", "to_hz"], &["mean", "phase_deg", "sweep"]),
            WaveName::Multisine => (&["amplitude", "period_s"], &["mean", "frequencies_hz", "band_hz"]),
            WaveName::RandomSteps => (&["range", "length_s"], &[]),
            WaveName::File => (&["file"], &["interpolation"]),
        }
    }
}

/// A multisine's frequencies in whole cycles a period, and the period in ticks.
type Lines = (Vec<u64>, u64);

/// What several steps share: tables that were read, and periods of multisines.
pub(crate) struct Prepared<'a> {
    tables: &'a Tables<'a>,
    multisines: RefCell<BTreeMap<Lines, Arc<[Point]>>>,
}

impl<'a> Prepared<'a> {
    pub fn new(tables: &'a Tables<'a>) -> Self {
        Prepared { tables, multisines: RefCell::default() }
    }

    fn multisine(&self, lines: Lines) -> Arc<[Point]> {
        let mut known = self.multisines.borrow_mut();
        known.entry(lines).or_insert_with_key(|(lines, ticks)| multisine(lines, *ticks)).clone()
    }
}

type Pair = Spanned<[Spanned<Quantity>; 2]>;

/// What a wave is read from.
struct WaveReader<'a> {
    reader: &'a Reader<'a>,
    raw: &'a RawTarget,
    offset: usize,
    step: &'a RawStep,
    name: WaveName,
}

impl Reader<'_> {
    /// What the step's pump or lever is to follow. `stream` chooses the random stream of a wave that draws one.
    pub fn drive(&self, raw: &RawStep, stream: u64) -> Result<Option<Drive>, ScriptError> {
        let constants = [
            (Controlled::VoltageV, &raw.voltage_v),
            (Controlled::VoltageUMax, &raw.voltage_u_max),
            (Controlled::FlowMlS, &raw.flow_ml_s),
        ];
        let places = constants.iter().filter_map(|(_, value)| value.as_ref().map(Spanned::span));
        let second = places.chain(raw.target.as_ref().map(Spanned::span)).nth(1);
        if let Some(second) = second {
            let what =
                "only one of `voltage_v`, `voltage_u_max`, `flow_ml_s` and `target` can drive the pump, got several";
            return Err(self.source.error(second.start, what));
        }
        for (quantity, value) in constants {
            if let Some(value) = value {
                return self.constant(quantity, quantity.as_str(), value).map(Some);
            }
        }
        raw.target.as_ref().map(|target| self.target(target, raw, stream)).transpose()
    }

    fn constant(&self, quantity: Controlled, key: &str, value: &Spanned<Quantity>) -> Result<Drive, ScriptError> {
        let (low, high) = quantity.bounds();
        let wave = Wave::Fixed(Signal::Constant(self.within(key, value, low, high)?));
        Ok(Drive { quantity, wave })
    }

    fn target(&self, target: &Spanned<RawTarget>, step: &RawStep, stream: u64) -> Result<Drive, ScriptError> {
        let raw = target.get_ref();
        let offset = target.span().start;
        let mut constants = raw.constants();
        let (quantity, name) = match (constants.next(), &raw.quantity, &raw.wave) {
            (None, Some(quantity), Some(name)) => (*quantity, *name),
            (Some((quantity, value)), None, None) if raw.wave_keys().next().is_none() && constants.next().is_none() => {
                return self.constant(quantity, quantity.as_str(), value);
            }
            (Some((quantity, _)), ..) => {
                let what = format!(
                    "`{0}` in a target stands alone, for a constant; a wave needs `quantity` = \"{0}\" and `wave`",
                    quantity.as_str()
                );
                return Err(self.source.error(offset, what));
            }
            (None, ..) => {
                let what = "a target needs one quantity with its value, or `quantity` and `wave`: got neither in full";
                return Err(self.source.error(offset, what));
            }
        };
        let reader = WaveReader { reader: self, raw, offset, step, name };
        reader.check_keys()?;
        let wave = reader.wave(stream)?;
        reader.check_range(quantity, &wave)?;
        Ok(Drive { quantity, wave })
    }
}

impl WaveReader<'_> {
    fn error(&self, what: impl Into<String>) -> ScriptError {
        self.reader.source.error(self.offset, what)
    }

    fn check_keys(&self) -> Result<(), ScriptError> {
        let (needed, allowed) = self.name.keys();
        for (key, place) in self.raw.wave_keys() {
            if !needed.contains(&key) && !allowed.contains(&key) {
                let all: Vec<_> = needed.iter().chain(allowed).copied().collect();
                let what = format!("the wave `{}` has no `{key}`: it has {}", self.name.as_str(), all.join(", "));
                return Err(self.reader.source.error(place.start, what));
            }
        }
        Ok(())
    }

    fn need<'v, T>(&self, key: &str, value: &'v Option<T>) -> Result<&'v T, ScriptError> {
        value.as_ref().ok_or_else(|| {
            let (needed, _) = self.name.keys();
            let name = self.name.as_str();
            self.error(format!("the wave `{name}` needs {}: `{key}` is missing", needed.join(", ")))
        })
    }

    fn number(&self, key: &str, value: &Option<Spanned<Quantity>>) -> Result<f64, ScriptError> {
        self.reader.number(key, self.need(key, value)?)
    }

    fn or(&self, key: &str, value: &Option<Spanned<Quantity>>, default: f64) -> Result<f64, ScriptError> {
        value.as_ref().map_or(Ok(default), |value| self.reader.number(key, value))
    }

    fn within(&self, key: &str, value: &Option<Spanned<Quantity>>, low: f64, high: f64) -> Result<f64, ScriptError> {
        self.reader.within(key, self.need(key, value)?, low, high)
    }

    fn frequency(&self, key: &str, value: &Option<Spanned<Quantity>>) -> Result<f64, ScriptError> {
        self.within(key, value, 1e-5, MAX_FREQUENCY_HZ)
    }

    fn pair(&self, key: &str, value: &Pair, low: f64, high: f64) -> Result<[f64; 2], ScriptError> {
        let [from, to] = value.get_ref();
        let [from, to] = [self.reader.number(key, from)?, self.reader.number(key, to)?];
        if low <= from && from <= to && to <= high {
            return Ok([from, to]);
        }
        let range =
            if (low, high) == (f64::MIN, f64::MAX) { String::new() } else { format!(" within {low} .. {high}") };
        let what = format!("`{key}` must be [smallest, largest]{range}, got [{from}, {to}]");
        Err(self.reader.source.error(value.span().start, what))
    }

    /// How long the step may take, in ticks.
    fn ticks(&self) -> Result<u64, ScriptError> {
        let length = [("for_s", &self.step.for_s), ("timeout_s", &self.step.timeout_s)];
        match length.into_iter().find_map(|(key, value)| value.as_ref().map(|value| (key, value))) {
            Some((key, value)) => self.reader.duration(key, value).map(ticks),
            None => {
                let what = format!(
                    "this `{}` lasts as long as its step, which says neither `for_s` nor `timeout_s`",
                    self.name.as_str()
                );
                Err(self.error(what))
            }
        }
    }

    fn wave(&self, stream: u64) -> Result<Wave, ScriptError> {
        let raw = self.raw;
        let mean = || self.or("mean", &raw.mean, 0.0);
        let amplitude = || self.within("amplitude", &raw.amplitude, 0.0, f64::MAX);
        let phase_rad = || Ok(self.or("phase_deg", &raw.phase_deg, 0.0)?.to_radians());
        Ok(Wave::Fixed(match self.name {
            WaveName::Step => Signal::Constant(self.number("value", &raw.value)?),
            WaveName::Ramp => Signal::Ramp {
                from: raw.from.as_ref().map(|value| self.reader.number("from", value)).transpose()?,
                to: self.number("to", &raw.to)?,
                pace: match &raw.rate_per_s {
                    Some(rate) => Pace::RatePerS(self.reader.within("rate_per_s", rate, 1e-9, 1e9)?),
                    None => Pace::Ticks(self.ticks()?),
                },
            },
            WaveName::Sine => Signal::Sine {
                mean: mean()?,
                amplitude: amplitude()?,
                frequency_hz: self.frequency("frequency_hz", &raw.frequency_hz)?,
                phase_rad: phase_rad()?,
            },
            WaveName::Chirp => Signal::Chirp {
                mean: mean()?,
                amplitude: amplitude()?,
                phase_rad: phase_rad()?,
                from_hz: self.frequency("from_hz", &raw.from_hz)?,
                to_hz: self.frequency("to_hz", &raw.to_hz)?,
                sweep: raw.sweep.as_ref().map_or(Sweep::Linear, |sweep| *sweep.get_ref()),
                ticks: self.ticks()?,
            },
            WaveName::Multisine => {
                let period = self.reader.prepared.multisine(self.lines()?);
                Signal::Multisine { mean: mean()?, amplitude: amplitude()?, period }
            }
            WaveName::RandomSteps => {
                let range = self.pair("range", self.need("range", &raw.range)?, f64::MIN, f64::MAX)?;
                let length_s = self.pair("length_s", self.need("length_s", &raw.length_s)?, 0.01, MAX_HOLD_S)?;
                let ticks = self.ticks()?;
                let most = ticks as f64 / TICKS_PER_S / length_s[0];
                if most > MAX_STEPS {
                    return Err(self.error(format!("up to {most:.0} random steps: expected at most {MAX_STEPS}")));
                }
                return Ok(Wave::Random(RandomWave { range, length_s, ticks, stream }));
            }
            WaveName::File => {
                let file = self.need("file", &raw.file)?;
                let table = self.reader.prepared.tables.get(file.get_ref(), self.reader.source, file.span().start)?;
                let interpolation = raw.interpolation.as_ref().map_or(Interpolation::Linear, |i| *i.get_ref());
                Signal::Table { table, interpolation }
            }
        }))
    }

    fn lines(&self) -> Result<Lines, ScriptError> {
        let raw = self.raw;
        let period_s = self.within("period_s", &raw.period_s, 0.01, MAX_PERIOD_S)?;
        let ticks = ticks(period_s);
        if (period_s * TICKS_PER_S - ticks as f64).abs() > 1e-6 {
            return Err(self.error(format!("`period_s` must be a whole number of milliseconds, got {period_s}")));
        }
        let mut lines = match (&raw.frequencies_hz, &raw.band_hz) {
            (Some(list), None) => {
                list.get_ref().iter().map(|f| self.line(f, period_s)).collect::<Result<Vec<_>, _>>()?
            }
            (None, Some(band)) => {
                let [from_hz, to_hz] = self.pair("band_hz", band, 1e-5, MAX_FREQUENCY_HZ)?;
                // A bound that is a line but for rounding is one.
                let first = (from_hz * period_s - 1e-6).ceil().max(1.0) as u64;
                (first..=(to_hz * period_s + 1e-6).floor() as u64).collect()
            }
            _ => return Err(self.error("the wave `multisine` needs one of `frequencies_hz` and `band_hz`")),
        };
        lines.sort_unstable();
        if lines.is_empty() {
            let what = format!("no multiple of 1/`period_s` = {} Hz among the multisine's frequencies", 1.0 / period_s);
            return Err(self.error(what));
        }
        if let Some(twice) = lines.windows(2).find(|pair| pair[0] == pair[1]) {
            let what = format!("`frequencies_hz` must differ, got {} Hz twice", twice[0] as f64 / period_s);
            return Err(self.error(what));
        }
        if lines.len() as u64 * ticks > MAX_LINE_TICKS {
            let what = format!(
                "{} lines over {ticks} ticks are too many to prepare (lines times ticks at most {MAX_LINE_TICKS}): \
                 shorten `period_s` or the band",
                lines.len()
            );
            return Err(self.error(what));
        }
        Ok((lines, ticks))
    }

    fn line(&self, frequency: &Spanned<Quantity>, period_s: f64) -> Result<u64, ScriptError> {
        let hz = self.reader.within("frequencies_hz", frequency, 1e-5, MAX_FREQUENCY_HZ)?;
        let line = (hz * period_s).round();
        if line < 1.0 || (hz * period_s - line).abs() > 1e-6 {
            let what = format!(
                "`frequencies_hz` must be multiples of 1/`period_s` = {} Hz, got {hz}: the nearest is {}",
                1.0 / period_s,
                line.max(1.0) / period_s
            );
            return Err(self.reader.source.error(frequency.span().start, what));
        }
        Ok(line as u64)
    }

    /// The whole wave must stay where a script may go.
    fn check_range(&self, quantity: Controlled, wave: &Wave) -> Result<(), ScriptError> {
        let (low, high) = quantity.bounds();
        let (least, most) = wave.range();
        let beyond = |value: f64| !(low..=high).contains(&value);
        let Some(value) = [most, least].into_iter().find(|&value| beyond(value)) else { return Ok(()) };
        let what = format!(
            "the wave `{}` reaches {value} `{}`: expected all of it within {low} .. {high}",
            self.name.as_str(),
            quantity.as_str()
        );
        if let Wave::Fixed(Signal::Table { table, .. }) = wave
            && let Some(row) = table.rows().iter().find(|row| beyond(row.value))
        {
            let what = format!("column 2 (value): {what}, got {}", row.value);
            return Err(ScriptError { file: table.file.clone(), line: row.line, what });
        }
        Err(self.error(what))
    }
}
