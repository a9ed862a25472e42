//! What came of each wish, for people (one line each) and for a run's metadata.

use std::collections::BTreeMap;
use std::fmt;

/// One wish and what came of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grant {
    /// Short name, unique among the wishes; last part of the key in [`Report::notes`].
    pub what: &'static str,
    /// What the system said.
    pub outcome: Outcome,
}

/// What the system said to a wish.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It holds, read back from the system: what holds.
    Granted(String),
    /// It does not.
    Refused {
        /// What stands against it.
        cause: String,
        /// What to change.
        remedy: String,
    },
    /// It was not asked for, or this system knows no such thing.
    Absent(String),
}

impl Grant {
    pub(super) fn granted(what: &'static str, text: impl Into<String>) -> Self {
        Grant { what, outcome: Outcome::Granted(text.into()) }
    }

    pub(super) fn refused(what: &'static str, cause: impl Into<String>, remedy: impl Into<String>) -> Self {
        Grant { what, outcome: Outcome::Refused { cause: cause.into(), remedy: remedy.into() } }
    }

    pub(super) fn absent(what: &'static str, text: impl Into<String>) -> Self {
        Grant { what, outcome: Outcome::Absent(text.into()) }
    }

    /// The system refused it.
    pub fn is_refused(&self) -> bool {
        matches!(self.outcome, Outcome::Refused { .. })
    }
}

impl fmt::Display for Outcome {
    /// Without the remedy.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Outcome::Granted(text) => f.write_str(text),
            Outcome::Refused { cause, .. } => write!(f, "refused: {cause}"),
            Outcome::Absent(text) => write!(f, "none: {text}"),
        }
    }
}

impl fmt::Display for Grant {
    /// One line, with the remedy.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.outcome)?;
        match &self.outcome {
            Outcome::Refused { remedy, .. } => write!(f, "; remedy: {remedy}"),
            Outcome::Granted(_) | Outcome::Absent(_) => Ok(()),
        }
    }
}

/// What came of several wishes, in the order in which they were asked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report(Vec<Grant>);

impl Report {
    /// A report on these.
    pub fn new(grants: Vec<Grant>) -> Self {
        Report(grants)
    }

    /// All wishes.
    pub fn grants(&self) -> &[Grant] {
        &self.0
    }

    /// Those that the system refused.
    pub fn refused(&self) -> Vec<&Grant> {
        self.0.iter().filter(|grant| grant.is_refused()).collect()
    }

    /// For a run's metadata: `realtime.<what>` = what holds, or why it does not. Without the remedies.
    pub fn notes(&self) -> BTreeMap<String, String> {
        self.0.iter().map(|grant| (format!("realtime.{}", grant.what), grant.outcome.to_string())).collect()
    }
}

impl fmt::Display for Report {
    /// One line per wish, without a line break after the last.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, grant) in self.0.iter().enumerate() {
            let line_break = if number == 0 { "" } else { "\n" };
            write!(f, "{line_break}{grant}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_each_with_the_remedy_and_notes_without_it() {
        let report = Report::new(vec![
            Grant::granted("sched", "SCHED_FIFO 80"),
            Grant::refused("memory", "limit 8 MiB", "raise it"),
            Grant::absent("affinity", "not asked for"),
        ]);
        assert_eq!(
            report.to_string(),
            "sched: SCHED_FIFO 80\nmemory: refused: limit 8 MiB; remedy: raise it\naffinity: none: not asked for"
        );
        assert_eq!(report.refused(), [&report.grants()[1]]);
        let notes: Vec<_> = report.notes().into_iter().collect();
        let expected = [
            ("realtime.affinity", "none: not asked for"),
            ("realtime.memory", "refused: limit 8 MiB"),
            ("realtime.sched", "SCHED_FIFO 80"),
        ];
        assert_eq!(notes, expected.map(|(key, value)| (key.to_owned(), value.to_owned())));
        assert_eq!(Report::default().to_string(), "");
    }
}
