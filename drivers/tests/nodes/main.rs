//! The emulated rig on the wires: its plant in virtual time, and the whole over a pty and a bus.
#![allow(clippy::unwrap_used, reason = "a test")]

mod bench;
mod plant;
mod rig;
mod time_outs;
#[path = "../vcan/mod.rs"]
mod vcan;
mod wires;
