//! What the nodes send: `[can.sensors]` and `[[can.heartbeat]]` from the other end. A sensor with a counter answers every SYNC; a
//! message without one and the heartbeats are sent every `GenMsgCycleTime` (a heartbeat without it twice in the time that the rig file
//! allows).
//!
//! Calibration is inverted: a node sends (value - offset) / gain. What else the database has the same nodes send is sent too, with the
//! signals below filled in by name and all others 0; of multiplexed signals a page at a time.
//!
//! | signal | says |
//! |---|---|
//! | `BrakeIsOpen`, `BypassIsOpen`, `TimedOut` | the valves' node |
//! | `Counter` | counter of the last command, where the message is not mapped |
//! | `TemperatureC`, `SupplyV` | 31.5, 24 |
//! | `Errors` | time-outs and refused commands |

use super::exchange::Answer;
use crate::can::{Frame, FrameId};
use crate::dbc::{Codec, Database, Message};
use crate::wired::signals::{Sensed, heartbeats, modulus, sensed};
use crate::wired::{CanSettings, MappingError};
use rt_core::Input;
use std::collections::BTreeSet;

const TEMPERATURE_C: f64 = 31.5;
const SUPPLY_V: f64 = 24.0;

/// What a signal says.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Meaning {
    Value { gain: f64, offset: f64 },
    Fault,
    Present,
    Counter { modulus: u64 },
    BrakeIsOpen,
    BypassIsOpen,
    TimedOut,
    TemperatureC,
    SupplyV,
    Errors,
}

#[derive(Clone, Copy, Debug)]
struct Mapped {
    meaning: Meaning,
    codec: Codec,
    /// The quantity that it is about; the angle where it is about none.
    input: Input,
    /// There is a signal that says whether there is a value.
    has_present: bool,
}

/// A message that the nodes send.
struct Sent {
    frame: Frame,
    signals: Vec<Mapped>,
    /// ns between two of them; `None` = on every SYNC.
    period_ns: Option<u64>,
    due_ns: u64,
    /// Multiplexed signals, one of which is in the next frame; places in `signals`.
    pages: Vec<usize>,
    page: usize,
}

/// Measured quantities to frames.
pub struct SensorMap {
    sent: Vec<Sent>,
    encoder: Option<FrameId>,
}

impl SensorMap {
    /// Looks the sensors' signals up.
    ///
    /// # Errors
    /// A signal or a message that does not exist or can't be used; names the rig file's key.
    pub fn new(settings: &CanSettings, database: &Database) -> Result<SensorMap, MappingError> {
        let mut map = SensorMap { sent: vec![], encoder: None };
        for sensor in &sensed(settings, database)? {
            map.add_sensor(sensor);
            if sensor.input == Input::Angle {
                map.encoder = Some(sensor.message.id);
            }
        }
        for (heartbeat, message) in heartbeats(settings, database)? {
            if !map.sent.iter().any(|sent| sent.frame.id == message.id) {
                // The rig file says how long it may be silent at most.
                map.add_cyclic(message, message.cycle_time_ms.unwrap_or(0.5 * heartbeat.period_ms));
            }
        }
        let nodes: BTreeSet<&str> =
            map.sent.iter().filter_map(|s| database.by_id(s.frame.id)?.sender.as_deref()).collect();
        let others = database.messages().iter().filter(|message| {
            message.sender.as_deref().is_some_and(|sender| nodes.contains(sender))
                && !map.sent.iter().any(|sent| sent.frame.id == message.id)
        });
        let others: Vec<(&Message, f64)> = others.filter_map(|m| Some((m, m.cycle_time_ms?))).collect();
        others.into_iter().for_each(|(message, period_ms)| map.add_cyclic(message, period_ms));
        // In the order of priority on the bus.
        map.sent.sort_by_key(|sent| sent.frame.id);
        Ok(map)
    }

    fn add_sensor(&mut self, sensed: &Sensed<'_>) {
        let Sensed { input, sensor, message, value, fault, present, counter } = *sensed;
        let place = match self.sent.iter().position(|sent| sent.frame.id == message.id) {
            Some(place) => place,
            None => {
                self.sent.push(Sent::new(message, message.cycle_time_ms.filter(|&cycle_ms| cycle_ms > 1.0)));
                self.sent.len() - 1
            }
        };
        let sent = &mut self.sent[place];
        if counter.is_some() {
            sent.period_ns = None;
        }
        // The value first: whether it fits decides what its fault says.
        let signals = [
            Some((Meaning::Value { gain: sensor.gain, offset: sensor.offset }, value)),
            fault.map(|codec| (Meaning::Fault, codec)),
            present.map(|codec| (Meaning::Present, codec)),
            counter.map(|codec| (Meaning::Counter { modulus: modulus(codec) }, codec)),
        ];
        let has_present = present.is_some();
        let mapped = |(meaning, codec)| Mapped { meaning, codec, input, has_present };
        sent.signals.extend(signals.into_iter().flatten().map(mapped));
    }

    fn add_cyclic(&mut self, message: &Message, period_ms: f64) {
        let mut sent = Sent::new(message, Some(period_ms));
        for signal in message.signals() {
            let meaning = match signal.name.as_str() {
                "BrakeIsOpen" => Meaning::BrakeIsOpen,
                "BypassIsOpen" => Meaning::BypassIsOpen,
                "TimedOut" => Meaning::TimedOut,
                "Counter" => Meaning::Counter { modulus: modulus(signal.codec) },
                "TemperatureC" => Meaning::TemperatureC,
                "SupplyV" => Meaning::SupplyV,
                "Errors" => Meaning::Errors,
                _ => continue,
            };
            if signal.codec.is_multiplexed() {
                sent.pages.push(sent.signals.len());
            }
            sent.signals.push(Mapped { meaning, codec: signal.codec, input: Input::Angle, has_present: true });
        }
        self.sent.push(sent);
    }

    /// The frames that answer a SYNC.
    pub fn answers(&mut self, answer: &Answer, errors: u64, mut send: impl FnMut(Frame)) {
        for sent in self.sent.iter_mut().filter(|sent| sent.period_ns.is_none()) {
            send(sent.filled(answer, errors));
        }
    }

    /// The frames that are due by now.
    pub fn due(&mut self, now_ns: u64, answer: &Answer, errors: u64, mut send: impl FnMut(Frame)) {
        for sent in &mut self.sent {
            let Some(period_ns) = sent.period_ns.filter(|_| now_ns >= sent.due_ns) else { continue };
            send(sent.filled(answer, errors));
            // A node that was held up does not make up for it.
            let next_ns = sent.due_ns.saturating_add(period_ns);
            sent.due_ns = if next_ns > now_ns { next_ns } else { now_ns.saturating_add(period_ns) };
        }
    }

    /// The encoder's answer by a second node of the same identifier whose lever is elsewhere.
    pub fn encoder_twin(&mut self, answer: &Answer, errors: u64) -> Option<Frame> {
        let mut other = *answer;
        other.measurement.angle_deg += 90.0;
        let id = self.encoder?;
        self.sent.iter_mut().find(|sent| sent.frame.id == id).map(|sent| sent.filled(&other, errors))
    }
}

impl Sent {
    fn new(message: &Message, period_ms: Option<f64>) -> Sent {
        let frame =
            Frame::new(message.id, &[0; 8][..message.length.min(8)]).expect("the length is cut to what a frame holds");
        // Cast saturates; a period of less than the clock can tell is every time.
        let period_ns = period_ms.map(|ms| (ms * 1e6) as u64);
        Sent { frame, signals: vec![], period_ns, due_ns: 0, pages: vec![], page: 0 }
    }

    fn filled(&mut self, answer: &Answer, errors: u64) -> Frame {
        let page = self.pages.get(self.page).copied();
        self.page = if self.page + 1 < self.pages.len() { self.page + 1 } else { 0 };
        let mut frame = self.frame;
        // Each sensor's fault is known after its value was put in.
        let mut out_of_range = 0;
        for (place, mapped) in self.signals.iter().enumerate() {
            let data = frame.data_mut();
            let Mapped { meaning, codec, input, has_present } = *mapped;
            if codec.is_multiplexed() {
                if page != Some(place) && self.pages.contains(&place) {
                    continue;
                }
                // Fails only where the frame is too short; then the value does not fit in either.
                let _ = codec.select(data);
            }
            let value = answer.measurement.value(input);
            let bit = |set: bool| f64::from(u8::from(set));
            let said = match meaning {
                Meaning::Value { gain, offset } if value.is_finite() => (value - offset) / gain,
                Meaning::Value { .. } => {
                    if !has_present {
                        out_of_range |= input.bit();
                    }
                    0.0
                }
                Meaning::Fault => bit((answer.measurement.faulty | out_of_range) & input.bit() != 0),
                Meaning::Present => bit(value.is_finite()),
                Meaning::Counter { modulus } => (answer.counter % modulus) as f64,
                Meaning::BrakeIsOpen => bit(answer.brake_is_open),
                Meaning::BypassIsOpen => bit(answer.bypass_is_open),
                Meaning::TimedOut => bit(answer.timed_out),
                Meaning::TemperatureC => TEMPERATURE_C,
                Meaning::SupplyV => SUPPLY_V,
                Meaning::Errors => errors as f64,
            };
            let (low, high) = codec.range();
            let shown = said.clamp(low, high);
            if shown != said && matches!(meaning, Meaning::Value { .. }) {
                // A sensor at its stop says so.
                out_of_range |= input.bit();
            }
            // In range and, as the database was checked, within the frame.
            let _ = codec.encode(shown, data);
        }
        frame
    }
}
