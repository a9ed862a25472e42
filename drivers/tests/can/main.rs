//! A bus over its thread: each test over a Unix socket, and over `vcan0` where there is one (`drivers/tests/can-tests`).
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../counting/mod.rs"]
mod counting;
#[path = "../vcan/mod.rs"]
mod vcan;

mod bus;
mod condition;
mod crowded;
mod frames;
mod opening;
mod system;
