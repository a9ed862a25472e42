//! What happened, for whoever watches: the last events, numbered.

use std::collections::VecDeque;
use std::sync::Arc;

/// Events that are kept for who comes later.
const KEPT: usize = 200;
/// Longest text, bytes: a run may say anything.
const TEXT_MOST: usize = 1000;

/// How bad an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Part of normal work.
    Info,
    /// A person should know.
    Warning,
    /// Something is not as it was meant to be.
    Error,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Event {
    /// Counts up from 1.
    pub number: u64,
    /// When, ISO 8601.
    pub utc: String,
    /// How bad it is.
    pub severity: Severity,
    /// Who says it.
    pub source: &'static str,
    /// What happened.
    pub text: String,
    /// Number of the run that it belongs to.
    pub run: Option<u32>,
    /// When in the run, s.
    pub time_s: Option<f64>,
}

/// See the module.
#[derive(Debug, Default)]
pub struct EventLog {
    events: VecDeque<Arc<Event>>,
    numbered: u64,
}

impl EventLog {
    /// Notes an event; its number and time are given here.
    pub fn note(&mut self, severity: Severity, source: &'static str, text: &str, run: Option<(u32, Option<f64>)>) {
        self.numbered += 1;
        let fits = (0..=text.len().min(TEXT_MOST)).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        if self.events.len() == KEPT {
            self.events.pop_front();
        }
        self.events.push_back(Arc::new(Event {
            number: self.numbered,
            utc: utc_now(),
            severity,
            source,
            text: text[..fits].to_owned(),
            run: run.map(|(run, _)| run),
            time_s: run.and_then(|(_, time_s)| time_s),
        }));
    }

    /// Those that are kept with a number above `after`.
    pub fn since(&self, after: u64) -> Vec<Arc<Event>> {
        self.events.iter().filter(|event| event.number > after).cloned().collect()
    }
}

/// ISO 8601 with milliseconds.
pub fn utc_now() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%S%.3fZ").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_events_are_kept_and_each_is_told_once() {
        let mut log = EventLog::default();
        for k in 0..KEPT + 50 {
            log.note(Severity::Info, "test", &format!("{k}"), Some((1, None)));
        }
        let all = log.since(0);
        assert_eq!((all.len(), all[0].text.as_str(), all[0].number), (KEPT, "50", 51));
        assert_eq!(log.since(249).iter().map(|event| event.number).collect::<Vec<_>>(), [250]);
        assert!(log.since(250).is_empty());
        log.note(Severity::Error, "test", &"ü".repeat(TEXT_MOST), None);
        assert_eq!(log.since(250)[0].text.len(), TEXT_MOST);
    }
}
