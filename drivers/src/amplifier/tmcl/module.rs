//! Modules that take a voltage, and where in them the values are.

use super::instruction::{GAP, GIO};
use crate::amplifier::Fault;

/// Modules that the bench knows. A further one is a further row.
pub const MODULES: &[Module] = &[TMC6140_EVAL, TMC6300_EVAL];

/// Three-phase gate driver on a Landungsbrücke, block commutation by hall sensors or open loop: 5 to 30 V.
///
/// Source: github.com/analogdevicesinc/TMC-EvalSystem, `boards/TMC6140_eval.c` and `tmc/TMCL.c`; PyTrinamic's `TMC6140_eval.py`.
pub const TMC6140_EVAL: Module = Module {
    name: "TMC6140-EVAL",
    command_parameter: 3,
    full_scale_units: 32_767,
    readings: &[
        Reading { quantity: Quantity::Current, instruction: GAP, parameter: 6, unit: 1e-3 },
        Reading { quantity: Quantity::Speed, instruction: GAP, parameter: 16, unit: 1.0 },
        Reading { quantity: Quantity::Duty, instruction: GAP, parameter: 4, unit: 1.0 / 32_767.0 },
        Reading { quantity: Quantity::Faults, instruction: GAP, parameter: 9, unit: 1.0 },
        SUPPLY,
    ],
    faults: &[
        (0x001, "phase U short to ground"),
        (0x002, "phase V short to ground"),
        (0x004, "phase W short to ground"),
        (0x008, "phase U short to supply"),
        (0x010, "phase V short to supply"),
        (0x020, "phase W short to supply"),
        (0x040, "3.3 V regulator"),
        (0x080, "overtemperature"),
        (0x200, "undervoltage"),
    ],
};

/// Three half bridges on a Landungsbrücke: up to 11 V. It measures no speed and tells no faults.
///
/// Source: github.com/analogdevicesinc/TMC-EvalSystem, `boards/TMC6300_eval.c`; PyTrinamic's `TMC6300_eval.py`.
pub const TMC6300_EVAL: Module = Module {
    name: "TMC6300-EVAL",
    command_parameter: 4,
    full_scale_units: 32_767,
    readings: &[
        Reading { quantity: Quantity::Current, instruction: GAP, parameter: 7, unit: 1e-3 },
        Reading { quantity: Quantity::Duty, instruction: GAP, parameter: 3, unit: 1.0 / 32_767.0 },
        SUPPLY,
    ],
    faults: &[],
};

/// Supply that the Landungsbrücke measures (`VM`), steps of 0.1 V.
const SUPPLY: Reading = Reading { quantity: Quantity::Supply, instruction: GIO, parameter: 5, unit: 0.1 };

/// A module.
#[derive(Debug, PartialEq)]
pub struct Module {
    /// As the rig file has it.
    pub name: &'static str,
    /// Axis parameter that takes the command, both signs.
    pub command_parameter: u8,
    /// Its value at full scale, that is, at the supply's voltage.
    pub full_scale_units: i32,
    /// What it measures; asked for in turn.
    pub readings: &'static [Reading],
    /// Flags of [`Quantity::Faults`] that mean a fault, the most telling first.
    pub faults: &'static [(u32, &'static str)],
}

/// Where a quantity is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// What it is.
    pub quantity: Quantity,
    /// GAP (6) or GIO (15).
    pub instruction: u8,
    /// Axis parameter or port.
    pub parameter: u8,
    /// Quantity for one unit of the value: V, A, 1/min, °C or 1.
    pub unit: f32,
}

/// A quantity of the telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Supply, V.
    Supply,
    /// Motor current, A.
    Current,
    /// Shaft, 1/min.
    Speed,
    /// Share of the supply at the motor.
    Duty,
    /// Output stage, °C.
    Temperature,
    /// Flags.
    Faults,
}

impl Module {
    /// Flags as a fault: all that are set, with the name of the first.
    pub fn fault(&self, flags: u32) -> Option<Fault> {
        let code = flags & self.faults.iter().fold(0, |mask, (flag, _)| mask | flag);
        let (_, name) = self.faults.iter().find(|(flag, _)| code & flag != 0)?;
        Some(Fault { code, name })
    }
}
