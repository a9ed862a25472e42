//! The script language of the bench, and the paper's experiments written in it.
//!
//! A script (TOML) says what is to be driven, for how long or until what, and what the operator does meanwhile. It is
//! read and checked by [`Script::read`] or [`Script::parse`], bound to a rig and a seed by [`Script::compile`], and played tick
//! by tick by [`Playback`], which implements the loop's `Reference`. The campaign's protocols are listed in [`BUILTIN`],
//! more scripts to start from in [`EXAMPLES`]. The language is described in `docs/PROFILES.md`.

mod ask;
mod builtin;
mod compile;
mod condition;
mod controlled;
#[cfg(test)]
mod described;
#[cfg(test)]
mod documented;
mod envelope;
mod error;
mod expand;
mod fault;
mod instruction;
mod needs;
mod outline;
mod playback;
mod ramp;
mod range;
mod raw;
mod script;
mod signal;
mod spread;
mod table;
mod target;
mod timeout;
mod values;

pub use ask::{Hands, Request};
pub use builtin::{BUILTIN, EXAMPLES, LoadError, SCHEMA, builtin, load_folder};
pub use condition::Channel;
pub use envelope::{Envelope, EnvelopeError};
pub use error::ScriptError;
pub use needs::Need;
pub use outline::OutlineRow;
pub use playback::Playback;
pub use script::{
    ANGLE_LIMIT_DEG, Context, FORESEEN_S, PRESSURE_LIMIT_BAR, Plane, Protocol, RandomSteps, Role, Script,
};
pub use timeout::{Place, Timeout, Waited};
