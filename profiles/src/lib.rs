//! The script language of the bench, and the paper's experiments written in it.
//!
//! A script (TOML) says what is to be driven, for how long or until what, and what the operator does meanwhile. It is
//! read and checked by [`Script::parse`], bound to a rig and a seed by [`Script::compile`], and played tick by tick
//! by [`Playback`], which implements the loop's `Reference`. The built-in protocols are listed in [`builtin`].
//!
//! # The language
//!
//! ```toml
//! name = "example"               # [a-z0-9_]; names the run and its file
//! protocol = "square-wave"       # the campaign format's protocol
//! role = "identify"              # or "validate"
//! plane = "horizontal"           # or "vertical"
//! about = "free text"            # optional
//!
//! [start]                        # the rig before the first step; the voltage starts at 0
//! fixture = "free"
//! brake = "open"
//! bypass = "closed"
//! fill_bar = 2.8                 # optional: pressure of both chambers that the operator prepares
//!
//! [[step]]
//! for_s = 1.0                    # what a step does not say stays as it was
//!
//! [[step]]
//! for_each = { share = [0.6, 0.9], limit_deg = [25, 30] }   # lists of one length, walked together
//!   [[step.step]]
//!   voltage_u_max = "$share"     # any number may be a variable of an enclosing for_each
//!   until = [{ channel = "angle_deg", above = "$limit_deg" }]
//!   timeout_s = 6.0
//! ```
//!
//! A step is one of
//!
//! - a hold: any of `voltage_v` | `voltage_u_max` (fraction of the rig's largest voltage) | `flow_ml_s`; `brake`,
//!   `bypass` (`"open"`, `"closed"`); `fixture` with its own keys (below); and how long: `for_s`, or `until` (any of its
//!   conditions) with `timeout_s`. Each hold starts a new segment unless `new_segment = false`.
//! - `repeat = N` with inner `[[step.step]]`; `stop_when` (conditions as in `until`) is looked at before each pass.
//! - `for_each = { name = [..], .. }` with inner steps.
//! - `[step.random]`: voltages of random size, sign and length; see [`RandomSteps`].
//!
//! | fixture | keys | meaning |
//! |---|---|---|
//! | `free` | | the lever is free |
//! | `clamped` | `angle_deg` | held, torque read |
//! | `driven` | `angle_deg`, `rate_deg_s` | led there at this rate; the step ends on arrival (`until` may end it earlier; no `for_s`) |
//! | `filled` | `angle_deg`, `pressure1_bar`, `pressure2_bar` | held while the chambers are filled |
//! | `released` | `angle_deg`, `release_ml_s` | held while oil leaves chamber 1; a rate of 0 reads the cylinder |
//! | `pump-bench` | `pressure1_bar`, `pressure2_bar` | the pump alone between two reservoirs |
//!
//! A condition names a channel (`angle_deg`, `pressure1_bar`, `pressure2_bar`, `torque_nm`) and one of `above`,
//! `below`, or `rate_below` (absolute rate of the low-passed channel, per second) with `window_s`. A channel that is not
//! measured meets no condition. Times in s, angles in degrees, pressures in bar absolute, volumes in ml.
mod builtin;
mod compile;
mod condition;
mod controlled;
mod error;
mod expand;
mod playback;
mod raw;
mod script;
mod signal;
mod table;
mod target;
mod values;

pub use builtin::{BUILTIN, EXAMPLES, LoadError, builtin, load_folder};
pub use condition::Channel;
pub use error::ScriptError;
pub use playback::Playback;
pub use script::{ANGLE_LIMIT_DEG, Context, PRESSURE_LIMIT_BAR, Plane, Protocol, RandomSteps, Role, Script};
