//! VESC UART.

use super::{AmplifierError, AmplifierSettings, Drive, Protocol, ProtocolKind};

/// VESC UART.
pub const KIND: ProtocolKind = ProtocolKind { name: "vesc", title: "VESC UART", client, drive };

fn client(_settings: &AmplifierSettings) -> Result<Box<dyn Protocol>, AmplifierError> {
    unimplemented!("written next")
}

fn drive(_settings: &AmplifierSettings) -> Result<Box<dyn Drive>, AmplifierError> {
    unimplemented!("written next")
}
