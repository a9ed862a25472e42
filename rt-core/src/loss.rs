//! Loss is seen by the samples' numbers ([`Sample::sequence`]): within a run they count from 0 without gaps, and the last
//! sample says so. Where the loop passed over ticks, the numbers go on without a gap: nothing was lost there.

use std::collections::VecDeque;
use std::fmt;

use crate::types::Sample;

/// What a logger received of one run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LossCertificate {
    /// Number of the run.
    pub run: u32,
    /// Samples that the run has; a lower bound where `end_seen` is false.
    pub expected: u64,
    /// Samples that arrived.
    pub received: u64,
    /// Numbers of the samples that did not arrive: first and last of each gap, both included. They are ticks where the loop
    /// passed over none.
    pub gaps: Vec<(u64, u64)>,
    /// The run's length is known: its last sample arrived, or the loop's report told it.
    pub end_seen: bool,
}

impl LossCertificate {
    /// Every sample of the run arrived.
    pub fn is_lossless(&self) -> bool {
        self.end_seen && self.gaps.is_empty() && self.received == self.expected
    }
}

/// Gaps that are spelled out; a certificate holds all of them.
const GAPS_SHOWN: usize = 5;

impl fmt::Display for LossCertificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bound = if self.end_seen { "" } else { "at least " };
        write!(f, "{} of {bound}{} samples", self.received, self.expected)?;
        if !self.gaps.is_empty() {
            let gaps = self.gaps.iter().take(GAPS_SHOWN).map(|(first, last)| format!("{first}..={last}"));
            write!(f, "; missing samples {}", gaps.collect::<Vec<_>>().join(", "))?;
        }
        if self.gaps.len() > GAPS_SHOWN {
            write!(f, " and {} gaps more", self.gaps.len() - GAPS_SHOWN)?;
        }
        if !self.end_seen {
            write!(f, "; the end of the run did not arrive")?;
        }
        Ok(())
    }
}

/// A sample that can't follow those before it: no gap explains it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("run {run}: expected sample {expected} or later, got {got}; do two services publish on one instance?")]
pub struct OutOfOrder {
    /// Number of the run.
    pub run: u32,
    /// The lowest number that could follow.
    pub expected: u64,
    /// The number that came.
    pub got: u64,
}

/// Follows the samples that one subscriber receives, and certifies each run.
#[derive(Clone, Debug, Default)]
pub struct LossTracker {
    open: Option<OpenRun>,
    closed: VecDeque<LossCertificate>,
    /// The run that was opened or closed last.
    latest: Option<u32>,
}

#[derive(Clone, Debug)]
struct OpenRun {
    /// Which publisher the run comes from: a service that was killed and started again may count its runs anew.
    source: u128,
    run: u32,
    next_sequence: u64,
    received: u64,
    gaps: Vec<(u64, u64)>,
}

impl LossTracker {
    /// A sample arrived from the publisher `source` (0 where there is only one).
    pub fn received(&mut self, source: u128, sample: &Sample) -> Result<(), OutOfOrder> {
        if self.open.as_ref().is_some_and(|open| (open.source, open.run) != (source, sample.run)) {
            self.close_open(None);
        }
        self.latest = Some(sample.run);
        let open = self.open.get_or_insert_with(|| OpenRun {
            source,
            run: sample.run,
            next_sequence: 0,
            received: 0,
            gaps: Vec::new(),
        });
        let sequence = sample.sequence();
        if sequence < open.next_sequence {
            return Err(OutOfOrder { run: sample.run, expected: open.next_sequence, got: sequence });
        }
        if sequence > open.next_sequence {
            open.gaps.push((open.next_sequence, sequence - 1));
        }
        open.received += 1;
        open.next_sequence = sequence + 1;
        if sample.last() {
            self.close_open(Some(sequence + 1));
        }
        Ok(())
    }

    /// Closes `run` with the length that the loop's report tells, for a subscriber that did not see its end: samples up
    /// to `expected` that did not arrive are a gap. Run numbers must increase; a run that is closed already stays as it
    /// is.
    pub fn close(&mut self, run: u32, expected: u64) {
        if self.open.as_ref().is_some_and(|open| open.run == run) {
            self.close_open(Some(expected));
        } else if self.latest.is_none_or(|latest| run > latest) {
            self.close_open(None);
            self.latest = Some(run);
            let gaps = if expected > 0 { vec![(0, expected - 1)] } else { Vec::new() };
            self.closed.push_back(LossCertificate { run, expected, received: 0, gaps, end_seen: true });
        }
    }

    /// Closes the run that is still open, its end unseen: the subscriber goes.
    pub fn abandon(&mut self) {
        self.close_open(None);
    }

    /// The certificate of the oldest run that has ended and was not asked for yet.
    pub fn take(&mut self) -> Option<LossCertificate> {
        self.closed.pop_front()
    }

    fn close_open(&mut self, expected: Option<u64>) {
        let Some(OpenRun { run, next_sequence, received, mut gaps, .. }) = self.open.take() else { return };
        if let Some(expected) = expected.filter(|&expected| expected > next_sequence) {
            gaps.push((next_sequence, expected - 1));
        }
        let end_seen = expected.is_some();
        let expected = expected.unwrap_or(next_sequence).max(next_sequence);
        self.closed.push_back(LossCertificate { run, expected, received, gaps, end_seen });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::flags;

    fn sample(run: u32, tick: u64, last: bool) -> Sample {
        let flags = if last { flags::LAST } else { 0 };
        Sample { run, tick, flags, ..Sample::BLANK }
    }

    fn certificates(arrivals: &[(u32, u64, bool)]) -> Vec<LossCertificate> {
        let mut tracker = LossTracker::default();
        for &(run, tick, last) in arrivals {
            tracker.received(0, &sample(run, tick, last)).unwrap();
        }
        std::iter::from_fn(|| tracker.take()).collect()
    }

    #[test]
    fn a_complete_run_is_n_of_n() {
        let all: Vec<_> = (0..17_300).map(|tick| (3, tick, tick == 17_299)).collect();
        let certificates = certificates(&all);
        assert_eq!(certificates.len(), 1);
        assert_eq!(certificates[0].to_string(), "17300 of 17300 samples");
        assert!(certificates[0].is_lossless());
    }

    #[test]
    fn gaps_at_the_start_in_the_middle_and_a_run_without_end_are_certified() {
        let certificates = certificates(&[(0, 2, false), (0, 3, false), (0, 6, true), (1, 0, false), (2, 0, true)]);
        assert_eq!(certificates[0].gaps, [(0, 1), (4, 5)]);
        assert_eq!((certificates[0].received, certificates[0].expected), (3, 7));
        assert_eq!(certificates[0].to_string(), "3 of 7 samples; missing samples 0..=1, 4..=5");
        assert!(!certificates[0].is_lossless());
        assert_eq!(certificates[1].to_string(), "1 of at least 1 samples; the end of the run did not arrive");
        assert!(!certificates[1].is_lossless(), "an unknown length is no proof");
        assert!(certificates[2].is_lossless());
    }

    #[test]
    fn ticks_that_the_loop_passed_over_are_no_loss() {
        let mut tracker = LossTracker::default();
        for (tick, skipped, last) in [(0, 0, false), (1, 0, false), (7, 5, false), (8, 5, false), (11, 6, true)] {
            tracker.received(0, &Sample { skipped, ..sample(0, tick, last) }).unwrap();
        }
        let certificate = tracker.take().unwrap();
        assert_eq!(certificate.gaps, [(4, 4)], "tick 9 or 10 was run, and its sample did not arrive");
        assert_eq!((certificate.received, certificate.expected), (5, 6));
    }

    #[test]
    fn the_loop_s_report_closes_a_run_whose_end_was_lost() {
        let mut tracker = LossTracker::default();
        tracker.received(0, &sample(4, 0, false)).unwrap();
        tracker.close(4, 10);
        tracker.close(4, 10);
        tracker.close(5, 3);
        let first = tracker.take().unwrap();
        assert_eq!((first.expected, first.gaps.as_slice()), (10, &[(1, 9)][..]));
        assert_eq!(tracker.take().unwrap().gaps, [(0, 2)]);
        tracker.close(4, 10);
        tracker.close(5, 3);
        assert_eq!(tracker.take(), None, "certified once");
    }

    #[test]
    fn a_service_that_restarts_its_counting_is_another_run_but_going_back_is_an_error() {
        let mut tracker = LossTracker::default();
        for tick in 0..5 {
            tracker.received(7, &sample(0, tick, false)).unwrap();
        }
        let error = tracker.received(7, &sample(0, 3, false)).unwrap_err();
        assert_eq!(error, OutOfOrder { run: 0, expected: 5, got: 3 });
        tracker.received(8, &sample(0, 0, true)).unwrap();
        assert!(!tracker.take().unwrap().end_seen);
        assert!(tracker.take().unwrap().is_lossless());
    }
}
