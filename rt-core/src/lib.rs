//! The 1 kHz loop of the bench: it knows no plant, no protocol and no file, only the traits in [`traits`].
pub mod traits;
pub mod types;

pub use traits::{Controller, Device, DeviceError, Reference, Step, Target};
pub use types::{Command, Fixture, Measurement, Sample, Tick, PERIOD_NS, SAMPLE_VERSION, flags};
