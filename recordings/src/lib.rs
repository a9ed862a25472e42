//! Recordings: bytes to samples and back. Campaign folders, CSV and MCAP (see `FORMAT.md`).

mod campaign;
mod error;
mod recording;
mod vocabulary;

pub use campaign::{Campaign, RigFacts, RunEntry};
pub use error::{CampaignError, Place};
pub use recording::Recording;
pub use vocabulary::{Plane, Protocol, Role, UnknownWord};
