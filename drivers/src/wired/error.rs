//! Why a wired rig could not be opened or prepared.

use super::signals::MappingError;
use crate::amplifier::AmplifierError;
use crate::can::CanError;
use crate::serial::LinkError;

/// Expected, got, remedy; in the words of the part that refused.
#[derive(Debug, thiserror::Error)]
pub enum WiredError {
    /// What the settings say of the bus.
    #[error(transparent)]
    Mapping(#[from] MappingError),
    /// The amplifier's settings.
    #[error(transparent)]
    Amplifier(#[from] AmplifierError),
    /// The serial port.
    #[error(transparent)]
    Serial(#[from] LinkError),
    /// The bus.
    #[error(transparent)]
    Can(#[from] CanError),
    /// The rig does not answer as it must before a run may begin.
    #[error("the rig is not ready: {0}")]
    NotReady(String),
    /// Somebody asked for a stop or an emergency stop while the rig was prepared.
    #[error("a stop was asked for before the rig was prepared: it is not armed, and its safe state is commanded")]
    Stopped,
}

impl WiredError {
    /// Whether the configuration is to be corrected, and not the rig.
    pub fn is_configuration(&self) -> bool {
        match self {
            WiredError::Mapping(_) | WiredError::Amplifier(_) => true,
            WiredError::Serial(error) => error.is_configuration(),
            WiredError::Can(_) | WiredError::NotReady(_) | WiredError::Stopped => false,
        }
    }
}
