//! The run that would settle what a diagnosis leaves open: a script out of many, played on each rival before anything moves.
//!
//! | module | what |
//! |---|---|
//! | [`candidates`] | the scripts on offer: the paper's experiments with other amplitudes, planes, fillings, rests and valves |
//! | [`play`] | what such a run would record, if a rival were the rig |
//! | [`mod@design`] | the choice, by `identify::design` |
//! | [`auto`] | recording it on an emulated rig and diagnosing again |

pub mod auto;
pub mod candidates;
pub mod design;
pub mod play;

pub use design::{Designed, design, design_for};

/// Name of the script in the folder of the results.
pub const NEXT_FILE: &str = "next.toml";
