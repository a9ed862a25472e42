//! Trinamic TMCL, binary, on a serial port: datagrams of nine bytes there and nine back, answered in the order in which they came.
//! Sources: the TMCL firmware manuals, chapter "Binary Command Format"; PyTrinamic's `tmcl.py`.
//!
//! The bench commands a voltage, so it needs a module that takes one: [`MODULES`]. Those of the TMCM-16xx series take a torque, a
//! velocity or a position (their axis parameter 31 is "Actual Torque" or "Reinit BLDC Regulation") and do not do.

mod client;
mod datagram;
mod drive;
mod module;

pub use client::Client;
pub use datagram::{Reframer, Reply, Request, checksum};
pub use drive::Emulated;
pub use module::{MODULES, Module, Quantity, Reading};

use super::{Fault, ProtocolKind};

/// Trinamic TMCL.
pub const KIND: ProtocolKind = ProtocolKind {
    name: "tmcl",
    title: "Trinamic TMCL",
    example_fault: Fault { code: 0x200, name: "undervoltage" },
    delivered_share: 1.0,
    client: |settings| Ok(Box::new(Client::new(settings)?)),
    drive: |settings| Ok(Box::new(Emulated::new(settings)?)),
};

/// Instruction numbers.
mod instruction {
    /// Motor stop.
    pub const MST: u8 = 3;
    /// Set axis parameter.
    pub const SAP: u8 = 5;
    /// Get axis parameter.
    pub const GAP: u8 = 6;
    /// Get input.
    pub const GIO: u8 = 15;
    /// Get firmware version.
    pub const VERSION: u8 = 136;
}

/// Status bytes of replies: the manuals' list, and the two of the evaluation system (`TMCL.h`) that are no errors either.
mod status {
    pub const WRONG_CHECKSUM: u8 = 1;
    pub const INVALID_COMMAND: u8 = 2;
    pub const WRONG_TYPE: u8 = 3;
    pub const INVALID_VALUE: u8 = 4;
    pub const OK: u8 = 100;
    /// There is no value now.
    pub const NOT_DONE: u8 = 128;

    /// What a status means; `None` for a byte that is none.
    pub fn meaning(status: u8) -> Option<&'static str> {
        Some(match status {
            WRONG_CHECKSUM => "wrong checksum",
            INVALID_COMMAND => "invalid command",
            WRONG_TYPE => "wrong type: no such parameter or axis, or it can't be written",
            INVALID_VALUE => "invalid value",
            5 => "configuration EEPROM locked",
            6 => "command not available",
            7 => "command could not be loaded",
            8 => "write protected",
            9 => "maximum exceeded",
            10 => "download not possible",
            11 => "the chip could not be read",
            OK => "successfully executed",
            101 => "command loaded into EEPROM",
            NOT_DONE => "not done yet",
            129 => "communication active",
            _ => return None,
        })
    }
}
