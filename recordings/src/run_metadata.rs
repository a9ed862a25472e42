//! What an MCAP recording says about its run besides samples and events: the metadata records.

use std::collections::BTreeMap;
use std::fmt;

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

/// Ticks that were published and did not arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The first tick that is missing.
    pub first_tick: u64,
    /// How many ticks are missing from there on.
    pub ticks: u64,
}

/// How many of the published samples the recording holds, written when it is closed: N of N, or the gaps.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LossCertificate {
    /// Samples that the loop published in this run.
    pub published: u64,
    /// Samples that the recording holds.
    pub recorded: u64,
    /// What is missing, in order of time; empty where nothing is.
    pub gaps: Vec<Gap>,
}

impl LossCertificate {
    /// Nothing was lost.
    pub fn is_complete(&self) -> bool {
        self.recorded == self.published && self.gaps.is_empty()
    }

    /// Samples that are missing.
    pub fn lost(&self) -> u64 {
        self.gaps.iter().fold(0, |sum, gap| sum.saturating_add(gap.ticks))
    }

    /// The counts and the gaps agree with each other.
    pub(crate) fn is_consistent(&self) -> bool {
        self.recorded.checked_add(self.lost()) == Some(self.published)
    }
}

impl fmt::Display for LossCertificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// More gaps than this are only counted.
        const SHOWN: usize = 8;
        write!(f, "{} of {} samples", self.recorded, self.published)?;
        for (index, gap) in self.gaps.iter().take(SHOWN).enumerate() {
            write!(f, "{}{} from tick {}", if index == 0 { "; lost " } else { ", " }, gap.ticks, gap.first_tick)?;
        }
        if self.gaps.len() > SHOWN {
            write!(f, " and in {} more gaps", self.gaps.len() - SHOWN)?;
        }
        Ok(())
    }
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
