//! Frames to measured quantities: which signal of which message is what, calibrated, with the time at which it was measured.

use super::settings::CanSettings;
use super::signals::{MappingError, Sensed, modulus, sensed, signal};
use crate::can::{Frame, FrameId, TimedFrame};
use crate::dbc::{Codec, Database};
use rt_core::{Input, Measurement, PERIOD_NS, Tick};

/// An echoed counter that is further back than this is of another run; its frame's time says more.
const OLDEST_ECHO_TICKS: u64 = 4096;

/// Where an echoed counter is, and after how many ticks it begins anew.
#[derive(Clone, Copy, Debug)]
struct Echo {
    codec: Codec,
    modulus: u64,
}

/// A mapped sensor.
#[derive(Clone, Copy, Debug)]
struct Mapped {
    input: Input,
    id: FrameId,
    value: Codec,
    gain: f64,
    offset: f64,
    fault: Option<Codec>,
    present: Option<Codec>,
    counter: Option<Echo>,
    latency_ns: u64,
}

/// The last reading of a sensor.
#[derive(Clone, Copy, Debug)]
struct Reading {
    value: f64,
    faulty: bool,
    measured: Measured,
}

/// When a reading was taken.
#[derive(Clone, Copy, Debug)]
enum Measured {
    /// On the command of this tick.
    Tick(u64),
    /// At this time, `CLOCK_MONOTONIC`, ns.
    MonotonicNs(u64),
}

/// The measured quantities out of the frames that come. Allocates nothing after its construction.
pub struct InputMap {
    sensors: Vec<Mapped>,
    readings: [Option<Reading>; 5],
    /// Frames that held a reading older than the newest.
    outdated: u64,
}

impl InputMap {
    /// Looks the sensors' signals up.
    ///
    /// # Errors
    /// A signal that does not exist or can't be used, a companion in another message; names the rig file's key.
    pub fn new(settings: &CanSettings, database: &Database) -> Result<InputMap, MappingError> {
        let counter = settings.command.counter.as_ref();
        let counter = counter.map(|name| signal(database, name, || "[can.command] counter".to_owned())).transpose()?;
        let commanded = counter.map_or(u64::MAX, |(_, codec)| modulus(codec));
        let sensors = sensed(settings, database)?.iter().map(|sensed| Mapped::new(sensed, commanded)).collect();
        Ok(InputMap { sensors, readings: [None; 5], outdated: 0 })
    }

    /// The identifiers of the frames that hold something.
    pub fn wanted(&self) -> Vec<FrameId> {
        let mut ids: Vec<FrameId> = self.sensors.iter().map(|sensor| sensor.id).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Takes what a frame says. `commanded` is the tick of the last command that was sent, `None` before the run's first: an echoed
    /// counter is of it or of one before it. A reading that is older than the one there is, is left out.
    pub fn take(&mut self, received: &TimedFrame, commanded: Option<u64>) {
        for sensor in &self.sensors {
            if sensor.id != received.frame.id {
                continue;
            }
            let Some(reading) = sensor.read(received, commanded) else { continue };
            let newest = &mut self.readings[sensor.input as usize];
            let older = match (newest.map(|before| before.measured), reading.measured) {
                (Some(Measured::Tick(before)), Measured::Tick(now)) => now < before,
                (Some(Measured::MonotonicNs(before)), Measured::MonotonicNs(now)) => now < before,
                // What was measured on a command of this run is newer than what came before the run, and than what can't say.
                (Some(Measured::Tick(_)), Measured::MonotonicNs(_)) => sensor.counter.is_some(),
                _ => false,
            };
            if older {
                self.outdated += 1;
            } else {
                *newest = Some(reading);
            }
        }
    }

    /// Everything as it is known at this tick. `origin_ns` is the run's tick 0 on `CLOCK_MONOTONIC`.
    pub fn measurement(&self, now: Tick, origin_ns: u64) -> Measurement {
        let mut measured = Measurement::NONE;
        for (input, reading) in Input::ALL.into_iter().zip(&self.readings) {
            let Some(reading) = reading else { continue };
            let value = match input {
                Input::Angle => &mut measured.angle_deg,
                Input::Pressure1 => &mut measured.pressure1_bar,
                Input::Pressure2 => &mut measured.pressure2_bar,
                Input::Torque => &mut measured.torque_nm,
                Input::Volume => &mut measured.volume_ml,
            };
            *value = reading.value;
            let age_ns = match reading.measured {
                Measured::Tick(tick) => now.index.saturating_sub(tick).saturating_mul(PERIOD_NS),
                Measured::MonotonicNs(at_ns) => (origin_ns + now.scheduled_ns).saturating_sub(at_ns),
            };
            measured.age_ns[input as usize] = u32::try_from(age_ns).unwrap_or(u32::MAX);
            if reading.faulty {
                measured.faulty |= input.bit();
            }
        }
        measured
    }

    /// Sensors without a reading yet, by the names of their columns and their frames.
    pub fn silent(&self) -> impl Iterator<Item = (&'static str, FrameId)> {
        let silent = |sensor: &&Mapped| self.readings[sensor.input as usize].is_none();
        self.sensors.iter().filter(silent).map(|sensor| (sensor.input.column(), sensor.id))
    }

    /// Forgets all readings.
    pub fn forget(&mut self) {
        self.readings = [None; 5];
    }

    /// Readings that were left out because a newer one had come before them, since the construction.
    pub fn outdated(&self) -> u64 {
        self.outdated
    }
}

impl Mapped {
    /// `commanded`: with how many values the counter counts that is echoed. A wider echo comes no further.
    fn new(sensed: &Sensed<'_>, commanded: u64) -> Mapped {
        let Sensed { input, sensor, message, value, fault, present, counter } = *sensed;
        Mapped {
            input,
            id: message.id,
            value,
            gain: sensor.gain,
            offset: sensor.offset,
            fault,
            present,
            counter: counter.map(|codec| Echo { codec, modulus: modulus(codec).min(commanded) }),
            latency_ns: (sensor.latency_ms.max(0.0) * 1e6) as u64,
        }
    }

    fn read(&self, received: &TimedFrame, commanded: Option<u64>) -> Option<Reading> {
        let data = received.frame.data();
        let said = |codec: Option<Codec>| codec.and_then(|codec| codec.decode(data));
        let raw = self.value.decode(data)?;
        let absent = said(self.present) == Some(0.0);
        let arrived = Measured::MonotonicNs(received.received_ns.saturating_sub(self.latency_ns));
        let measured = match (self.counter, commanded) {
            (Some(echo), Some(commanded)) => echo.tick(&received.frame, commanded).map_or(arrived, Measured::Tick),
            _ => arrived,
        };
        let value = if absent { f64::NAN } else { self.gain * raw + self.offset };
        // A float on the wire may be infinite, or become it by its gain: whatever the node says of it, it is no measurement.
        let infinite = value.is_infinite();
        let faulty = infinite || said(self.fault).is_some_and(|fault| fault != 0.0);
        Some(Reading { value: if infinite { f64::NAN } else { value }, faulty, measured })
    }
}

impl Echo {
    /// The tick whose command this frame answers, if it is one of this run.
    fn tick(&self, frame: &Frame, commanded: u64) -> Option<u64> {
        let counter = self.codec.decode(frame.data())? as u64;
        let back = (commanded % self.modulus + self.modulus - counter % self.modulus) % self.modulus;
        if back < OLDEST_ECHO_TICKS.min(self.modulus / 2) { commanded.checked_sub(back) } else { None }
    }
}
