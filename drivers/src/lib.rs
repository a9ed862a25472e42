//! Devices behind the loop's `Device` trait: the emulated rig, a rig on real wires, and faults around either.
//!
//! | module | what |
//! |---|---|
//! | [`emulated`] | the model's plant with an operator and sensors, in virtual time |
//! | [`wired`] | pump amplifier on a serial port, valves and sensors on CAN, as one device |
//! | [`amplifier`] | what pump amplifiers speak: one protocol a file, no I/O |
//! | [`serial`] | the thread that owns the amplifier's port |
//! | [`dbc`] | CAN databases compiled to shifts and masks, no I/O |
//! | [`can`] | frames, and the thread that owns the bus |
//! | [`budget`] | what a configuration asks of its wires |
//! | [`nodes`] | the emulated rig at the other end of both wires |
//! | [`contract`] | what every device owes the loop, as tests for any device |
//! | [`faults`] | seeded fault injection around any device |
//! | [`exchange`] | hand-over between the loop and the I/O threads: the newest value wins |
//! | [`journal`] | what happened in a driver, for the recording |
//! | [`telemetry`] | every report of the amplifier, for the recording |
pub mod amplifier;
pub mod budget;
pub mod can;
pub mod contract;
pub mod dbc;
pub mod emulated;
pub mod exchange;
pub mod faults;
pub mod journal;
pub mod nodes;
pub mod serial;
pub mod telemetry;
pub mod wired;

pub use emulated::{EmulatedError, EmulatedRig};
