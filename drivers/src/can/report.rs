//! What the thread of a bus notes in the journal: each change of the bus at once, what may come a thousand times a second in one entry
//! a second.

use super::arrival::monotonic_ns;
use super::{Condition, ErrorFrame, Interface};
use crate::journal::{Journal, Severity, When};
use std::fmt;
use std::time::Duration;

/// Between two summaries; the thread calls [`Reporter::sum_up`] so often.
pub(super) const EVERY: Duration = Duration::from_secs(1);
/// Changes that are noted at once; another is allowed each time that summaries are due.
const CHANGES: u32 = 8;

pub(super) struct Reporter {
    journal: Journal,
    interface: Interface,
    changes_left: u32,
    /// Changes since the last one that was noted, and what they came to.
    unnoted: Option<(u32, Condition)>,
    unsent: Counted,
    lost: Counted,
    dropped: Counted,
    errors: Counted,
    /// The first error frame since the last summary.
    problem: Option<ErrorFrame>,
}

/// Something that is counted, and noted once a second.
#[derive(Default)]
struct Counted {
    count: u64,
    first_ns: u64,
}

impl Counted {
    fn add(&mut self, count: u64) {
        if self.count == 0 {
            self.first_ns = monotonic_ns();
        }
        self.count += count;
    }

    /// How many since the last call, and since when.
    fn take(&mut self) -> Option<(u64, When)> {
        let Counted { count, first_ns } = std::mem::take(self);
        (count > 0).then_some((count, When::MonotonicNs(first_ns)))
    }
}

impl Reporter {
    pub(super) fn new(journal: Journal, interface: Interface) -> Reporter {
        Reporter {
            journal,
            interface,
            changes_left: CHANGES,
            unnoted: None,
            unsent: Counted::default(),
            lost: Counted::default(),
            dropped: Counted::default(),
            errors: Counted::default(),
            problem: None,
        }
    }

    /// The bus is in another condition, for this reason.
    pub(super) fn changed(&mut self, condition: Condition, why: fmt::Arguments<'_>) {
        if self.changes_left == 0 {
            let (changes, _) = self.unnoted.unwrap_or((0, condition));
            self.unnoted = Some((changes + 1, condition));
            return;
        }
        self.changes_left -= 1;
        self.unnoted = None;
        let remedy = Remedy(&self.interface, condition);
        let now = When::MonotonicNs(monotonic_ns());
        self.journal.note(now, severity(condition), format_args!("{}: {condition}: {why}{remedy}", self.interface));
    }

    /// Something to be known.
    pub(super) fn remark(&mut self, severity: Severity, what: fmt::Arguments<'_>) {
        self.journal.note(When::MonotonicNs(monotonic_ns()), severity, format_args!("{}: {what}", self.interface));
    }

    pub(super) fn unsent(&mut self, frames: u64) {
        self.unsent.add(frames);
    }

    pub(super) fn lost(&mut self) {
        self.lost.add(1);
    }

    /// Before this thread could read them.
    pub(super) fn dropped(&mut self, frames: u64) {
        self.dropped.add(frames);
    }

    pub(super) fn problem(&mut self, error: ErrorFrame) {
        self.errors.add(1);
        self.problem.get_or_insert(error);
    }

    /// Notes what was only counted since the last time.
    pub(super) fn sum_up(&mut self) {
        let interface = &self.interface;
        let mut note = |when, text: fmt::Arguments<'_>| self.journal.note(when, Severity::Warning, text);
        if let Some((frames, when)) = self.unsent.take() {
            note(
                when,
                format_args!(
                    "{interface}: {frames} command frames not sent before newer ones came: bus full, nobody acknowledges, or this thread was held up"
                ),
            );
        }
        if let Some((frames, when)) = self.lost.take() {
            note(
                when,
                format_args!("{interface}: {frames} frames lost: more than the loop takes came; does a node babble?"),
            );
        }
        if let Some((frames, when)) = self.dropped.take() {
            let why = "this thread was held up; give it a processor, or raise net.core.rmem_max";
            note(when, format_args!("{interface}: {frames} frames dropped by the system, its buffer was full: {why}"));
        }
        if let (Some((frames, when)), Some(first)) = (self.errors.take(), self.problem.take()) {
            note(when, format_args!("{interface}: {frames} error frames, first: {first}"));
        }
        self.changes_left = CHANGES.min(self.changes_left + 1);
        if let Some((changes, condition)) = self.unnoted.take() {
            self.changed(condition, format_args!("{changes} more changes"));
        }
    }
}

fn severity(condition: Condition) -> Severity {
    match condition {
        Condition::Active => Severity::Info,
        Condition::Warning | Condition::Passive => Severity::Warning,
        Condition::BusOff | Condition::Down => Severity::Error,
    }
}

/// What to do about a condition.
struct Remedy<'a>(&'a Interface, Condition);

impl fmt::Display for Remedy<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.1, self.0) {
            (Condition::BusOff, Interface::SocketCan(name)) => write!(
                f,
                "; check wiring, termination and bit rate, then `ip link set {name} type can restart` (by itself: `restart-ms 100`)"
            ),
            (Condition::Passive, _) => f.write_str("; check wiring, termination, bit rate and that a node is there"),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::JournalReader;
    use socketcan::CanErrorFrame;

    #[test]
    fn a_bus_that_flaps_and_a_node_that_babbles_make_few_entries_and_the_last_word_is_right() {
        let mut reader = JournalReader::default();
        let mut reporter = Reporter::new(reader.journal("can"), Interface::SocketCan("can0".into()));
        for _ in 0..100 {
            reporter.changed(Condition::BusOff, format_args!("bus off"));
            reporter.changed(Condition::Active, format_args!("restarted"));
        }
        for _ in 0..10_000 {
            reporter.lost();
            let stuffing = CanErrorFrame::new_error(libc::CAN_ERR_PROT, &[0, 0, 4]).expect("3 bytes");
            reporter.problem(ErrorFrame::new(stuffing));
        }
        reporter.changed(Condition::Passive, format_args!("tx passive"));
        let changes = reader.read();
        assert_eq!(changes.len(), CHANGES as usize);
        assert!(changes[0].text.contains("can0: bus-off: bus off; check") && changes[0].severity == Severity::Error);
        assert!(changes[0].text.contains("ip link set can0 type can restart"), "{}", changes[0].text);
        reporter.sum_up();
        let texts: Vec<_> = reader.read().iter().map(|entry| entry.text.to_string()).collect();
        assert_eq!(texts.len(), 3, "{texts:?}");
        assert!(texts[0].contains("10000 frames lost"), "{texts:?}");
        assert!(texts[1].contains("10000 error frames, first: protocol violation"), "{texts:?}");
        assert!(texts[2].contains("error-passive: 193 more changes"), "{texts:?}");
        reporter.sum_up();
        assert_eq!(reader.read(), [], "nothing new");
    }
}
