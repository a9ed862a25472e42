//! The test bench: the only place where the loop, the devices, the recordings and the identification meet.

mod amplifier_log;
pub mod blind;
pub mod campaign;
pub mod commands;
pub mod controller;
pub mod devices;
pub mod doctor;
pub mod dry_run;
pub mod emulation;
pub mod events;
pub mod exchange;
pub mod failure;
pub mod foxglove_bridge;
pub mod incident;
pub mod interrupt;
pub mod keyboard;
pub mod latency;
pub mod link;
pub mod logger;
pub mod look;
pub mod machine;
pub mod monitor;
pub mod next;
pub mod operator;
mod over;
pub mod progress;
pub mod recorder;
#[cfg(test)]
mod refusing;
pub mod report;
pub mod rig_file;
pub mod runner;
pub mod serve;
pub mod setup;
pub mod simulation;
pub mod strength;
pub mod timing;
