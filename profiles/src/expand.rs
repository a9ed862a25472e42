//! From the TOML shape to unrolled steps: loops, variables, inheritance from step to step, and every check that needs
//! no rig.

use crate::envelope;
use crate::error::{ScriptError, Source};
use crate::fault;
use crate::raw::{FixtureName, Lists, RawRandom, RawScript, RawStart, RawStep, Valve};
use crate::script::{
    ANGLE_LIMIT_DEG, Change, Drive, End, FixtureChange, Hold, Item, ItemKind, Script, Skip, State, Wave,
};
use crate::table::Tables;
use crate::target::Prepared;
use crate::values::{FixtureKeys, Reader, TICK_S, Variable};
use rt_core::{Fixture, OverrunPolicy};
use std::ops::Range;
use std::sync::Arc;
use toml::Spanned;

/// More unrolled steps than this are taken for a mistake in a loop.
const MAX_ITEMS: usize = 100_000;

/// Checks and unrolls a whole script.
pub(crate) fn script(raw: &RawScript, source: &Source, tables: &Tables) -> Result<Script, ScriptError> {
    let name = raw.name.get_ref();
    if !is_identifier(name) {
        return Err(source.error(
            raw.name.span().start,
            format!("`name` must be one or more of a-z, 0-9 and _ (it names the run's file), got {name:?}"),
        ));
    }
    let overrun = match &raw.overrun {
        Some(word) => {
            word.get_ref().parse().map_err(|what| source.error(word.span().start, format!("`overrun`: {what}")))?
        }
        None => OverrunPolicy::default(),
    };
    let prepared = Prepared::new(tables);
    let (start, fill_bar) = start(&raw.start, source, &prepared)?;
    let mut expansion = Expansion {
        source,
        prepared: &prepared,
        items: Vec::new(),
        variables: Vec::new(),
        with: Arc::from(""),
        commanded_deg: commanded_by(&start.fixture),
        random_streams: 0,
    };
    expansion.steps(&raw.step)?;
    if expansion.items.is_empty() {
        return Err(source.error(raw.name.span().start, "a script needs at least one [[step]], got none"));
    }
    let reader = Reader { source, variables: &[], prepared: &prepared };
    let faults = fault::faults(&raw.fault, &reader)?;
    let envelope = envelope::envelope(raw.envelope.as_ref(), &reader)?;
    Ok(Script {
        name: name.clone(),
        protocol: raw.protocol,
        role: raw.role,
        plane: raw.plane,
        about: raw.about.clone().unwrap_or_default(),
        fill_bar,
        overrun,
        envelope,
        faults,
        text: source.text.to_owned(),
        file: source.file.to_owned(),
        start,
        items: expansion.items,
    })
}

fn is_identifier(name: &str) -> bool {
    !name.is_empty() && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_')
}

fn start(raw: &Spanned<RawStart>, source: &Source, prepared: &Prepared) -> Result<(State, Option<f64>), ScriptError> {
    let start = raw.get_ref();
    // No loop encloses [start], so no variable is in scope.
    let reader = Reader { source, variables: &[], prepared };
    let name = *start.fixture.get_ref();
    if matches!(name, FixtureName::Driven | FixtureName::Released) {
        return Err(source.error(
            start.fixture.span().start,
            format!(
                "a run can't start with the fixture `{}`: expected free, clamped, filled or pump-bench",
                name.as_str()
            ),
        ));
    }
    let keys = FixtureKeys {
        angle_deg: start.angle_deg.as_ref(),
        rate_deg_s: None,
        pressure1_bar: start.pressure1_bar.as_ref(),
        pressure2_bar: start.pressure2_bar.as_ref(),
        release_ml_s: None,
    };
    let fixture = match reader.fixture(name, start.fixture.span(), &keys)? {
        FixtureChange::To(fixture) => fixture,
        FixtureChange::Ramp { .. } => unreachable!("only `driven` is a ramp; refused above"),
    };
    let fill_bar = start.fill_bar.as_ref().map(|q| reader.pressure("fill_bar", q)).transpose()?;
    let state = State { brake_open: start.brake == Valve::Open, bypass_open: start.bypass == Valve::Open, fixture };
    Ok((state, fill_bar))
}

/// The words of an inner loop behind those of the loops around it.
fn within(around: &str, own: &str) -> Arc<str> {
    if around.is_empty() { own.into() } else { format!("{around}, {own}").into() }
}

/// The angles at which the lever may have been told to be: where it is free, anywhere.
type AngleRange = (f64, f64);

fn commanded_by(fixture: &Fixture) -> AngleRange {
    match *fixture {
        Fixture::Clamped { angle_deg }
        | Fixture::Driven { angle_deg }
        | Fixture::Filled { angle_deg, .. }
        | Fixture::Released { angle_deg, .. } => (angle_deg, angle_deg),
        Fixture::Free | Fixture::PumpBench { .. } => (-ANGLE_LIMIT_DEG, ANGLE_LIMIT_DEG),
    }
}

struct Expansion<'a> {
    source: &'a Source<'a>,
    prepared: &'a Prepared<'a>,
    items: Vec<Item>,
    variables: Vec<Variable>,
    /// The loops around the step under way, in words.
    with: Arc<str>,
    commanded_deg: AngleRange,
    random_streams: u64,
}

impl Expansion<'_> {
    fn reader(&self) -> Reader<'_> {
        Reader { source: self.source, variables: &self.variables, prepared: self.prepared }
    }

    fn steps(&mut self, steps: &[Spanned<RawStep>]) -> Result<(), ScriptError> {
        for step in steps {
            let raw = step.get_ref();
            let offset = step.span().start;
            match (&raw.for_each, &raw.repeat, &raw.random) {
                (None, None, None) => self.hold(raw, offset)?,
                (Some(lists), None, None) => self.for_each(raw, lists)?,
                (None, Some(times), None) => self.repeat(raw, times)?,
                (None, None, Some(random)) => self.random(raw, offset, random)?,
                _ => {
                    return Err(self.source.error(
                        offset,
                        "a step is one of a hold, `repeat`, `for_each` and `random`, got several: nest them with [[step.step]]",
                    ));
                }
            }
            if self.items.len() > MAX_ITEMS {
                return Err(self
                    .source
                    .error(offset, format!("the loops unroll to more than {MAX_ITEMS} steps here: shorten them")));
            }
        }
        Ok(())
    }

    /// The inner steps of a loop, which must have some and no keys of a hold.
    fn body<'r>(
        &self,
        raw: &'r RawStep,
        kind: &str,
        place: Range<usize>,
    ) -> Result<&'r [Spanned<RawStep>], ScriptError> {
        if let Some((key, span)) = raw.hold_keys().next() {
            let what = format!("`{key}` has no meaning beside `{kind}`: put it into an inner [[step.step]]");
            return Err(self.source.error(span.start, what));
        }
        match &raw.step {
            Some(steps) if !steps.is_empty() => Ok(steps),
            _ => Err(self.source.error(place.start, format!("`{kind}` needs inner steps ([[step.step]]), got none"))),
        }
    }

    fn for_each(&mut self, raw: &RawStep, lists: &Spanned<Lists>) -> Result<(), ScriptError> {
        let body = self.body(raw, "for_each", lists.span())?;
        if let Some(stop) = &raw.stop_when {
            return Err(self.source.error(stop.span().start, "`stop_when` belongs to `repeat`, not to `for_each`"));
        }
        let mut walked: Vec<(&str, Vec<f64>)> = Vec::with_capacity(lists.get_ref().len());
        for (name, values) in lists.get_ref() {
            let place = values.span().start;
            if !is_identifier(name) {
                let what = format!("a variable's name must be of a-z, 0-9 and _, got {name:?}");
                return Err(self.source.error(place, what));
            }
            if self.variables.iter().any(|v| v.name == *name) {
                let what = format!("the variable `{name}` is already that of an enclosing for_each: rename one");
                return Err(self.source.error(place, what));
            }
            let values = self.reader().values(name, values)?;
            let (first, passes) =
                walked.first().map_or((name.as_str(), values.len()), |(first, of)| (*first, of.len()));
            if values.len() != passes || values.is_empty() {
                let what = format!(
                    "the values of a for_each are walked together and need one length of at least 1: `{first}` has {passes}, `{name}` {}",
                    values.len()
                );
                return Err(self.source.error(place, what));
            }
            walked.push((name, values));
        }
        let Some(passes) = walked.first().map(|(_, values)| values.len()) else {
            return Err(self.source.error(lists.span().start, "`for_each` needs at least one list, got none"));
        };
        let outer = self.variables.len();
        let around = self.with.clone();
        for pass in 0..passes {
            let own: Vec<String> = walked.iter().map(|(name, values)| format!("{name} = {}", values[pass])).collect();
            self.with = within(&around, &own.join(", "));
            for (name, values) in &walked {
                self.variables.push(Variable { name: (*name).to_owned(), value: values[pass], used: false.into() });
            }
            self.steps(body)?;
            if let Some(unused) = self.variables[outer..].iter().find(|v| !v.used.get()) {
                let what =
                    format!("no inner step uses the variable `{0}`: write \"${0}\" where it belongs", unused.name);
                return Err(self.source.error(lists.span().start, what));
            }
            self.variables.truncate(outer);
        }
        self.with = around;
        Ok(())
    }

    fn repeat(&mut self, raw: &RawStep, times: &Spanned<u32>) -> Result<(), ScriptError> {
        let body = self.body(raw, "repeat", times.span())?;
        if *times.get_ref() == 0 {
            return Err(self.source.error(times.span().start, "`repeat` must be at least 1, got 0"));
        }
        let stop = raw.stop_when.as_ref().map(|stop| self.reader().conditions("stop_when", stop)).transpose()?;
        let mut starts = Vec::new();
        let around = self.with.clone();
        for pass in 1..=*times.get_ref() {
            self.with = within(&around, &format!("pass {pass} of {}", times.get_ref()));
            starts.push((self.items.len(), self.commanded_deg));
            self.steps(body)?;
        }
        self.with = around;
        if let Some(when) = stop {
            let to = self.items.len();
            for (start, (low, high)) in starts {
                // Outer loops are looked at before inner ones, and come here after them.
                self.items[start].skips.insert(0, Skip { when: when.clone(), to });
                self.commanded_deg = (self.commanded_deg.0.min(low), self.commanded_deg.1.max(high));
            }
        }
        Ok(())
    }

    fn random(&mut self, raw: &RawStep, offset: usize, random: &Spanned<RawRandom>) -> Result<(), ScriptError> {
        if let Some((key, span)) = raw.hold_keys().next() {
            let what = format!("`{key}` has no meaning beside `random`: put it into a step before");
            return Err(self.source.error(span.start, what));
        }
        if raw.step.is_some() || raw.stop_when.is_some() {
            return Err(self.source.error(offset, "`random` has neither inner steps nor `stop_when`"));
        }
        let steps = self.reader().random(random.get_ref())?;
        let kind = ItemKind::Random { stream: self.random_streams, steps };
        self.random_streams += 1;
        self.items.push(Item { line: self.source.line(offset), with: self.with.clone(), skips: Vec::new(), kind });
        Ok(())
    }

    fn hold(&mut self, raw: &RawStep, offset: usize) -> Result<(), ScriptError> {
        if let Some(stop) = &raw.stop_when {
            return Err(self.source.error(stop.span().start, "`stop_when` belongs to `repeat`; a hold has `until`"));
        }
        if raw.step.is_some() {
            return Err(self.source.error(offset, "inner steps need `repeat` or `for_each` in the step around them"));
        }
        let reader = self.reader();
        let drive = reader.drive(raw, self.random_streams)?;
        let draws = matches!(&drive, Some(Drive { wave: Wave::Random(_), .. }));
        let keys = FixtureKeys {
            angle_deg: raw.angle_deg.as_ref(),
            rate_deg_s: raw.rate_deg_s.as_ref(),
            pressure1_bar: raw.pressure1_bar.as_ref(),
            pressure2_bar: raw.pressure2_bar.as_ref(),
            release_ml_s: raw.release_ml_s.as_ref(),
        };
        let fixture = match &raw.fixture {
            Some(name) => Some(reader.fixture(*name.get_ref(), name.span(), &keys)?),
            None => {
                if let Some((key, Some(value))) = keys.named().into_iter().find(|(_, value)| value.is_some()) {
                    let what = format!("`{key}` needs `fixture` in the same step, got none");
                    return Err(self.source.error(value.span().start, what));
                }
                None
            }
        };
        let ramp = match fixture {
            Some(FixtureChange::Ramp { to_deg, rate_deg_s }) => Some((to_deg, rate_deg_s)),
            _ => None,
        };
        let operator = reader.operator(raw)?;
        let end = match ramp {
            Some((to_deg, rate_deg_s)) => {
                let (low, high) = self.commanded_deg;
                let way_deg = (to_deg - low).abs().max((to_deg - high).abs());
                reader.arrival(raw, way_deg / rate_deg_s + 2.0 * TICK_S)?
            }
            None if operator.is_some() => reader.confirmed(raw)?,
            None => reader.end(raw, offset)?,
        };
        // People come near: the pump goes to 0 V, unless the step says what it does meanwhile.
        let drive = drive.or_else(|| operator.as_ref().map(|_| Drive::AT_REST));
        let open = |valve: &Option<Spanned<Valve>>| valve.as_ref().map(|valve| *valve.get_ref() == Valve::Open);
        let change = Change { drive, brake_open: open(&raw.brake), bypass_open: open(&raw.bypass), fixture };
        match (ramp, fixture) {
            (Some((to_deg, _)), _) => {
                let (low, high) = self.commanded_deg;
                let early = matches!(&end, End::Arrival { any, .. } if !any.is_empty());
                self.commanded_deg = if early { (low.min(to_deg), high.max(to_deg)) } else { (to_deg, to_deg) };
            }
            (None, Some(FixtureChange::To(fixed))) => self.commanded_deg = commanded_by(&fixed),
            (None, _) => {}
        }
        self.random_streams += u64::from(draws);
        let new_segment = raw.new_segment.as_ref().is_none_or(|value| *value.get_ref());
        let hold = Hold { change, end, new_segment, operator };
        self.items.push(Item {
            line: self.source.line(offset),
            with: self.with.clone(),
            skips: Vec::new(),
            kind: ItemKind::Hold(hold),
        });
        Ok(())
    }
}
