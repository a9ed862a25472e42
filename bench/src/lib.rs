//! The test bench: the only place where the loop, the devices, the recordings and the identification meet.

pub mod campaign;
pub mod commands;
pub mod controller;
pub mod emulation;
pub mod failure;
pub mod interrupt;
pub mod logger;
pub mod progress;
pub mod report;
pub mod simulation;
pub mod strength;
