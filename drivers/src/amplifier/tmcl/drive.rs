//! An emulated module.

use super::client::Wire;
use super::datagram::{Reframer, Reply, Request};
use super::module::Quantity;
use super::{KIND, instruction, status};
use crate::amplifier::{AmplifierError, AmplifierSettings, Drive, DriveState, Garbled, InForce, Outbox, Scale};

/// Module number and version that it says.
const VERSION: i32 = i32::from_be_bytes([0, 12, 3, 9]);
/// The same as text.
const VERSION_TEXT: &[u8; 8] = b"0012V309";
/// Type of a version as text; it is answered without status and checksum.
const TEXT: u8 = 0;

/// Answers as the evaluation system's firmware does: the axis parameter of the command (SAP, GAP), the module's readings (GAP, GIO),
/// motor stop, version as numbers and as text. Every other instruction is "invalid command", every other parameter "wrong type".
/// A quantity that is not known (NaN) is "not done yet".
///
/// The real firmware has no timeout: it holds the last command for ever. So has this one unless one is set.
pub struct Emulated {
    scale: Scale,
    wire: Wire,
    reframer: Reframer,
    in_force: InForce,
    units: i32,
}

impl Emulated {
    /// For these settings.
    ///
    /// # Errors
    /// An unknown module, `full_scale_v` or `tmcl.full_scale_units` out of range.
    pub fn new(settings: &AmplifierSettings) -> Result<Emulated, AmplifierError> {
        let (scale, wire) = (Scale::of(settings)?, Wire::of(settings)?);
        Ok(Emulated { scale, wire, reframer: Reframer::default(), in_force: InForce::new(None), units: 0 })
    }

    /// Status and value of the answer.
    fn answer(&mut self, request: &Request, now_ns: u64, state: &DriveState, newest: &mut Option<f64>) -> (u8, i32) {
        let on_axis = matches!(request.instruction, instruction::SAP | instruction::GAP | instruction::MST);
        if on_axis && request.motor != self.wire.axis {
            return (status::WRONG_TYPE, request.value);
        }
        match request.instruction {
            instruction::SAP if request.kind != self.wire.command_parameter => (status::WRONG_TYPE, request.value),
            instruction::SAP if request.value.unsigned_abs() > self.wire.full_scale_units.unsigned_abs() => {
                (status::INVALID_VALUE, request.value)
            }
            instruction::SAP => {
                self.obey(request.value, now_ns, newest);
                (status::OK, request.value)
            }
            instruction::MST => {
                self.obey(0, now_ns, newest);
                (status::OK, request.value)
            }
            instruction::GAP if request.kind == self.wire.command_parameter => (status::OK, self.units),
            instruction::GAP | instruction::GIO => self.read(request, state),
            instruction::VERSION => (status::OK, VERSION),
            _ => (status::INVALID_COMMAND, request.value),
        }
    }

    fn obey(&mut self, units: i32, now_ns: u64, newest: &mut Option<f64>) {
        let voltage_v = self.scale.voltage_v(f64::from(units) / f64::from(self.wire.full_scale_units));
        self.units = units;
        self.in_force.command(voltage_v, now_ns);
        *newest = Some(voltage_v);
    }

    fn read(&self, request: &Request, state: &DriveState) -> (u8, i32) {
        let module = self.wire.module;
        let asked = (request.instruction, request.kind);
        let Some(reading) = module.readings.iter().find(|reading| (reading.instruction, reading.parameter) == asked)
        else {
            return (status::WRONG_TYPE, request.value);
        };
        let told = &state.telemetry;
        let quantity = match reading.quantity {
            Quantity::Supply => told.supply_v,
            Quantity::Current => self.scale.turned(told.motor_current_a),
            Quantity::Speed => self.scale.turned(told.speed_rpm),
            Quantity::Duty => self.scale.turned(told.duty),
            Quantity::Temperature => told.temperature_c,
            Quantity::Faults => {
                let flags = told.fault.map_or(0, |fault| module.fault(fault.code).unwrap_or(KIND.example_fault).code);
                return (status::OK, flags as i32);
            }
        };
        if quantity.is_nan() {
            return (status::NOT_DONE, 0);
        }
        (status::OK, (quantity / reading.unit).round() as i32)
    }
}

impl Drive for Emulated {
    fn hear(&mut self, bytes: &[u8], now_ns: u64, state: &DriveState, out: &mut Outbox) -> Option<f64> {
        let mut reframer = std::mem::take(&mut self.reframer);
        let (address, reply_address) = (self.wire.module_address, self.wire.reply_address);
        let mut newest = None;
        // A number that is no instruction is no instruction for this module, but garbage.
        reframer.hear(
            bytes,
            |head| head[0] == address && is_instruction(head[1]),
            |datagram| {
                let request = Request::decode(datagram);
                if (request.instruction, request.kind) == (instruction::VERSION, TEXT) {
                    let [a, b, c, d, e, f, g, h] = *VERSION_TEXT;
                    out.push(&[reply_address, a, b, c, d, e, f, g, h]);
                    return;
                }
                // A datagram is a sign of life, too, where a timeout is set.
                self.in_force.alive(now_ns);
                let (status, value) = self.answer(&request, now_ns, state, &mut newest);
                let instruction = request.instruction;
                out.push(&Reply { reply_address, module_address: address, status, instruction, value }.encode());
            },
        );
        self.reframer = reframer;
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
        self.reframer.garbled()
    }
}

/// Whether TMCL has an instruction with this number: motion and parameters, calculations and events, user functions, control.
fn is_instruction(number: u8) -> bool {
    matches!(number, 1..=15 | 19..=39 | 64..=71 | 128..=138 | 157)
}
