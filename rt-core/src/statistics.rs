//! What a run leaves behind in numbers: ticks, hand-overs, deadlines, how it ended.

use std::fmt;

use crate::flight::FlightTick;
use crate::publish::Handover;
use crate::supervisor::Trip;

/// Counts of one run; constant in size however long the run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Ticks that were completed.
    pub ticks: u64,
    /// Ticks that were passed over, because those before them took too long.
    pub skipped: u64,
    /// Ticks that ended after the next one should have begun.
    pub overruns: u64,
    /// Samples that the publication did not take (its queue was full, or it has ended).
    pub not_taken: u64,
    /// Largest lateness of a wake-up, ns; 0 in virtual time.
    pub lateness_max_ns: u64,
    /// Longest time from a wake-up to the end of its tick, ns; 0 in virtual time.
    pub tick_max_ns: u64,
    /// Incidents that the flight recorder had to drop, because nobody took those before them.
    pub incidents_dropped: u64,
}

impl Statistics {
    /// One tick is over.
    pub(crate) fn account(&mut self, tick: &FlightTick, handover: Handover) {
        self.ticks += 1;
        self.skipped = tick.sample.skipped;
        self.overruns += u64::from(tick.overran());
        self.not_taken += u64::from(handover == Handover::Lost);
        self.lateness_max_ns = self.lateness_max_ns.max(tick.sample.lateness_ns);
        self.tick_max_ns = self.tick_max_ns.max(tick.ended_ns.saturating_sub(tick.sample.lateness_ns));
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
    /// A deadline was missed and the overrun policy is to abort; the rig is in its safe state.
    Aborted,
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
        let Statistics { ticks, skipped, overruns, not_taken, .. } = self.statistics;
        write!(f, "run {}: {ticks} ticks, ", self.run)?;
        match (&self.ended, &self.trip) {
            (_, Some(trip)) => write!(f, "tripped: {trip}")?,
            (Ended::Stopped, None) => write!(f, "stopped on request")?,
            (Ended::Aborted, None) => {
                write!(f, "aborted: a deadline was missed before tick {}", (ticks + skipped).saturating_sub(1))?
            }
            (_, None) => write!(f, "completed")?,
        }
        if overruns > 0 {
            write!(f, "; {overruns} deadlines missed, {skipped} ticks skipped")?;
        }
        if not_taken > 0 {
            write!(f, "; {not_taken} samples were not taken by the publication")?;
        }
        Ok(())
    }
}
