//! The command of a tick to frames: valves, `running` and counter every tick, in whichever message they are; the fixture when it changes and every now and
//! then.

use super::Preparation;
use super::fixture::FixtureNumbers;
use super::settings::CanSettings;
use super::signals::{Commanded, MappingError, Meaning, commanded, modulus};
use crate::can::{Frame, FrameId};
use crate::dbc::{Codec, Database, OutOfRange};
use rt_core::Command;

/// A message that is sent, with what its signals say.
struct Sent {
    frame: Frame,
    /// With how many values each can count.
    signals: Vec<(Meaning, Codec, u64)>,
    /// It is sent again after so many ticks; 1 = every tick.
    every_ticks: u32,
    /// Ticks until then.
    due_in: u32,
    /// As it was sent last.
    last: Option<Frame>,
    /// Ticks for which a change is still repeated, on a line that spoils one frame.
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
    pub fn new(settings: &CanSettings, database: &Database) -> Result<OutputMap, MappingError> {
        let (signals, sync) = commanded(settings, database)?;
        let counter = signals.iter().find(|signal| signal.meaning == Meaning::Counter);
        let mut map = OutputMap { sent: vec![], modulus: counter.map_or(1 << 16, |counter| modulus(counter.codec)) };
        for signal in &signals {
            map.add(signal, signal.message.id == sync.id)?;
        }
        // What nodes act on is the last.
        map.sent.sort_by_key(|sent| sent.frame.id == sync.id);
        Ok(map)
    }

    fn add(&mut self, signal: &Commanded<'_>, sync: bool) -> Result<(), MappingError> {
        let Commanded { key, meaning, message, codec } = *signal;
        let place = match self.sent.iter().position(|sent| sent.frame.id == message.id) {
            Some(place) => place,
            None => {
                let refused =
                    |expected: String, got: String| MappingError::Setting { key: key.to_owned(), expected, got };
                let frame = Frame::new(message.id, &vec![0; message.length])
                    .ok_or_else(|| refused("at most 8 bytes".to_owned(), format!("{}", message.length)))?;
                if self.sent.len() == MOST_FRAMES {
                    return Err(refused(format!("at most {MOST_FRAMES} command messages"), message.name.clone()));
                }
                let every_ticks = message.cycle_time_ms.map_or(1.0, |cycle_ms| cycle_ms.round().max(1.0)) as u32;
                self.sent.push(Sent { frame, signals: vec![], every_ticks, due_in: 0, last: None, repeat: 0 });
                self.sent.len() - 1
            }
        };
        let sent = &mut self.sent[place];
        if sync || meaning.is_of_every_tick() {
            sent.every_ticks = 1;
        }
        sent.signals.push((meaning, codec, modulus(codec)));
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
    /// Whatever its message's cycle is by the database: nodes time out without it, and the safe state must be in the last set of all.
    fn is_of_every_tick(self) -> bool {
        matches!(self, Meaning::BrakeOpen | Meaning::BypassOpen | Meaning::Counter | Meaning::Running)
    }

    fn value(self, command: &Command, around: &Around, modulus: u64) -> f64 {
        let bit = |set: bool| f64::from(u8::from(set));
        let fixture = FixtureNumbers::from(command.fixture);
        let counted = |n: u64| (n % modulus) as f64;
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
