//! The command of a tick to frames: valves and counter every tick, the fixture when it changes and every now and then.

use super::input_map::{find, modulus};
use super::settings::CanSettings;
use super::{Preparation, WiredError};
use crate::can::{Frame, FrameId};
use crate::dbc::{Codec, Database, Message, OutOfRange};
use rt_core::{Command, Fixture};

/// How a fixture is named on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs, reason = "the names are those of rt_core::Fixture")]
pub enum FixtureKind {
    Free = 0,
    Clamped = 1,
    Driven = 2,
    Filled = 3,
    Released = 4,
    PumpBench = 5,
}

/// A fixture as the numbers that go over the bus; what a kind does not use is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FixtureNumbers {
    pub kind: FixtureKind,
    pub angle_deg: f64,
    pub pressure1_bar: f64,
    pub pressure2_bar: f64,
    pub flow_ml_s: f64,
}

impl From<Fixture> for FixtureNumbers {
    fn from(fixture: Fixture) -> Self {
        let none = FixtureNumbers {
            kind: FixtureKind::Free,
            angle_deg: 0.0,
            pressure1_bar: 0.0,
            pressure2_bar: 0.0,
            flow_ml_s: 0.0,
        };
        match fixture {
            Fixture::Free => none,
            Fixture::Clamped { angle_deg } => FixtureNumbers { kind: FixtureKind::Clamped, angle_deg, ..none },
            Fixture::Driven { angle_deg } => FixtureNumbers { kind: FixtureKind::Driven, angle_deg, ..none },
            Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } => {
                FixtureNumbers { kind: FixtureKind::Filled, angle_deg, pressure1_bar, pressure2_bar, ..none }
            }
            Fixture::Released { angle_deg, flow_ml_s } => {
                FixtureNumbers { kind: FixtureKind::Released, angle_deg, flow_ml_s, ..none }
            }
            Fixture::PumpBench { pressure1_bar, pressure2_bar } => {
                FixtureNumbers { kind: FixtureKind::PumpBench, pressure1_bar, pressure2_bar, ..none }
            }
        }
    }
}

impl FixtureNumbers {
    /// The fixture again; `None` for a kind that there is not.
    pub fn fixture(
        kind: u8,
        angle_deg: f64,
        pressure1_bar: f64,
        pressure2_bar: f64,
        flow_ml_s: f64,
    ) -> Option<Fixture> {
        Some(match kind {
            0 => Fixture::Free,
            1 => Fixture::Clamped { angle_deg },
            2 => Fixture::Driven { angle_deg },
            3 => Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar },
            4 => Fixture::Released { angle_deg, flow_ml_s },
            5 => Fixture::PumpBench { pressure1_bar, pressure2_bar },
            _ => return None,
        })
    }
}

/// What a signal says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meaning {
    BrakeOpen,
    BypassOpen,
    Counter,
    Running,
    Kind,
    AngleDeg,
    Pressure1Bar,
    Pressure2Bar,
    FlowMlS,
    Segment,
    Run,
    Vertical,
    FillBar,
}

/// A message that is sent, with what its signals say.
struct Sent {
    frame: Frame,
    signals: Vec<(Meaning, Codec, u64)>,
    /// It is sent again after so many ticks; 1 = every tick.
    every_ticks: u32,
    /// Ticks until then.
    due_in: u32,
    /// As it was sent last.
    last: Option<Frame>,
    /// Ticks for which a change is still repeated: a set of frames that a newer one replaced must not take it along.
    repeat: u8,
}

/// A changed frame is sent at so many ticks in a row.
const REPEATED: u8 = 2;

/// Frames that are sent at one tick, at most.
pub const MOST_FRAMES: usize = 8;

/// The commands as frames. Allocates nothing after its construction.
pub struct OutputMap {
    /// The message with the counter is the last: nodes act on it.
    sent: Vec<Sent>,
    modulus: u64,
}

/// What is said besides the loop's command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Around {
    /// Counts the commands.
    pub counter: u64,
    /// A run goes on.
    pub running: bool,
    /// The run's preparation.
    pub preparation: Preparation,
}

impl OutputMap {
    /// Looks the commands' signals up.
    ///
    /// # Errors
    /// A signal that does not exist or can't be used, more than [`MOST_FRAMES`] messages; names the rig file's key.
    pub fn new(settings: &CanSettings, database: &Database) -> Result<OutputMap, WiredError> {
        let command = &settings.command;
        let mut wanted = vec![
            ("[can.command] brake_open", Meaning::BrakeOpen, &command.brake_open),
            ("[can.command] bypass_open", Meaning::BypassOpen, &command.bypass_open),
        ];
        wanted.extend(command.running.as_ref().map(|name| ("[can.command] running", Meaning::Running, name)));
        if let Some(fixture) = &settings.fixture {
            wanted.extend([
                ("[can.fixture] kind", Meaning::Kind, &fixture.kind),
                ("[can.fixture] angle_deg", Meaning::AngleDeg, &fixture.angle_deg),
                ("[can.fixture] pressure1_bar", Meaning::Pressure1Bar, &fixture.pressure1_bar),
                ("[can.fixture] pressure2_bar", Meaning::Pressure2Bar, &fixture.pressure2_bar),
                ("[can.fixture] flow_ml_s", Meaning::FlowMlS, &fixture.flow_ml_s),
                ("[can.fixture] segment", Meaning::Segment, &fixture.segment),
                ("[can.fixture] run", Meaning::Run, &fixture.run),
                ("[can.fixture] vertical", Meaning::Vertical, &fixture.vertical),
                ("[can.fixture] fill_bar", Meaning::FillBar, &fixture.fill_bar),
            ]);
        }
        // The message with the counter, or with the brake where there is none, is what nodes act on: last.
        wanted.extend(command.counter.as_ref().map(|name| ("[can.command] counter", Meaning::Counter, name)));
        let sync = command.counter.as_ref().unwrap_or(&command.brake_open);
        let (sync, _) = find(database, sync, || "[can.command]".to_owned())?;

        let mut map = OutputMap { sent: vec![], modulus: 1 << 16 };
        for (key, meaning, name) in wanted {
            let (message, codec) = find(database, name, || key.to_owned())?;
            if meaning == Meaning::Counter {
                map.modulus = modulus(codec);
            }
            map.add(key, message, meaning, codec, message.id == sync.id)?;
        }
        map.sent.sort_by_key(|sent| sent.frame.id == sync.id);
        Ok(map)
    }

    fn add(
        &mut self,
        key: &str,
        message: &Message,
        meaning: Meaning,
        codec: Codec,
        sync: bool,
    ) -> Result<(), WiredError> {
        let place = match self.sent.iter().position(|sent| sent.frame.id == message.id) {
            Some(place) => place,
            None => {
                let mapping =
                    |expected: String, got: String| WiredError::Mapping { key: key.to_owned(), expected, got };
                let frame = Frame::new(message.id, &vec![0; message.length])
                    .ok_or_else(|| mapping("at most 8 bytes".to_owned(), format!("{}", message.length)))?;
                if self.sent.len() == MOST_FRAMES {
                    return Err(mapping(format!("at most {MOST_FRAMES} command messages"), message.name.clone()));
                }
                let every_ticks = match message.cycle_time_ms {
                    Some(cycle_ms) if !sync && cycle_ms > 1.0 => cycle_ms.round() as u32,
                    _ => 1,
                };
                self.sent.push(Sent { frame, signals: vec![], every_ticks, due_in: 0, last: None, repeat: 0 });
                self.sent.len() - 1
            }
        };
        let modulus =
            if matches!(meaning, Meaning::Counter | Meaning::Segment | Meaning::Run) { modulus(codec) } else { 0 };
        self.sent[place].signals.push((meaning, codec, modulus));
        Ok(())
    }

    /// The counter begins anew after so many ticks.
    pub fn modulus(&self) -> u64 {
        self.modulus
    }

    /// The identifiers of the frames that are sent, the one that nodes act on last.
    pub fn ids(&self) -> impl Iterator<Item = FrameId> {
        self.sent.iter().map(|sent| sent.frame.id)
    }

    /// The frames of this tick, in the order in which they are to be sent, into `frames`; how many.
    ///
    /// # Errors
    /// A value that its signal can't hold; nothing is to be sent then.
    pub fn frames(
        &mut self,
        command: &Command,
        around: &Around,
        frames: &mut [Frame; MOST_FRAMES],
    ) -> Result<usize, OutOfRange> {
        let mut count = 0;
        for sent in &mut self.sent {
            for &(meaning, codec, modulus) in &sent.signals {
                codec.encode(meaning.value(command, around, modulus), sent.frame.data_mut())?;
            }
            if sent.last != Some(sent.frame) {
                sent.repeat = REPEATED;
            }
            if sent.every_ticks == 1 || sent.repeat > 0 || sent.due_in == 0 {
                frames[count] = sent.frame;
                count += 1;
                sent.due_in = sent.every_ticks;
            }
            sent.repeat = sent.repeat.saturating_sub(1);
            sent.due_in = sent.due_in.saturating_sub(1);
            sent.last = Some(sent.frame);
        }
        Ok(count)
    }
}

impl Meaning {
    fn value(self, command: &Command, around: &Around, modulus: u64) -> f64 {
        let bit = |set: bool| f64::from(u8::from(set));
        let fixture = FixtureNumbers::from(command.fixture);
        let counted = |n: u64| (n % modulus.max(1)) as f64;
        match self {
            Meaning::BrakeOpen => bit(command.brake_open),
            Meaning::BypassOpen => bit(command.bypass_open),
            Meaning::Counter => counted(around.counter),
            Meaning::Running => bit(around.running),
            Meaning::Kind => f64::from(fixture.kind as u8),
            Meaning::AngleDeg => fixture.angle_deg,
            Meaning::Pressure1Bar => fixture.pressure1_bar,
            Meaning::Pressure2Bar => fixture.pressure2_bar,
            Meaning::FlowMlS => fixture.flow_ml_s,
            Meaning::Segment => counted(u64::from(command.segment)),
            Meaning::Run => counted(u64::from(around.preparation.run)),
            Meaning::Vertical => bit(around.preparation.vertical),
            Meaning::FillBar => around.preparation.fill_bar,
        }
    }
}
