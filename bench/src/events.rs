//! What a recording should say besides its samples: how the run ended, and what the drivers noted.

use drivers::journal::{self, Occurrence, When};
use profiles::{Playback, Timeout};
use recordings::{Event, Severity};
use rt_core::{Ended, LoopError, PERIOD_NS, RunReport};

/// What the logger has to know of the run's end: its length, and what a reader of the recording should see.
pub fn aftermath(outcome: &Result<RunReport, LoopError>) -> (Option<u64>, Vec<Event>) {
    let event = |tick: u64, severity, text: String| event(tick, severity, "loop", text);
    match outcome {
        Ok(report) => {
            let ticks = report.statistics.ticks;
            let last = (ticks + report.statistics.skipped).saturating_sub(1);
            let events = match report.ended {
                Ended::Completed if report.statistics.overruns == 0 => vec![],
                Ended::Completed | Ended::Stopped => vec![event(last, Severity::Warning, report.to_string())],
                Ended::Tripped | Ended::Aborted => vec![event(last, Severity::Error, report.to_string())],
            };
            (Some(ticks), events)
        }
        Err(LoopError::Device { source, statistics, .. }) => {
            (Some(statistics.ticks), vec![event(source.tick, Severity::Error, source.to_string())])
        }
        Err(error) => (Some(0), vec![event(0, Severity::Error, error.to_string())]),
    }
}

/// The drivers' notes as events. `origin_ns` is the run's tick 0 on `CLOCK_MONOTONIC`; what was noted before it stands at tick 0.
/// `untaken` notes found no room.
pub fn events_of(noted: &[Occurrence], origin_ns: u64, untaken: u64) -> Vec<Event> {
    let mut events: Vec<Event> = noted
        .iter()
        .map(|occurrence| {
            let tick = match occurrence.when {
                When::Tick(tick) => tick,
                When::MonotonicNs(at_ns) => at_ns.saturating_sub(origin_ns) / PERIOD_NS,
            };
            let severity = match occurrence.severity {
                journal::Severity::Info => Severity::Info,
                journal::Severity::Warning => Severity::Warning,
                journal::Severity::Error => Severity::Error,
            };
            event(tick, severity, occurrence.source, occurrence.text.to_string())
        })
        .collect();
    events.sort_by_key(|event| event.tick);
    if untaken > 0 {
        let text = format!("{untaken} notes of drivers found no room and are lost");
        events.push(event(events.last().map_or(0, |event| event.tick), Severity::Warning, "journal", text));
    }
    events
}

/// Steps of the script that ended because their time was over, and not because what they waited for had come.
pub fn timeouts_of(playback: &Playback) -> Vec<Event> {
    let said = |timeout: Timeout| event(timeout.tick, Severity::Warning, "profile", timeout.to_string());
    playback.timeouts().into_iter().map(said).collect()
}

fn event(tick: u64, severity: Severity, source: &str, text: String) -> Event {
    Event { tick, scheduled_ns: tick * PERIOD_NS, severity, source: source.to_owned(), text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::journal::JournalReader;

    #[test]
    fn notes_stand_at_their_ticks_whichever_clock_they_have() {
        let mut reader = JournalReader::default();
        let (mut serial, mut faults) = (reader.journal("amplifier"), reader.journal("faults"));
        let origin_ns = 77_000_000_000;
        serial.note(When::MonotonicNs(origin_ns + 5 * PERIOD_NS + 1), journal::Severity::Error, format_args!("gone"));
        serial.note(When::MonotonicNs(origin_ns - 1), journal::Severity::Info, format_args!("hello"));
        faults.note(When::Tick(3), journal::Severity::Warning, format_args!("stuck"));
        let events = events_of(&reader.read(), origin_ns, 0);
        let told: Vec<_> = events.iter().map(|event| (event.tick, event.source.as_str(), event.severity)).collect();
        assert_eq!(
            told,
            [(0, "amplifier", Severity::Info), (3, "faults", Severity::Warning), (5, "amplifier", Severity::Error)]
        );
        assert!(events_of(&[], 0, 2)[0].text.contains("2 notes"));
    }
}
