//! Flow control of the publication in virtual time: how many samples may be sent without overrunning a lossless
//! logger's buffer. Logic only; time and the loggers' messages are arguments.
//!
//! A position counts all samples that were ever sent on the service; the loggers speak of run and tick.

use std::collections::VecDeque;
use std::time::Duration;

use crate::types::Sample;

/// Name of a logger: the id of the port on which it reports its progress.
pub(crate) type LoggerId = u128;

#[derive(Debug)]
pub(crate) struct Flow {
    sent: u64,
    runs: VecDeque<RunStart>,
    loggers: Vec<Logger>,
    /// Samples that may be under way to a logger.
    window: u64,
    /// A logger that holds the run up for this long without any progress is no longer waited for.
    patience: Duration,
}

#[derive(Debug)]
struct RunStart {
    run: u32,
    first: u64,
    position: u64,
}

#[derive(Debug)]
struct Logger {
    id: LoggerId,
    /// Position up to which it has taken its samples.
    taken: u64,
    /// Since when it holds the run up without progress.
    holding_since: Option<Duration>,
    given_up: bool,
}

/// What [`Flow::room`] found.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Room {
    /// Samples that may be sent now.
    pub samples: u64,
    /// Loggers that are no longer waited for, as of now.
    pub given_up: Vec<LoggerId>,
    /// For how long the run has been held up.
    pub held_for: Duration,
}

impl Flow {
    pub fn new(window: u64, patience: Duration) -> Self {
        Flow { sent: 0, runs: VecDeque::new(), loggers: Vec::new(), window, patience }
    }

    /// These loggers exist now. A new one owes nothing that was sent before it came; one that is gone owes nothing.
    pub fn present(&mut self, ids: &[LoggerId]) {
        self.loggers.retain(|logger| ids.contains(&logger.id));
        for &id in ids {
            if !self.loggers.iter().any(|logger| logger.id == id) {
                self.loggers.push(Logger { id, taken: self.sent, holding_since: None, given_up: false });
            }
        }
    }

    /// A logger has taken everything up to, but without, `next_sequence` of `run`.
    pub fn progress(&mut self, id: LoggerId, run: u32, next_sequence: u64) {
        let position = self.position(run, next_sequence);
        let half_window = self.window / 2;
        let sent = self.sent;
        let (Some(position), Some(logger)) = (position, self.loggers.iter_mut().find(|l| l.id == id)) else {
            return;
        };
        if position > logger.taken {
            logger.taken = position.min(sent);
            logger.holding_since = None;
            // Waited for again once it has caught up; what it missed meanwhile is in its certificate.
            logger.given_up &= sent - logger.taken > half_window;
        }
        self.forget_runs();
    }

    /// A sample was sent.
    pub fn sent(&mut self, sample: &Sample) {
        if self.runs.back().is_none_or(|newest| newest.run != sample.run || sample.sequence() == 0) {
            self.forget_runs();
            self.runs.push_back(RunStart { run: sample.run, first: sample.sequence(), position: self.sent });
        }
        self.sent += 1;
    }

    /// How many samples may be sent.
    pub fn room(&mut self, now: Duration) -> Room {
        let mut room = Room { samples: self.window, given_up: Vec::new(), held_for: Duration::ZERO };
        for logger in self.loggers.iter_mut().filter(|logger| !logger.given_up) {
            let vacant = self.window.saturating_sub(self.sent - logger.taken);
            if vacant == 0 {
                let held_for = now.saturating_sub(*logger.holding_since.get_or_insert(now));
                if held_for >= self.patience {
                    logger.given_up = true;
                    room.given_up.push(logger.id);
                    continue;
                }
                room.held_for = room.held_for.max(held_for);
            }
            room.samples = room.samples.min(vacant);
        }
        room
    }

    /// Lossless loggers that exist.
    pub fn loggers(&self) -> usize {
        self.loggers.len()
    }

    /// Position up to which every logger that is waited for has taken its samples.
    pub fn taken_by_all(&self) -> u64 {
        let waited_for = self.loggers.iter().filter(|logger| !logger.given_up);
        waited_for.map(|logger| logger.taken).min().unwrap_or(self.sent)
    }

    fn position(&self, run: u32, next_sequence: u64) -> Option<u64> {
        let start = self.runs.iter().rev().find(|start| start.run == run)?;
        Some(start.position + next_sequence.checked_sub(start.first)?)
    }

    /// Runs that every logger has left behind can't be spoken of any more.
    fn forget_runs(&mut self) {
        let oldest = self.loggers.iter().map(|logger| logger.taken).min().unwrap_or(self.sent);
        while self.runs.get(1).is_some_and(|second| second.position < oldest) {
            self.runs.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Duration = Duration::from_secs(5);

    fn send(flow: &mut Flow, run: u32, ticks: std::ops::Range<u64>) {
        for tick in ticks {
            let sample = Sample { run, tick, ..Sample::BLANK };
            flow.sent(&sample);
        }
    }

    fn samples(flow: &mut Flow, now_s: u64) -> u64 {
        flow.room(Duration::from_secs(now_s)).samples
    }

    #[test]
    fn the_slowest_logger_sets_the_pace_across_runs() {
        let mut flow = Flow::new(100, PATIENCE);
        assert_eq!(samples(&mut flow, 0), 100, "nobody to wait for");
        flow.present(&[1, 2]);
        send(&mut flow, 0, 0..60);
        flow.progress(1, 0, 60);
        assert_eq!(samples(&mut flow, 0), 40);
        send(&mut flow, 1, 0..40);
        assert_eq!(samples(&mut flow, 0), 0);
        flow.progress(2, 1, 10);
        assert_eq!(samples(&mut flow, 0), 60, "logger 1 is at 60 of 100 sent");
        assert_eq!(flow.taken_by_all(), 60);
        flow.present(&[2]);
        assert_eq!(samples(&mut flow, 0), 70, "logger 1 has gone");
        flow.present(&[]);
        assert_eq!((samples(&mut flow, 0), flow.taken_by_all()), (100, 100));
    }

    #[test]
    fn a_logger_that_joins_late_owes_nothing_of_before() {
        let mut flow = Flow::new(100, PATIENCE);
        send(&mut flow, 0, 0..1000);
        flow.present(&[1]);
        assert_eq!(samples(&mut flow, 0), 100);
        flow.progress(1, 0, 5);
        assert_eq!(samples(&mut flow, 0), 100, "progress never goes back");
    }

    #[test]
    fn a_stalled_logger_is_given_up_after_the_patience_and_waited_for_again_once_it_caught_up() {
        let mut flow = Flow::new(100, PATIENCE);
        flow.present(&[9]);
        send(&mut flow, 0, 0..100);
        assert_eq!(flow.room(Duration::from_secs(1)).held_for, Duration::ZERO);
        assert_eq!(flow.room(Duration::from_secs(5)).held_for, Duration::from_secs(4));
        let room = flow.room(Duration::from_secs(6));
        assert_eq!((room.samples, room.given_up), (100, vec![9]));
        assert_eq!(flow.room(Duration::from_secs(7)).given_up, [], "said once");
        send(&mut flow, 0, 100..500);
        flow.progress(9, 0, 300);
        assert_eq!(samples(&mut flow, 8), 100, "200 behind: not yet");
        flow.progress(9, 0, 480);
        assert_eq!(samples(&mut flow, 8), 80);
    }

    #[test]
    fn any_progress_renews_the_patience() {
        let mut flow = Flow::new(10, PATIENCE);
        flow.present(&[1]);
        send(&mut flow, 0, 0..10);
        for second in 0..60 {
            assert_eq!(flow.room(Duration::from_secs(second * 4)).given_up, []);
            flow.progress(1, 0, second + 1);
            send(&mut flow, 0, 10 + second..11 + second);
        }
    }

    #[test]
    fn what_counts_is_the_samples_not_the_ticks_that_were_passed_over() {
        let mut flow = Flow::new(100, PATIENCE);
        flow.present(&[1]);
        for (tick, skipped) in [(0, 0), (1, 0), (70, 68), (71, 68)] {
            flow.sent(&Sample { tick, skipped, ..Sample::BLANK });
        }
        assert_eq!(samples(&mut flow, 0), 96);
        flow.progress(1, 0, 3);
        assert_eq!((samples(&mut flow, 0), flow.taken_by_all()), (99, 3));
        flow.progress(1, 0, 4);
        assert_eq!((samples(&mut flow, 0), flow.taken_by_all()), (100, 4));
    }

    #[test]
    fn numbers_that_ran_ahead_of_what_was_sent_free_no_room_that_is_not_there() {
        let mut flow = Flow::new(100, PATIENCE);
        flow.present(&[1]);
        // Numbers 10..50 found no room in the queue and were never sent.
        send(&mut flow, 0, 0..10);
        send(&mut flow, 0, 50..60);
        flow.progress(1, 0, 60);
        assert_eq!((samples(&mut flow, 0), flow.taken_by_all()), (100, 20));
        flow.progress(1, 3, 5);
        assert_eq!(flow.taken_by_all(), 20, "nobody knows of run 3");
    }

    #[test]
    fn memory_stays_constant_over_many_runs() {
        let mut flow = Flow::new(100, PATIENCE);
        flow.present(&[1]);
        for run in 0..10_000 {
            send(&mut flow, run, 0..20);
            flow.progress(1, run, 20);
        }
        assert!(flow.runs.len() <= 2, "{} runs kept", flow.runs.len());
    }
}
