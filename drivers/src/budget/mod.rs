//! What a configuration asks of its wires: bits on the serial port and on the bus, against what these carry in a tick.
//!
//! Serial: a byte is 10 bits on the wire (8N1), each direction has a wire of its own. CAN: a frame is counted with the most stuff bits
//! that it can have; identifiers and data are not known beforehand, and a bus that only fits as a rule is late now and then.

use crate::amplifier::{AmplifierError, Traffic, protocol};
use crate::can::{FrameId, MOST_BYTES};
use crate::dbc::{Database, Message};
use crate::wired::settings::{AmplifierSettings, CanSettings};
use std::collections::BTreeSet;

/// Bits of a byte on a serial line: start, eight of data, stop.
pub const BITS_PER_SERIAL_BYTE: f64 = 10.0;

const TICK_S: f64 = rt_core::PERIOD_NS as f64 * 1e-9;
const TICK_MS: f64 = TICK_S * 1e3;

/// What goes over one wire.
#[derive(Clone, Debug, PartialEq)]
pub struct Load {
    /// Which.
    pub wire: String,
    /// Bits that it carries in a tick.
    pub carries_bits: f64,
    /// What goes over it.
    pub entries: Vec<Entry>,
    /// Bits of a tick in which everything comes together.
    pub busiest_bits: f64,
    /// Whether the busiest tick must fit, not only the mean: commands may not pile up.
    pub busiest_must_fit: bool,
    /// What was not counted, and why.
    pub not_counted: Vec<String>,
}

/// A part of a load.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// What it is and how often it comes.
    pub what: String,
    /// Bits a tick, on average.
    pub bits: f64,
}

impl Load {
    /// Bits a tick, on average.
    pub fn bits(&self) -> f64 {
        self.entries.iter().map(|entry| entry.bits).sum()
    }

    /// Share of the wire, 1 = full.
    pub fn share(&self) -> f64 {
        self.bits() / self.carries_bits
    }

    /// The sum, against what may be.
    ///
    /// # Errors
    /// The same sum, with what there is too much of, for a load above `most_share` of the wire, and for a busiest tick that must fit and
    /// does not.
    pub fn judge(&self, most_share: f64) -> Result<String, String> {
        let Load { wire, carries_bits, busiest_bits, .. } = self;
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let sum = format!("{wire}: {:.1} of {carries_bits:.1} bits a tick = {}", self.bits(), percent(self.share()));
        if self.share() > most_share {
            return Err(format!("{sum}, more than {}", percent(most_share)));
        }
        if self.busiest_must_fit && busiest_bits > carries_bits {
            return Err(format!(
                "{sum}, but {busiest_bits:.1} bits in a tick in which all comes together, more than it carries"
            ));
        }
        Ok(format!("{sum}, at most {}", percent(most_share)))
    }
}

/// Both directions of the serial port: to the amplifier, from the amplifier.
///
/// A command goes out every tick; each carries the next keep-alive's meaning, so none is counted.
///
/// # Errors
/// A protocol or settings that make no sense.
pub fn serial_load(settings: &AmplifierSettings) -> Result<[Load; 2], AmplifierError> {
    let Traffic { command, request, .. } = (protocol(&settings.protocol)?.client)(settings)?.traffic();
    let every = settings.telemetry_every_ticks.max(1);
    let load = |direction: &str, names: [&str; 2], bytes: [usize; 2], busiest_must_fit| {
        let bits = bytes.map(|bytes| bytes as f64 * BITS_PER_SERIAL_BYTE);
        let entries = vec![
            Entry { what: format!("{}, {} bytes every tick", names[0], bytes[0]), bits: bits[0] },
            Entry {
                what: format!("{}, {} bytes every {every} ticks", names[1], bytes[1]),
                bits: bits[1] / f64::from(every),
            },
        ];
        Load {
            wire: format!("serial port, {direction}"),
            carries_bits: f64::from(settings.baud) * TICK_S,
            // A direction may be unused: a protocol without acknowledgement.
            entries: entries.into_iter().filter(|entry| entry.bits > 0.0).collect(),
            busiest_bits: bits.iter().sum(),
            busiest_must_fit,
            not_counted: vec![],
        }
    };
    Ok([
        load("to the amplifier", ["command", "request for telemetry"], [command.out, request.out], true),
        // A long answer may take more than a tick: it delays nothing but itself.
        load("from the amplifier", ["acknowledgement", "telemetry"], [command.back, request.back], false),
    ])
}

/// The bus. Signals and messages that the database does not have are left out: they are an error of their own.
///
/// Commands are counted every tick; messages of the fixture that hold no angle come at their cycle time and on a change. Everything else
/// comes at its cycle time, sensors and heartbeats without one every tick.
pub fn can_load(database: &Database, settings: &CanSettings) -> Load {
    let named = |path: &str| database.signal(path).ok().map(|(message, _)| message.id);
    let mut every_tick = BTreeSet::new();
    let command = &settings.command;
    every_tick.extend([&command.brake_open, &command.bypass_open].into_iter().filter_map(|path| named(path)));
    every_tick.extend([&command.counter, &command.running].into_iter().flatten().filter_map(|path| named(path)));
    let mut mapped: BTreeSet<FrameId> = BTreeSet::new();
    if let Some(fixture) = &settings.fixture {
        // A lever that is led changes its angle every tick.
        every_tick.extend(named(&fixture.angle_deg));
        mapped.extend(fixture.by_key().into_iter().filter_map(|(_, path)| named(path)));
    }
    mapped.extend(settings.sensors.by_input().into_iter().flatten().filter_map(|sensor| named(&sensor.signal)));
    mapped.extend(settings.heartbeat.iter().filter_map(|beat| database.message(&beat.message)).map(|m| m.id));

    let mut load = Load {
        wire: format!("CAN {}", settings.interface),
        carries_bits: f64::from(settings.bitrate) * TICK_S,
        entries: vec![],
        busiest_bits: 0.0,
        busiest_must_fit: false,
        not_counted: vec![],
    };
    for message in database.messages() {
        let Message { name, id, length, cycle_time_ms, .. } = message;
        if *length > MOST_BYTES {
            load.not_counted.push(format!("{name} {id}: {length} bytes, no classic frame"));
            continue;
        }
        let (every_ms, how) = match cycle_time_ms {
            _ if every_tick.contains(id) => (TICK_MS, "every tick".to_owned()),
            Some(ms) => (*ms, format!("every {ms} ms")),
            None if mapped.contains(id) => (TICK_MS, "every tick, as it has no GenMsgCycleTime".to_owned()),
            None => {
                load.not_counted.push(format!("{name} {id}: not mapped, and no GenMsgCycleTime"));
                continue;
            }
        };
        let bits = f64::from(most_frame_bits(*id, *length));
        let what = format!("{name} {id}, {length} bytes, {bits} bits {how}");
        load.entries.push(Entry { what, bits: bits * TICK_MS / every_ms });
        // More than one in a tick where they come faster than the tick.
        load.busiest_bits += bits * (TICK_MS / every_ms).ceil().max(1.0);
    }
    load
}

/// Most bits that a classic data frame with so many bytes (0..=8) can take on the bus, stuff bits and the three of the space between
/// frames included.
///
/// ISO 11898-1: 44 bits (64 for an extended identifier) of frame around the data and 3 of intermission; from the start bit to the end of
/// the checksum, 34 (54) bits and the data, a bit is stuffed after five equal ones. A stuffed bit is the first of the next five: at most one
/// for the first five bits and one for every four after them.
pub fn most_frame_bits(id: FrameId, bytes: usize) -> u32 {
    let data = 8 * bytes.min(MOST_BYTES) as u32;
    let (fixed, stuffed) = match id {
        FrameId::Standard(_) => (47, 34),
        FrameId::Extended(_) => (67, 54),
    };
    fixed + data + (stuffed + data - 1) / 4
}

#[cfg(test)]
mod tests;
