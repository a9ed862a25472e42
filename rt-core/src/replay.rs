//! Replay: the same loop with a recording in the place of clock, device and people, and with a comparison in the place of the
//! publication. What the loop puts out must be what was recorded, bit for bit.

use std::cell::RefCell;
use std::fmt;

use crate::clock::{Clock, Wake};
use crate::confirmation::{Confirmation, Waiting};
use crate::publish::{Handover, Publish};
use crate::supervisor::{Breach, Channel, Trip};
use crate::traits::{Demand, Device, DeviceError, Operator};
use crate::types::{Command, Measurement, Sample, Tick, flags};

/// Samples of a recorded run, in order. Clock, device, operator and comparison share it; all are used by one thread.
pub struct Replay<I> {
    inner: RefCell<Inner<I>>,
}

struct Inner<I> {
    samples: I,
    /// The sample of the tick under way.
    current: Option<Sample>,
    /// It was compared.
    judged: bool,
    following: Option<Sample>,
    compared: u64,
    difference: Option<Difference>,
}

/// The first field in which replay and recording differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The tick.
    pub tick: u64,
    /// The field of [`Sample`].
    pub field: &'static str,
    /// What was recorded.
    pub recorded: String,
    /// What the replay put out.
    pub replayed: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Difference { tick, field, recorded, replayed } = self;
        write!(f, "tick {tick}, {field}: recorded {recorded}, replayed {replayed}")
    }
}

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Ticks that agree, up to the first difference.
    pub agreed: u64,
    /// The first difference, if there is one.
    pub difference: Option<Difference>,
}

impl<I: Iterator<Item = Sample>> Replay<I> {
    /// Replays these samples: one whole run without losses, its first sample first.
    pub fn new(mut samples: I) -> Self {
        let following = samples.next();
        let inner = Inner { samples, current: None, judged: false, following, compared: 0, difference: None };
        Replay { inner: RefCell::new(inner) }
    }

    /// The run's clock: ticks as they were, skipped ones included.
    pub fn clock(&self) -> impl Clock + '_ {
        ReplayClock(self)
    }

    /// The rig: says what was recorded, and listens to nothing.
    pub fn device(&self) -> impl Device + '_ {
        ReplayDevice(self)
    }

    /// The people: ask for what they asked for.
    pub fn operator(&self) -> impl Operator + '_ {
        ReplayOperator(self)
    }

    /// Compares what the loop publishes.
    pub fn comparison(&self) -> impl Publish + '_ {
        Comparison(self)
    }

    /// What was found, after the run.
    pub fn verdict(&self) -> Verdict {
        let inner = self.inner.borrow();
        let mut difference = inner.difference.clone();
        if difference.is_none()
            && let Some(next) = inner.current.as_ref().filter(|_| !inner.judged).or(inner.following.as_ref())
        {
            let replayed = "the run is over".to_owned();
            difference = Some(Difference { tick: next.tick, field: "tick", recorded: next.tick.to_string(), replayed });
        }
        Verdict { agreed: inner.compared, difference }
    }

    fn current(&self) -> Option<Sample> {
        self.inner.borrow().current
    }
}

struct ReplayClock<'a, I>(&'a Replay<I>);

impl<I: Iterator<Item = Sample>> Clock for ReplayClock<'_, I> {
    fn start(&mut self) {}

    fn wait(&mut self, index: u64) -> Wake {
        let mut inner = self.0.inner.borrow_mut();
        let next = inner.samples.next();
        inner.current = std::mem::replace(&mut inner.following, next);
        inner.judged = false;
        let (woken_ns, lateness_ns, behind_ns) =
            inner.current.map_or((0, 0, 0), |s| (s.woken_ns, s.lateness_ns, u64::from(s.behind_ns)));
        Wake { tick: Tick::at(index), woken_ns, lateness_ns, behind_ns }
    }

    /// Within a tick that was in time: its beginning. Otherwise the beginning of the tick that followed, which is when the loop
    /// found that it was late.
    fn now_ns(&mut self) -> u64 {
        let inner = self.0.inner.borrow();
        match (&inner.current, &inner.following) {
            (_, Some(next)) if next.overrun() => next.scheduled_ns,
            (Some(current), _) => current.scheduled_ns,
            (None, _) => 0,
        }
    }
}

struct ReplayDevice<'a, I>(&'a Replay<I>);

impl<I: Iterator<Item = Sample>> Device for ReplayDevice<'_, I> {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        match self.0.current() {
            Some(sample) if !sample.fault() => Ok(sample.measurement()),
            Some(_) => Err(recorded(now, "failed in the recorded run")),
            None => Err(recorded(now, "expected another sample, the recording is over")),
        }
    }

    fn write(&mut self, _now: Tick, _command: &Command) -> Result<(), DeviceError> {
        Ok(())
    }
}

fn recorded(now: Tick, what: &str) -> DeviceError {
    DeviceError { device: "recording", tick: now.index, what: what.to_owned() }
}

struct ReplayOperator<'a, I>(&'a Replay<I>);

impl<I: Iterator<Item = Sample>> Operator for ReplayOperator<'_, I> {
    fn demand(&mut self, _now: Tick) -> Demand {
        let pressed = Trip { tick: 0, channel: Channel::EmergencyStop, value: 0.0, breach: Breach::Demanded };
        match self.0.current() {
            // Looked at first: who asked for a stop at this tick did not press the button at it.
            Some(sample) if sample.flags & flags::STOPPED != 0 => Demand::Stop,
            Some(sample) if sample.trip == pressed.code() => Demand::EmergencyStop,
            _ => Demand::None,
        }
    }

    /// The amount that came with it is what was measured, as the recording has it.
    fn confirmation(&mut self, _now: Tick, _waiting: Option<Waiting>, _measured: &Measurement) -> Option<Confirmation> {
        self.0.current().filter(Sample::confirmed).map(|_| Confirmation::default())
    }
}

struct Comparison<'a, I>(&'a Replay<I>);

impl<I: Iterator<Item = Sample>> Publish for Comparison<'_, I> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        let mut inner = self.0.inner.borrow_mut();
        inner.judged = true;
        if inner.difference.is_some() {
            return Handover::Taken;
        }
        inner.difference = match &inner.current {
            Some(recorded) => compare(recorded, sample),
            None => Some(Difference {
                tick: sample.tick,
                field: "tick",
                recorded: "the run is over".to_owned(),
                replayed: sample.tick.to_string(),
            }),
        };
        inner.compared += u64::from(inner.difference.is_none());
        Handover::Taken
    }
}

/// The first field that differs. Durations are no output of the loop; the number of the run is the recorder's.
fn compare(recorded: &Sample, replayed: &Sample) -> Option<Difference> {
    let whole = |field, of: fn(&Sample) -> u64| (field, of(recorded), of(replayed), false);
    let number = |field, of: fn(&Sample) -> f64| {
        // One NaN for all: a recording keeps no payloads.
        let bits = |value: f64| if value.is_nan() { f64::NAN.to_bits() } else { value.to_bits() };
        (field, bits(of(recorded)), bits(of(replayed)), true)
    };
    let fields = [
        whole("tick", |s| s.tick),
        whole("skipped", |s| s.skipped),
        number("angle_deg", |s| s.angle_deg),
        number("pressure1_bar", |s| s.pressure1_bar),
        number("pressure2_bar", |s| s.pressure2_bar),
        number("torque_nm", |s| s.torque_nm),
        number("volume_ml", |s| s.volume_ml),
        number("voltage_v", |s| s.voltage_v),
        whole("trip", |s| u64::from(s.trip)),
        whole("flags", |s| u64::from(if s.fault() { s.flags & !flags::TRIPPED } else { s.flags })),
        whole("segment", |s| u64::from(s.segment)),
        whole("step", |s| u64::from(s.step)),
        whole("quality", |s| u64::from(s.quality)),
        whole("target_of", |s| u64::from(s.target_of)),
        number("target", |s| s.target),
    ];
    // Where the device failed the measurement is unknown, so that what the supervisor made of it can't be judged again. A recording
    // without targets was made when samples held none.
    let unknown = |field: &str| match field {
        "trip" => recorded.fault() && replayed.fault(),
        "target_of" | "target" => recorded.target_of == 0,
        _ => false,
    };
    let differs = |(field, a, b, _): &(&'static str, u64, u64, bool)| a != b && !unknown(field);
    let (field, recorded_bits, replayed_bits, float) = fields.into_iter().find(differs)?;
    let said = |bits: u64| if float { format!("{:?}", f64::from_bits(bits)) } else { bits.to_string() };
    Some(Difference { tick: recorded.tick, field, recorded: said(recorded_bits), replayed: said(replayed_bits) })
}
