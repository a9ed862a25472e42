//! An emulated VESC.

use super::client::pole_pairs;
use super::frame::{Deframer, encode};
use super::{FULL_DUTY, comm};
use crate::amplifier::{AmplifierError, AmplifierSettings, Drive, DriveState, Garbled, InForce, Outbox, Scale};
use arrayvec::ArrayVec;

/// Timeout of the firmware unless it is configured (`timeout_msec` in `timeout.c`), ns.
const TIMEOUT_NS: u64 = 1_000_000_000;
/// What it says it is.
const HARDWARE: &[u8] = b"REC_BENCH\0";
const VERSION: [u8; 2] = [6, 6];
const CONTROLLER_ID: u8 = 0;

/// Payload of an answer; the longest is `COMM_GET_VALUES` with 78 bytes.
type Answer = ArrayVec<u8, 96>;

/// Answers as a VESC with firmware 6.06 does: `COMM_FW_VERSION`, `COMM_GET_VALUES`, `COMM_GET_VALUES_SELECTIVE` with any mask; obeys
/// `COMM_SET_DUTY`. The other commands that drive the motor (current, brake, speed, position) are obeyed as 0 V. The rest is ignored,
/// as a firmware does that does not know a command.
pub struct Emulated {
    scale: Scale,
    pole_pairs: f32,
    deframer: Deframer,
    in_force: InForce,
}

impl Emulated {
    /// For these settings.
    ///
    /// # Errors
    /// `full_scale_v` or `vesc.pole_pairs` out of range.
    pub fn new(settings: &AmplifierSettings) -> Result<Emulated, AmplifierError> {
        Ok(Emulated {
            scale: Scale::of(settings)?,
            pole_pairs: pole_pairs(settings)?,
            deframer: Deframer::default(),
            in_force: InForce::new(Some(TIMEOUT_NS)),
        })
    }
}

impl Drive for Emulated {
    fn hear(&mut self, bytes: &[u8], now_ns: u64, state: &DriveState, out: &mut Outbox) -> Option<f64> {
        let Emulated { scale, pole_pairs, deframer, in_force } = self;
        let mut newest = None;
        deframer.hear(bytes, |payload| match *payload {
            [comm::SET_DUTY, a, b, c, d] => {
                let voltage_v = scale.voltage_v(f64::from(i32::from_be_bytes([a, b, c, d])) / FULL_DUTY);
                in_force.command(voltage_v, now_ns);
                newest = Some(voltage_v);
            }
            [comm::SET_CURRENT..=comm::SET_HANDBRAKE, _, _, _, _] => {
                in_force.command(0.0, now_ns);
                newest = Some(0.0);
            }
            [comm::ALIVE] => in_force.alive(now_ns),
            [comm::FW_VERSION] => answer_version(out),
            [comm::GET_VALUES] => {
                let mut answer = Answer::new();
                answer.push(comm::GET_VALUES);
                values(u32::MAX, state, scale, *pole_pairs, in_force.timed_out(now_ns), &mut answer);
                encode(&answer, out);
            }
            [comm::GET_VALUES_SELECTIVE, a, b, c, d] => {
                let mut answer: Answer = [comm::GET_VALUES_SELECTIVE, a, b, c, d].into_iter().collect();
                let mask = u32::from_be_bytes([a, b, c, d]);
                values(mask, state, scale, *pole_pairs, in_force.timed_out(now_ns), &mut answer);
                encode(&answer, out);
            }
            _ => {}
        });
        newest
    }

    fn voltage_v(&self, now_ns: u64) -> f64 {
        self.in_force.voltage_v(now_ns)
    }

    fn timed_out(&self, now_ns: u64) -> bool {
        self.in_force.timed_out(now_ns)
    }

    fn set_timeout(&mut self, timeout_ns: Option<u64>) {
        self.in_force.set_timeout(timeout_ns);
    }

    fn garbled(&self) -> Garbled {
        self.deframer.garbled()
    }
}

fn answer_version(out: &mut Outbox) {
    let mut answer = Answer::new();
    answer.push(comm::FW_VERSION);
    answer.extend(VERSION);
    answer.extend(HARDWARE.iter().copied());
    // Unique id of the processor.
    answer.extend([0; 12]);
    // Paired, test version, hardware type VESC, custom configurations, phase filters, QML of hardware and app, NRF flags.
    answer.extend([0; 8]);
    // No name of a custom firmware; CRC of the firmware.
    answer.extend([0; 1 + 4]);
    encode(&answer, out);
}

/// Appends the values of `mask` as `commands.c` does for `COMM_GET_VALUES`. What the emulated rig does not know is 0.
fn values(mask: u32, state: &DriveState, scale: &Scale, pole_pairs: f32, timed_out: bool, answer: &mut Answer) {
    let told = &state.telemetry;
    let (current_a, duty) = (scale.turned(told.motor_current_a), scale.turned(told.duty));
    let erpm = scale.turned(told.speed_rpm) * pole_pairs;
    let voltage_v = duty * told.supply_v;
    let code = told.fault.map_or(0, |fault| fault.code.min(255) as u8);
    // A conversion by `as` saturates, and NaN is 0.
    let two = |value: f32, scale: f32| Field::Two((value * scale).round() as i16);
    let four = |value: f32, scale: f32| Field::Four((value * scale).round() as i32);
    let fields = [
        two(told.temperature_c, 1e1),
        two(0.0, 1e1),
        four(current_a, 1e2),
        // Averaged over a PWM period, the input carries the motor's current for the share of the duty.
        four(current_a * duty, 1e2),
        four(0.0, 1e2),
        four(current_a, 1e2),
        two(duty, 1e3),
        four(erpm, 1.0),
        two(told.supply_v, 1e1),
        four(0.0, 1e4),
        four(0.0, 1e4),
        four(0.0, 1e4),
        four(0.0, 1e4),
        Field::Four(0),
        Field::Four(0),
        Field::One(code),
        four(0.0, 1e6),
        Field::One(CONTROLLER_ID),
        Field::Three([(told.temperature_c * 1e1).round() as i16; 3]),
        four(0.0, 1e3),
        four(voltage_v, 1e3),
        Field::One(timed_out.into()),
    ];
    for (bit, field) in fields.iter().enumerate() {
        if mask & (1 << bit) == 0 {
            continue;
        }
        match field {
            Field::One(value) => answer.push(*value),
            Field::Two(value) => answer.extend(value.to_be_bytes()),
            Field::Three(values) => answer.extend(values.iter().flat_map(|value| value.to_be_bytes())),
            Field::Four(value) => answer.extend(value.to_be_bytes()),
        }
    }
}

/// A value as it goes over the wire, high byte first.
enum Field {
    One(u8),
    Two(i16),
    /// Three of two bytes.
    Three([i16; 3]),
    Four(i32),
}
