//! Trinamic TMCL.

use super::{AmplifierError, AmplifierSettings, Drive, Protocol, ProtocolKind};

/// Trinamic TMCL.
pub const KIND: ProtocolKind = ProtocolKind { name: "tmcl", title: "Trinamic TMCL", client, drive };

fn client(_settings: &AmplifierSettings) -> Result<Box<dyn Protocol>, AmplifierError> {
    unimplemented!("written next")
}

fn drive(_settings: &AmplifierSettings) -> Result<Box<dyn Drive>, AmplifierError> {
    unimplemented!("written next")
}
