//! The bench's side.

use super::frame::{Deframer, encode};
use super::{FULL_DUTY, comm, fault};
use crate::amplifier::{
    AmplifierError, AmplifierSettings, Bytes, Firmware, Garbled, LONGEST_NAME, Outbox, Protocol, Scale, Telemetry,
    Told, Traffic,
};
use arrayvec::ArrayString;

/// Values that are asked for: temperature of the output stage, motor current, duty, electrical speed, supply, fault.
const MASK: u32 = 1 << 0 | 1 << 2 | 1 << 6 | 1 << 7 | 1 << 8 | 1 << 15;

/// Speaks to a VESC.
pub struct Client {
    scale: Scale,
    pole_pairs: f32,
    deframer: Deframer,
}

impl Client {
    /// For these settings.
    ///
    /// # Errors
    /// `full_scale_v` or `vesc.pole_pairs` out of range.
    pub fn new(settings: &AmplifierSettings) -> Result<Client, AmplifierError> {
        Ok(Client { scale: Scale::of(settings)?, pole_pairs: pole_pairs(settings)?, deframer: Deframer::default() })
    }
}

pub(super) fn pole_pairs(settings: &AmplifierSettings) -> Result<f32, AmplifierError> {
    match settings.vesc.pole_pairs {
        0 => Err(AmplifierError::OutOfRange { key: "vesc.pole_pairs", value: 0.0, expected: "1 to 255" }),
        pairs => Ok(pairs.into()),
    }
}

impl Protocol for Client {
    fn hello(&mut self, out: &mut Outbox) {
        encode(&[comm::FW_VERSION], out);
    }

    fn command(&mut self, voltage_v: f64, out: &mut Outbox) {
        // In range: the share is in [-1, 1].
        let duty = (self.scale.share(voltage_v) * FULL_DUTY).round() as i32;
        let [a, b, c, d] = duty.to_be_bytes();
        encode(&[comm::SET_DUTY, a, b, c, d], out);
    }

    fn request(&mut self, out: &mut Outbox) {
        let [a, b, c, d] = MASK.to_be_bytes();
        encode(&[comm::GET_VALUES_SELECTIVE, a, b, c, d], out);
    }

    fn keep_alive(&mut self, out: &mut Outbox) {
        encode(&[comm::ALIVE], out);
    }

    fn hear(&mut self, bytes: &[u8], told: &mut dyn FnMut(Told)) {
        let (scale, pole_pairs) = (self.scale, self.pole_pairs);
        self.deframer.hear(bytes, |payload| {
            // What else a VESC may say (prints, answers to another program on the same line) is sound, and not for us.
            let said = match payload {
                [comm::FW_VERSION, version @ ..] => firmware(version).map(Told::Hello),
                [comm::GET_VALUES_SELECTIVE, values @ ..] => telemetry(values, &scale, pole_pairs).map(Told::Telemetry),
                _ => None,
            };
            if let Some(said) = said {
                told(said);
            }
        });
    }

    fn garbled(&self) -> Garbled {
        self.deframer.garbled()
    }

    fn reset(&mut self) {
        self.deframer = Deframer::default();
    }

    fn traffic(&self) -> Traffic {
        Traffic {
            command: Bytes { out: 10, back: 0 },
            request: Bytes { out: 10, back: 25 },
            keep_alive: Bytes { out: 6, back: 0 },
        }
    }

    fn resolution_v(&self) -> f64 {
        self.scale.full_scale_v / FULL_DUTY
    }
}

/// Version and the name of the hardware, which ends with a 0; firmware before 3 sent the version alone.
fn firmware(version: &[u8]) -> Option<Firmware> {
    let [major, minor, name @ ..] = version else { return None };
    let mut hardware = ArrayString::<LONGEST_NAME>::new();
    for &byte in name.iter().take_while(|byte| **byte != 0) {
        let shown = if byte.is_ascii_graphic() || byte == b' ' { byte as char } else { '?' };
        if hardware.try_push(shown).is_err() {
            break;
        }
    }
    Some(Firmware { hardware, major: (*major).into(), minor: (*minor).into() })
}

/// Values that came, if they are those that were asked for: two bytes temperature * 10, four current * 100, two duty * 1000, four
/// electrical speed, two supply * 10, one fault.
fn telemetry(values: &[u8], scale: &Scale, pole_pairs: f32) -> Option<Telemetry> {
    let (mask, values) = values.split_first_chunk()?;
    if u32::from_be_bytes(*mask) != MASK {
        return None;
    }
    let &[t0, t1, i0, i1, i2, i3, d0, d1, n0, n1, n2, n3, u0, u1, code] = values else { return None };
    let two = |a, b| f32::from(i16::from_be_bytes([a, b]));
    let four = |a, b, c, d| i32::from_be_bytes([a, b, c, d]) as f32;
    Some(Telemetry {
        temperature_c: two(t0, t1) / 10.0,
        motor_current_a: scale.turned(four(i0, i1, i2, i3) / 100.0),
        duty: scale.turned(two(d0, d1) / 1000.0),
        speed_rpm: scale.turned(four(n0, n1, n2, n3) / pole_pairs),
        supply_v: two(u0, u1) / 10.0,
        fault: fault(code),
    })
}
