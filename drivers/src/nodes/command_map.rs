//! The bench's frames as nodes read them: `[can.command]` and `[can.fixture]` from the other end.

use super::exchange::{Counter, Sync};
use crate::can::{Frame, FrameId};
use crate::dbc::{Codec, Database};
use crate::emulated;
use crate::wired::signals::{Meaning, commanded, modulus};
use crate::wired::{CanSettings, FixtureNumbers, MappingError, Preparation};
use rt_core::{Command, Fixture};

/// Everything that was said last.
#[derive(Clone, Copy, Debug)]
struct Said {
    brake_open: bool,
    bypass_open: bool,
    counter: u64,
    running: bool,
    kind: u8,
    angle_deg: f64,
    pressure1_bar: f64,
    pressure2_bar: f64,
    flow_ml_s: f64,
    segment: u32,
    run: u8,
    vertical: bool,
    fill_bar: f64,
}

/// What the nodes are told, out of the frames that come.
pub struct CommandMap {
    signals: Vec<(FrameId, Meaning, Codec)>,
    /// The frame on which nodes act.
    sync: FrameId,
    modulus: Option<u64>,
    said: Said,
    /// The last fixture of a kind that there is.
    fixture: Fixture,
}

impl CommandMap {
    /// Looks the commands' signals up.
    ///
    /// # Errors
    /// A signal that does not exist or can't be used; names the rig file's key.
    pub fn new(settings: &CanSettings, database: &Database) -> Result<CommandMap, MappingError> {
        let (signals, sync) = commanded(settings, database)?;
        let counter = signals.iter().find(|signal| signal.meaning == Meaning::Counter);
        let modulus = counter.map(|counter| modulus(counter.codec));
        let idle = emulated::Settings::default();
        let said = Said {
            brake_open: idle.start.brake_open,
            bypass_open: idle.start.bypass_open,
            counter: 0,
            running: settings.command.running.is_none(),
            kind: 0,
            angle_deg: 0.0,
            pressure1_bar: idle.fill_bar,
            pressure2_bar: idle.fill_bar,
            flow_ml_s: 0.0,
            segment: 0,
            run: 0,
            vertical: idle.vertical,
            fill_bar: idle.fill_bar,
        };
        let signals = signals.iter().map(|signal| (signal.message.id, signal.meaning, signal.codec)).collect();
        Ok(CommandMap { signals, sync: sync.id, modulus, said, fixture: Fixture::Free })
    }

    /// The identifiers of the frames that say something.
    pub fn wanted(&self) -> Vec<FrameId> {
        let mut ids: Vec<FrameId> = self.signals.iter().map(|(id, ..)| *id).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Takes what a frame says; `Some` where it is the one on which nodes act.
    pub fn take(&mut self, frame: &Frame) -> Option<Sync> {
        for &(id, meaning, codec) in &self.signals {
            if id == frame.id
                && let Some(value) = codec.decode(frame.data())
            {
                self.said.take(meaning, value);
            }
        }
        if frame.id != self.sync {
            return None;
        }
        let Said { counter, running, .. } = self.said;
        let counter = self.modulus.map(|modulus| Counter { value: counter, modulus });
        Some(Sync { counter, running, preparation: self.preparation() })
    }

    /// What was said so far; before that, a free lever.
    pub fn preparation(&mut self) -> Preparation {
        let Said { brake_open, bypass_open, segment, run, vertical, fill_bar, .. } = self.said;
        let Said { kind, angle_deg, pressure1_bar, pressure2_bar, flow_ml_s, .. } = self.said;
        if let Some(fixture) = FixtureNumbers::fixture(kind, angle_deg, pressure1_bar, pressure2_bar, flow_ml_s) {
            self.fixture = fixture;
        }
        let start = Command { voltage_v: 0.0, brake_open, bypass_open, fixture: self.fixture, segment };
        Preparation { run, vertical, fill_bar, start }
    }
}

impl Said {
    fn take(&mut self, meaning: Meaning, value: f64) {
        // `as` saturates, and NaN becomes 0: what a signal of another type says is no worse than another number.
        let set = value != 0.0;
        match meaning {
            Meaning::BrakeOpen => self.brake_open = set,
            Meaning::BypassOpen => self.bypass_open = set,
            Meaning::Counter => self.counter = value as u64,
            Meaning::Running => self.running = set,
            Meaning::Kind => self.kind = value as u8,
            Meaning::AngleDeg => self.angle_deg = value,
            Meaning::Pressure1Bar => self.pressure1_bar = value,
            Meaning::Pressure2Bar => self.pressure2_bar = value,
            Meaning::FlowMlS => self.flow_ml_s = value,
            Meaning::Segment => self.segment = value as u32,
            Meaning::Run => self.run = value as u8,
            Meaning::Vertical => self.vertical = set,
            Meaning::FillBar => self.fill_bar = value,
        }
    }
}
