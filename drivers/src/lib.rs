//! Devices behind the loop's `Device` trait. So far: the emulated rig.
pub mod emulated;

pub use emulated::{EmulatedError, EmulatedRig};
