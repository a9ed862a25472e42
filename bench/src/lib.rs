//! The test bench: the only place where the loop, the devices, the recordings and the identification meet.

pub mod report;
