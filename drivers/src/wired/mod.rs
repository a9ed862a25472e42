//! Pump amplifier on a serial port, valves and sensors on CAN, as one device of the loop.

pub mod settings;

pub use settings::{
    AmplifierSettings, CanSettings, CommandSignals, FixtureSignals, Heartbeat, Sensor, Sensors, TmclSettings,
};
