//! A rig file as it was understood: devices, mapping, budget. For people and, serialised, for machines.

use super::{DeviceSpec, Rig};
use crate::failure::{Failure, Kind};
use crate::setup::Knowledge;
use drivers::amplifier::protocol;
use drivers::budget::{Load, can_load, serial_load};
use drivers::can::MOST_BYTES;
use drivers::dbc::{Codec, Database};
use drivers::wired::Settings;
use rt_core::Limits;
use serde::Serialize;

/// What a rig file says, with what follows from it.
#[derive(Debug, Serialize)]
pub struct Understood {
    /// Name of the rig.
    pub name: String,
    /// `emulated` or `wired`.
    pub device: &'static str,
    /// One line on each part.
    pub parts: Vec<Part>,
    /// Quantities and commands on the bus; none for an emulated rig.
    pub mapping: Vec<Mapped>,
    /// Each wire; none for an emulated rig.
    pub budget: Vec<Wire>,
    /// Largest share of each wire.
    pub most_share: f64,
}

/// A part of the rig.
#[derive(Debug, Serialize)]
pub struct Part {
    /// Which.
    pub name: &'static str,
    /// As it was understood.
    pub is: String,
}

/// A quantity or a command, and where it is on the bus.
#[derive(Debug, Serialize)]
pub struct Mapped {
    /// Key of the rig file.
    pub key: String,
    /// Message of the database.
    pub message: String,
    /// Its identifier, hexadecimal; eight digits where it is an extended one.
    pub id: String,
    /// Signal of the message; empty for a heartbeat.
    pub signal: String,
    /// Where its bits are.
    pub bits: String,
    /// Channel's value = gain * signal + offset; none where nothing is calibrated.
    pub gain: Option<f64>,
    /// See `gain`.
    pub offset: Option<f64>,
    /// Unit after gain and offset, empty for a number without.
    pub unit: String,
}

/// What a wire has to carry.
#[derive(Debug, Serialize)]
pub struct Wire {
    /// Which.
    pub wire: String,
    /// What goes over it, bits a tick on average.
    pub entries: Vec<(String, f64)>,
    /// Their sum.
    pub bits: f64,
    /// What it carries in a tick, bits.
    pub carries_bits: f64,
    /// Sum over what it carries.
    pub share: f64,
    /// Bits of a tick in which everything comes together.
    pub busiest_bits: f64,
    /// What was not counted, and why.
    pub not_counted: Vec<String>,
    /// The sum in words.
    pub sum: String,
}

impl Understood {
    /// Of a rig that was read.
    ///
    /// # Errors
    /// A database that is no longer what it was when the rig was read (2).
    pub fn of(rig: &Rig) -> Result<Understood, Failure> {
        let Rig { name, facts, limits, device, knowledge, most_share, .. } = rig;
        let part = |name, is| Part { name, is };
        let mut parts = vec![part(
            "facts",
            format!("J = {} kg m2, G = {} Nm, u_max = {} V", facts.inertia_kg_m2, facts.gravity_nm, facts.u_max_v),
        )];
        let known = match knowledge {
            Knowledge::Nothing => "no model: targets of voltage only".to_owned(),
            Knowledge::Pump(_) => "model of the pump: targets of voltage and flow".to_owned(),
            Knowledge::Model(..) => "model of the rig: targets of voltage, flow, pressure and angle".to_owned(),
        };
        parts.extend([
            part("controller", known),
            part("limits", spelled(limits)),
            part("safe state", safe_state(limits)),
        ]);
        let mut understood = Understood {
            name: name.clone(),
            device: "emulated",
            parts,
            mapping: vec![],
            budget: vec![],
            most_share: *most_share,
        };
        if let DeviceSpec::Wired(settings) = device {
            understood.device = "wired";
            understood.wires(settings, facts.u_max_v)?;
        }
        Ok(understood)
    }

    fn wires(&mut self, settings: &Settings, u_max_v: f64) -> Result<(), Failure> {
        let Settings { amplifier, can } = settings;
        let database = Database::read(&can.dbc).map_err(|e| Failure::of(Kind::Input, &e))?;
        let refused = |e: drivers::amplifier::AmplifierError| Failure::of(Kind::Input, &e);
        let kind = protocol(&amplifier.protocol).map_err(refused)?;
        let resolution_v = (kind.client)(amplifier).map_err(refused)?.resolution_v();
        let reversed = if amplifier.reversed { ", reversed" } else { "" };
        let is = format!(
            "{} on {}, {} baud, {} V at full scale in steps of {:.2} mV{reversed}; telemetry every {} ticks, given up after {} ms",
            kind.title,
            amplifier.port.display(),
            amplifier.baud,
            amplifier.full_scale_v,
            1e3 * resolution_v,
            amplifier.telemetry_every_ticks,
            amplifier.timeout_ms
        );
        self.parts.push(Part { name: "amplifier", is });
        let most_v = kind.delivered_share * amplifier.full_scale_v;
        // 0.95 x 24 is a hair less than 22.8.
        if u_max_v > most_v * (1.0 + 1e-9) {
            let is = format!(
                "{} clips at {} % of full scale unless it is told otherwise, here {most_v:.2} V: what is commanded beyond that is recorded and \
                 never reaches the pump; lower [rig] u_max_v = {u_max_v}",
                kind.title,
                1e2 * kind.delivered_share
            );
            self.parts.push(Part { name: "warning", is });
        }
        let count = database.messages().len();
        let is = format!("{}, {} bit/s, {} with {count} messages", can.interface, can.bitrate, can.dbc.display());
        self.parts.push(Part { name: "bus", is });
        self.map(settings, &database);
        let serial = serial_load(amplifier).map_err(refused)?;
        self.budget =
            serial.into_iter().chain([can_load(&database, can)]).map(|load| wire(load, self.most_share)).collect();
        Ok(())
    }

    fn map(&mut self, settings: &Settings, database: &Database) {
        let can = &settings.can;
        let mut add = |key: String, path: &str, calibrated: Option<(f64, f64, &str)>| {
            // Every signal was found when the file was read.
            let Ok((message, signal)) = database.signal(path) else { return };
            let (gain, offset) = calibrated.map(|(gain, offset, _)| (gain, offset)).unzip();
            self.mapping.push(Mapped {
                key,
                message: message.name.clone(),
                id: message.id.to_string(),
                signal: signal.name.clone(),
                bits: places(&signal.codec, message.length),
                gain,
                offset,
                unit: calibrated.map_or(signal.unit.as_str(), |(_, _, unit)| unit).to_owned(),
            });
        };
        let channels = [
            ("angle_deg", "deg"),
            ("pressure1_bar", "bar"),
            ("pressure2_bar", "bar"),
            ("torque_nm", "Nm"),
            ("volume_ml", "ml"),
        ];
        for (sensor, (name, unit)) in can.sensors.by_input().into_iter().zip(channels) {
            let Some(sensor) = sensor else { continue };
            add(name.to_owned(), &sensor.signal, Some((sensor.gain, sensor.offset, unit)));
            for (part, path) in [("fault", &sensor.fault), ("present", &sensor.present), ("counter", &sensor.counter)] {
                path.iter().for_each(|path| add(format!("{name} {part}"), path, None));
            }
        }
        let command = &can.command;
        let both = [("brake_open", &command.brake_open), ("bypass_open", &command.bypass_open)];
        both.into_iter().for_each(|(name, path)| add(format!("command {name}"), path, None));
        for (name, path) in [("counter", &command.counter), ("running", &command.running)] {
            path.iter().for_each(|path| add(format!("command {name}"), path, None));
        }
        for (name, path) in can.fixture.iter().flat_map(|fixture| fixture.by_key()) {
            add(format!("fixture {name}"), path, None);
        }
        for heartbeat in &can.heartbeat {
            let Some(message) = database.message(&heartbeat.message) else { continue };
            self.mapping.push(Mapped {
                key: format!("heartbeat, {} ms", heartbeat.period_ms),
                message: message.name.clone(),
                id: message.id.to_string(),
                signal: String::new(),
                bits: format!("{} bytes", message.length),
                gain: None,
                offset: None,
                unit: String::new(),
            });
        }
    }
}

fn wire(load: Load, most_share: f64) -> Wire {
    // A rig that was read fits.
    let sum = load.judge(most_share).unwrap_or_else(|over| over);
    let (bits, share) = (load.bits(), load.share());
    let Load { wire, carries_bits, entries, busiest_bits, not_counted, .. } = load;
    let entries = entries.into_iter().map(|entry| (entry.what, entry.bits)).collect();
    Wire { wire, entries, bits, carries_bits, share, busiest_bits, not_counted, sum }
}

fn spelled(limits: &Limits) -> String {
    let Limits {
        pressure_min_bar, pressure_max_bar, angle_max_deg, velocity_max_deg_s, torque_max_nm, age_max_ms, ..
    } = limits;
    // Where the file gives none it lies a billionth above u_max, which is for the machine.
    let voltage_max_v = (limits.voltage_max_v * 1e6).round() / 1e6;
    format!(
        "{pressure_min_bar}..{pressure_max_bar} bar, {angle_max_deg} deg, {velocity_max_deg_s} deg/s, {torque_max_nm} Nm, {voltage_max_v} V; values at most \
         {age_max_ms} ms old, heartbeats {} ms",
        limits.heartbeat_max_ms
    )
}

fn safe_state(limits: &Limits) -> String {
    let valve = |open| if open { "open" } else { "closed" };
    let state = limits.safe_state;
    format!("pump 0 V, brake {}, bypass {}", valve(state.brake_open), valve(state.bypass_open))
}

/// Where a signal's bits are, found by trying each: bit n is bit n mod 8 of byte n / 8.
fn places(codec: &Codec, length: usize) -> String {
    let length = length.min(MOST_BYTES);
    let mut low = [0; MOST_BYTES];
    // The frame is as long as its message: it has room for signal and multiplexors.
    let _ = codec.select(&mut low[..length]);
    let mut high = low;
    let _ = codec.encode(codec.range().1, &mut high[..length]);
    let of = |data: &[u8]| codec.decode(&data[..length]).map(f64::to_bits);
    // From two values: the sign of a float's 0 does not show.
    let moves = |bit: &usize| {
        [low, high].into_iter().any(|base| {
            let mut data = base;
            data[bit / 8] ^= 1 << (bit % 8);
            // A flipped bit of a multiplexor takes the signal away.
            of(&data).is_some_and(|value| Some(value) != of(&base))
        })
    };
    let bits: Vec<usize> = (0..8 * length).filter(moves).collect();
    match bits.as_slice() {
        [] => "none".to_owned(),
        [bit] => format!("1, byte {} bit {}", bit / 8, bit % 8),
        [first, .., last] if first / 8 == last / 8 => format!("{}, byte {}", bits.len(), first / 8),
        [first, .., last] => format!("{}, bytes {}-{}", bits.len(), first / 8, last / 8),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_is_found_bit_by_bit() {
        let text = "BU_: A\n\nBO_ 1 M: 8 A\n SG_ Mux M : 0|4@1+ (1,0) [0|0] \"\" A\n SG_ Bit : 4|1@1+ (1,0) [0|0] \"\" A\n \
                    SG_ Big : 15|16@0- (0.1,3) [0|0] \"\" A\n SG_ Float m3 : 32|32@1- (1e-30,0) [0|0] \"\" A\n SG_ Small : 24|7@1+ (1,0) [0|0] \"\" A\n\n\
                    SIG_VALTYPE_ 1 Float : 1;\n";
        let database = Database::parse(text, "a.dbc").expect("sound");
        for (signal, expected) in [
            ("Mux", "4, byte 0"),
            ("Bit", "1, byte 0 bit 4"),
            ("Big", "16, bytes 1-2"),
            ("Small", "7, byte 3"),
            ("Float", "32, bytes 4-7"),
        ] {
            let (message, signal) = database.signal(&format!("M.{signal}")).expect("is there");
            assert_eq!(places(&signal.codec, message.length), expected, "{}", signal.name);
        }
    }
}
