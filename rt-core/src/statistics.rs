//! What a run leaves behind in numbers: ticks, hand-overs, how it ended.

use std::fmt;

use crate::clock::Wake;
use crate::publish::Handover;
use crate::supervisor::Trip;

/// Counts of one run; constant in size however long the run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Ticks that were completed.
    pub ticks: u64,
    /// Samples that the publication did not take (its queue was full, or it has ended).
    pub not_taken: u64,
    /// Largest lateness of a wake-up, ns; 0 in virtual time.
    pub lateness_max_ns: u64,
}

impl Statistics {
    /// One tick is over.
    pub fn account(&mut self, wake: &Wake, handover: Handover) {
        self.ticks += 1;
        self.not_taken += u64::from(handover == Handover::Lost);
        self.lateness_max_ns = self.lateness_max_ns.max(wake.lateness_ns);
    }
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The reference said that this was the last tick.
    Completed,
    /// The supervisor tripped; the rig is in its safe state.
    Tripped,
    /// Somebody asked for a stop; the rig is in its safe state.
    Stopped,
}

/// What the loop has to say about a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunReport {
    /// Number of the run, as in its samples.
    pub run: u32,
    /// How it ended.
    pub ended: Ended,
    /// The trip, when the supervisor tripped.
    pub trip: Option<Trip>,
    /// The counts.
    pub statistics: Statistics,
}

impl fmt::Display for RunReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Statistics { ticks, not_taken, .. } = self.statistics;
        write!(f, "run {}: {ticks} ticks, ", self.run)?;
        match (&self.ended, &self.trip) {
            (_, Some(trip)) => write!(f, "tripped: {trip}")?,
            (Ended::Stopped, None) => write!(f, "stopped on request")?,
            (_, None) => write!(f, "completed")?,
        }
        if not_taken > 0 {
            write!(f, "; {not_taken} samples were not taken by the publication")?;
        }
        Ok(())
    }
}
