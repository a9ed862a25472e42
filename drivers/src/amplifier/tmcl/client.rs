//! The bench's side.

use super::datagram::{LENGTH, Reframer, Reply, Request};
use super::module::{MODULES, Module, Quantity, Reading};
use super::{instruction, status};
use crate::amplifier::{
    AmplifierError, AmplifierSettings, Bytes, Firmware, Garbled, LONGEST_NAME, Outbox, Protocol, Refusal, Scale,
    Telemetry, Told, Traffic,
};
use arrayvec::{ArrayString, ArrayVec};
use std::fmt::Write;

/// Requests that may be unanswered before the client says that it has lost track.
const AHEAD: usize = 64;
/// Type of [`instruction::VERSION`] that asks for numbers, not text.
const BINARY: u8 = 1;

/// Speaks to a Trinamic module.
///
/// A reply names the instruction that it answers, but not the parameter. So no value is asked for while another one may still come:
/// replies come in the order of the requests, and an answer to a later request says that an earlier one was lost. Where nothing came
/// in between, the version is asked for instead, whose answer is told apart from all others.
pub struct Client {
    scale: Scale,
    wire: Wire,
    reframer: Reframer,
    unanswered: ArrayVec<Sent, AHEAD>,
    /// Too much was unanswered: what comes before the next version may belong to anything.
    lost_track: bool,
    hello_awaited: bool,
    /// Reading that is asked for next.
    next: usize,
    telemetry: Telemetry,
}

/// A request that was sent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sent {
    Command,
    /// The module's reading with this index.
    Reading(usize),
    Version,
}

/// Addresses and parameters.
#[derive(Clone, Copy)]
pub(super) struct Wire {
    pub module: &'static Module,
    pub module_address: u8,
    pub reply_address: u8,
    pub axis: u8,
    pub command_parameter: u8,
    pub full_scale_units: i32,
}

impl Wire {
    pub fn of(settings: &AmplifierSettings) -> Result<Wire, AmplifierError> {
        let tmcl = &settings.tmcl;
        let module =
            MODULES.iter().find(|module| module.name == tmcl.module).ok_or_else(|| AmplifierError::UnknownModule {
                name: tmcl.module.clone(),
                known: MODULES.iter().map(|module| module.name).collect::<Vec<_>>().join(", "),
            })?;
        let full_scale_units = tmcl.full_scale_units.unwrap_or(module.full_scale_units);
        if full_scale_units <= 0 {
            let (key, value) = ("tmcl.full_scale_units", full_scale_units.into());
            return Err(AmplifierError::OutOfRange { key, value, expected: "> 0" });
        }
        Ok(Wire {
            module,
            module_address: tmcl.module_address,
            reply_address: tmcl.reply_address,
            axis: tmcl.axis,
            command_parameter: tmcl.command_parameter.unwrap_or(module.command_parameter),
            full_scale_units,
        })
    }

    /// Motor that a reading is asked of: ports belong to no axis.
    pub fn motor(&self, reading: &Reading) -> u8 {
        if reading.instruction == instruction::GIO { 0 } else { self.axis }
    }
}

impl Client {
    /// For these settings.
    ///
    /// # Errors
    /// An unknown module, `full_scale_v` or `tmcl.full_scale_units` out of range.
    pub fn new(settings: &AmplifierSettings) -> Result<Client, AmplifierError> {
        Ok(Client {
            scale: Scale::of(settings)?,
            wire: Wire::of(settings)?,
            reframer: Reframer::default(),
            unanswered: ArrayVec::new(),
            lost_track: false,
            hello_awaited: false,
            next: 0,
            telemetry: Telemetry::UNTOLD,
        })
    }

    fn send(&mut self, sent: Sent, instruction: u8, kind: u8, motor: u8, value: i32, out: &mut Outbox) {
        let request = Request { address: self.wire.module_address, instruction, kind, motor, value };
        if !out.push(&request.encode()) {
            return;
        }
        if self.unanswered.try_push(sent).is_err() {
            self.unanswered.clear();
            self.lost_track = true;
            self.unanswered.push(sent);
        }
    }

    /// Asks for the version; its answer says that whatever was asked before is answered or lost.
    fn ask_version(&mut self, out: &mut Outbox) {
        self.send(Sent::Version, instruction::VERSION, BINARY, 0, 0, out);
    }

    fn take(&mut self, reply: Reply, told: &mut dyn FnMut(Told)) {
        let readings = self.wire.module.readings;
        let answers = |sent: &Sent| match *sent {
            Sent::Command => reply.instruction == instruction::SAP,
            Sent::Reading(index) => reply.instruction == readings[index].instruction,
            Sent::Version => reply.instruction == instruction::VERSION,
        };
        let answered = self.unanswered.iter().position(answers).map(|at| {
            let sent = self.unanswered[at];
            self.unanswered.drain(..=at);
            sent
        });
        match answered {
            Some(Sent::Version) => {
                self.lost_track = false;
                if std::mem::take(&mut self.hello_awaited) && reply.status == status::OK {
                    told(Told::Hello(firmware(reply.value)));
                }
            }
            // A command is a command, whichever it answers.
            _ if reply.instruction == instruction::SAP => {
                told(if reply.status == status::OK { Told::Acknowledged } else { refused(&reply) });
            }
            Some(Sent::Reading(index)) if !self.lost_track => {
                let reading = &readings[index];
                let value = (reply.status == status::OK).then_some(reply.value);
                self.telemetry.set(reading, value, &self.scale, self.wire.module);
                // A value that there is not now is no refusal.
                let known = matches!(reply.status, status::OK | status::NOT_DONE);
                told(if known { Told::Telemetry(self.telemetry) } else { refused(&reply) });
            }
            _ => {}
        }
    }
}

impl Protocol for Client {
    fn hello(&mut self, out: &mut Outbox) {
        self.hello_awaited = true;
        self.ask_version(out);
    }

    fn command(&mut self, voltage_v: f64, out: &mut Outbox) {
        // In range: the share is in [-1, 1].
        let units = (self.scale.share(voltage_v) * f64::from(self.wire.full_scale_units)).round() as i32;
        let Wire { command_parameter, axis, .. } = self.wire;
        self.send(Sent::Command, instruction::SAP, command_parameter, axis, units, out);
    }

    fn request(&mut self, out: &mut Outbox) {
        if self.lost_track || self.unanswered.iter().any(|sent| matches!(sent, Sent::Reading(_))) {
            return self.ask_version(out);
        }
        let index = self.next % self.wire.module.readings.len();
        self.next = index + 1;
        let reading = self.wire.module.readings[index];
        let motor = self.wire.motor(&reading);
        self.send(Sent::Reading(index), reading.instruction, reading.parameter, motor, 0, out);
    }

    /// The firmware has no watchdog that waits for a sign of life: this only asks for an answer.
    fn keep_alive(&mut self, out: &mut Outbox) {
        self.ask_version(out);
    }

    fn hear(&mut self, bytes: &[u8], told: &mut dyn FnMut(Told)) {
        let mut reframer = std::mem::take(&mut self.reframer);
        let Wire { reply_address, module_address, .. } = self.wire;
        let may_come = |head: &[u8; 4]| {
            let [to, from, status, instruction] = *head;
            (to, from) == (reply_address, module_address)
                && status::meaning(status).is_some()
                && matches!(instruction, instruction::SAP | instruction::GAP | instruction::GIO | instruction::VERSION)
        };
        reframer.hear(bytes, may_come, |datagram| self.take(Reply::decode(datagram), told));
        self.reframer = reframer;
    }

    fn garbled(&self) -> Garbled {
        self.reframer.garbled()
    }

    fn reset(&mut self) {
        self.reframer = Reframer::default();
        self.unanswered.clear();
        // Answers to what was asked before may still come.
        self.lost_track = true;
        self.hello_awaited = false;
        self.next = 0;
        self.telemetry = Telemetry::UNTOLD;
    }

    fn traffic(&self) -> Traffic {
        let datagram = Bytes { out: LENGTH, back: LENGTH };
        Traffic { command: datagram, request: datagram, keep_alive: datagram }
    }

    fn resolution_v(&self) -> f64 {
        self.scale.full_scale_v / f64::from(self.wire.full_scale_units)
    }
}

impl Telemetry {
    /// Sets what a reading says; no value is "not told".
    fn set(&mut self, reading: &Reading, value: Option<i32>, scale: &Scale, module: &Module) {
        let quantity = value.map_or(f32::NAN, |value| value as f32 * reading.unit);
        match reading.quantity {
            Quantity::Supply => self.supply_v = quantity,
            Quantity::Current => self.motor_current_a = scale.turned(quantity),
            Quantity::Speed => self.speed_rpm = scale.turned(quantity),
            Quantity::Duty => self.duty = scale.turned(quantity),
            Quantity::Temperature => self.temperature_c = quantity,
            // A fault stays until it is known to be gone.
            Quantity::Faults => {
                if let Some(flags) = value {
                    self.fault = module.fault(flags as u32);
                }
            }
        }
    }
}

/// Module number (two bytes), version before and after the point (one byte each).
fn firmware(value: i32) -> Firmware {
    let [high, low, major, minor] = value.to_be_bytes();
    let mut hardware = ArrayString::<LONGEST_NAME>::new();
    // 17 characters at most.
    let _ = write!(hardware, "TMCL module {}", u16::from_be_bytes([high, low]));
    Firmware { hardware, major: major.into(), minor: minor.into() }
}

fn refused(reply: &Reply) -> Told {
    let meaning = status::meaning(reply.status).unwrap_or("a status unknown to this program");
    let of_voltage = reply.instruction == instruction::SAP;
    Told::Refused(Refusal { status: reply.status, meaning, command: reply.instruction, of_voltage })
}
