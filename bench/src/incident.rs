//! The flight recorder's incidents as files beside the recording, and as events in it.

use crate::progress::Progress;
use recordings::{Event, Severity};
use rt_core::flight::{FlightTick, Reason};
use rt_core::{FlightLog, Incident, PERIOD_NS};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Files that one run leaves at most; what happens after that is counted.
const FILES_MAX: usize = 20;

/// Incidents that are told while the run goes on; those after them are in the recording.
const TOLD_MAX: usize = 3;

/// The incidents of one run.
pub struct Incidents {
    recording: PathBuf,
    files: Vec<PathBuf>,
    events: Vec<Event>,
    unwritten: u64,
}

impl Incidents {
    /// Of the run that is recorded in this file.
    pub fn beside(recording: &Path) -> Self {
        Incidents { recording: recording.to_owned(), files: Vec::new(), events: Vec::new(), unwritten: 0 }
    }

    /// Writes what the recorder has handed over. A file that can't be written is said, and costs the run nothing.
    pub fn write(&mut self, log: &mut FlightLog, progress: &Progress) {
        while let Some(incident) = log.take() {
            let severity = if incident.reason == Reason::Overrun { Severity::Warning } else { Severity::Error };
            let mut text = incident.to_string();
            if self.files.len() < FILES_MAX {
                let path = self.path(&incident);
                match std::fs::write(&path, format!("{}\n", document(&incident))) {
                    Ok(()) => {
                        text.push_str(&format!("; see {}", path.file_name().unwrap_or_default().display()));
                        self.files.push(path);
                    }
                    Err(error) => {
                        text.push_str(&format!("; {} could not be written: {error}", path.display()));
                        self.unwritten += 1;
                    }
                }
            } else {
                self.unwritten += 1;
            }
            match self.events.len() {
                told if told < TOLD_MAX => progress.say(&text),
                TOLD_MAX => progress.say("further incidents are told in the recording and its files only"),
                _ => {}
            }
            self.events.push(Event {
                tick: incident.tick,
                scheduled_ns: incident.tick * PERIOD_NS,
                severity,
                source: "flight recorder".to_owned(),
                text,
            });
        }
    }

    /// What the recording should say.
    pub fn events(&self) -> Vec<Event> {
        self.events.clone()
    }

    /// The files, in the order of the incidents.
    pub fn files(self) -> Vec<PathBuf> {
        self.files
    }

    fn path(&self, incident: &Incident) -> PathBuf {
        let name = format!("{}-{}.json", incident.tick, incident.reason.name());
        self.recording.with_extension(name)
    }
}

/// Columns of the ticks, with units.
const COLUMNS: [&str; 18] = [
    "tick",
    "skipped",
    "lateness_ns",
    "behind_ns",
    "read_ns",
    "check_ns",
    "reference_ns",
    "control_ns",
    "write_ns",
    "publish_ns",
    "ended_ns",
    "voltage_v",
    "angle_deg",
    "pressure1_bar",
    "pressure2_bar",
    "torque_nm",
    "flags",
    "trip",
];

fn row(tick: &FlightTick) -> Value {
    let s = &tick.sample;
    json!([
        s.tick,
        s.skipped,
        s.lateness_ns,
        s.behind_ns,
        s.read_ns,
        s.check_ns,
        s.reference_ns,
        s.control_ns,
        s.write_ns,
        tick.publish_ns,
        tick.ended_ns,
        s.voltage_v,
        s.angle_deg,
        s.pressure1_bar,
        s.pressure2_bar,
        s.torque_nm,
        s.flags,
        s.trip,
    ])
}

fn document(incident: &Incident) -> Value {
    let at = incident.at();
    let shares = at.map(|at| {
        let share = |(culprit, ns): (rt_core::flight::Culprit, u64)| {
            json!({ "part": culprit.name(), "ns": ns, "usual_ns": incident.usual_ns(culprit) })
        };
        at.shares().map(share).to_vec()
    });
    json!({
        "format": 1,
        "reason": incident.reason.name(),
        "tick": incident.tick,
        "text": incident.to_string(),
        "culprit": at.filter(|_| incident.reason == Reason::Overrun).map(|at| at.culprit().name()),
        "parts": shares,
        "further_incidents": incident.further,
        "columns": COLUMNS,
        "ticks": incident.ticks.iter().map(row).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::Sample;

    #[test]
    fn a_slow_device_is_named_in_the_file_with_what_is_usual() {
        let tick = |tick: u64, read_ns: u32| {
            let sample = Sample { tick, scheduled_ns: tick * PERIOD_NS, read_ns, ..Sample::BLANK };
            FlightTick { sample, publish_ns: 900, ended_ns: u64::from(read_ns) + 900 }
        };
        let (mut recorder, mut log) = rt_core::flight::recorder();
        recorder.begin_run();
        for k in 0..3000 {
            recorder.record(tick(k, if k == 2500 { 7_000_000 } else { 800 }));
        }
        assert_eq!(recorder.end_run(), 0);
        let dir = tempfile::tempdir().expect("a temporary folder");
        let mut incidents = Incidents::beside(&dir.path().join("square_h.mcap"));
        incidents.write(&mut log, &Progress::for_stderr());
        assert!(
            incidents.events()[0].text.contains("slow device, 7.000 ms (usually 0.0008 ms)"),
            "{:?}",
            incidents.events()
        );
        let files = incidents.files();
        assert_eq!(files, [dir.path().join("square_h.2500-overrun.json")]);
        let text = std::fs::read_to_string(&files[0]).expect("was written");
        let read: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!((&read["tick"], &read["culprit"]), (&json!(2500), &json!("slow device")));
        let ticks = read["ticks"].as_array().expect("the ticks");
        assert_eq!(ticks.len(), 2000);
        assert_eq!(ticks[0].as_array().map(Vec::len), Some(COLUMNS.len()));
    }
}
