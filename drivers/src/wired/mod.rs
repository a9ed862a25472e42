//! Pump amplifier on a serial port, valves and sensors on CAN, as one device of the loop.
//!
//! Every tick the driver sends the command of the amplifier, and command frames on CAN of which the last, the one with the counter, is
//! what CANopen calls SYNC: nodes act and measure on it, and echo its counter. A value that is read at tick k + 1 then belongs to tick k,
//! and its age says so.

mod error;
mod fixture;
mod input_map;
mod output_map;
mod preparation;
mod rig;
pub mod settings;
pub(crate) mod signals;
mod twins;

pub use error::WiredError;
pub use fixture::FixtureKind;
pub(crate) use fixture::FixtureNumbers;
pub use input_map::InputMap;
pub use output_map::{Around, MOST_FRAMES, OutputMap};
pub use preparation::Preparation;
pub use rig::WiredRig;
pub use settings::{
    AmplifierSettings, CanSettings, CommandSignals, FixtureSignals, Heartbeat, Sensor, Sensors, Settings, TmclSettings,
};
pub use signals::MappingError;
