//! Why a wired rig could not be opened or prepared.

use crate::amplifier::AmplifierError;
use crate::can::CanError;
use crate::dbc::DbcError;
use crate::serial::LinkError;

/// Expected, got, remedy; in the words of the part that refused.
#[derive(Debug, thiserror::Error)]
pub enum WiredError {
    /// The settings name a signal that can't be used.
    #[error("{key}: {source}")]
    Signal {
        /// Key of the rig file.
        key: String,
        /// Why not.
        #[source]
        source: Box<DbcError>,
    },
    /// The settings contradict each other.
    #[error("{key}: expected {expected}, got {got}")]
    Mapping {
        /// Key of the rig file.
        key: String,
        /// What can be used.
        expected: String,
        /// What is there.
        got: String,
    },
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
}

impl WiredError {
    /// Whether the configuration is to be corrected, and not the rig.
    pub fn is_configuration(&self) -> bool {
        match self {
            WiredError::Signal { .. } | WiredError::Mapping { .. } | WiredError::Amplifier(_) => true,
            WiredError::Serial(error) => error.is_configuration(),
            WiredError::Can(_) | WiredError::NotReady(_) => false,
        }
    }
}
