//! What an MCAP recording holds besides the samples: what the run is, and what happened in it.

use std::collections::BTreeMap;

use crate::{Plane, Protocol, Role};

/// What a run is, written before its first sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunMetadata {
    /// Name of the run, for people.
    pub name: String,
    /// Which experiment it is.
    pub protocol: Protocol,
    /// What it was recorded for. In a campaign folder `campaign.toml` decides.
    pub role: Role,
    /// The plane in which the lever moves.
    pub plane: Plane,
    /// Text of the profile that was run, as it was run.
    pub profile: String,
    /// Anything else worth keeping, by name.
    pub notes: BTreeMap<String, String>,
}

/// How bad an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Part of a normal run.
    Info,
    /// The run goes on, but a person should know.
    Warning,
    /// The run is not what it was meant to be.
    Error,
}

/// Something that happened besides the samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    /// Tick at which it happened.
    pub tick: u64,
    /// Scheduled time of that tick since the run's start, ns.
    pub scheduled_ns: u64,
    /// How bad it is.
    pub severity: Severity,
    /// Who says it.
    pub source: String,
    /// What happened.
    pub text: String,
}
