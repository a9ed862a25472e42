//! VESC UART: what motor controllers with the VESC firmware speak on their UARTs and on USB. Source: github.com/vedderb/bldc,
//! `comm/packet.c`, `comm/commands.c` and `datatypes.h`.
//!
//! A voltage is sent as a duty cycle, `COMM_SET_DUTY`, which the firmware does not acknowledge; telemetry is asked for by
//! `COMM_GET_VALUES_SELECTIVE`, six values at a time. With a brushed motor (motor type "DC") the motor's voltage is the duty times
//! the supply.

mod client;
mod drive;
mod fault;
mod frame;

pub use client::Client;
pub use drive::Emulated;
pub use fault::{FAULTS, fault};
pub use frame::{Deframer, LONGEST_PAYLOAD, encode};

use super::{Fault, ProtocolKind};

/// VESC UART.
pub const KIND: ProtocolKind = ProtocolKind {
    name: "vesc",
    title: "VESC UART",
    example_fault: Fault { code: 4, name: FAULTS[4] },
    // "Maximum Duty Cycle" of VESC Tool.
    delivered_share: 0.95,
    client: |settings| Ok(Box::new(Client::new(settings)?)),
    drive: |settings| Ok(Box::new(Emulated::new(settings)?)),
};

/// Numbers of the commands in `COMM_PACKET_ID`.
mod comm {
    pub const FW_VERSION: u8 = 0;
    pub const GET_VALUES: u8 = 4;
    pub const SET_DUTY: u8 = 5;
    pub const SET_CURRENT: u8 = 6;
    pub const SET_HANDBRAKE: u8 = 10;
    pub const ALIVE: u8 = 30;
    pub const GET_VALUES_SELECTIVE: u8 = 50;
}

/// Duty 1 on the wire of `COMM_SET_DUTY`.
const FULL_DUTY: f64 = 1e5;
