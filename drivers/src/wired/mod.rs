//! Pump amplifier on a serial port, valves and sensors on CAN, as one device of the loop.

mod preparation;
pub mod settings;

pub use preparation::Preparation;
pub use settings::{
    AmplifierSettings, CanSettings, CommandSignals, FixtureSignals, Heartbeat, Sensor, Sensors, Settings, TmclSettings,
};
