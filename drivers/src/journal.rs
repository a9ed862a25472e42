//! What happened in a driver, for the recording: written by the loop and by I/O threads without waiting or allocating, read by
//! whoever records.

use crate::telemetry::TelemetryReader;
use arrayvec::ArrayString;
use ringbuf::traits::{Consumer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};
use std::fmt::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Most bytes of an entry's text; what is longer is cut off.
const LONGEST_TEXT: usize = 200;
/// Entries that a writer may be ahead of the reader.
const AHEAD: usize = 256;

/// When something happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// At this tick of the run: said by what the loop calls.
    Tick(u64),
    /// At this time, `CLOCK_MONOTONIC`, ns: said by what does not know the run.
    MonotonicNs(u64),
}

/// How much it matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// To be known.
    Info,
    /// The data may be worse for it.
    Warning,
    /// Something failed.
    Error,
}

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Occurrence {
    /// When.
    pub when: When,
    /// How much it matters.
    pub severity: Severity,
    /// Which driver says so.
    pub source: &'static str,
    /// What: expected, got, consequence.
    pub text: ArrayString<LONGEST_TEXT>,
}

/// The journal of one driver.
pub struct Journal {
    entries: HeapProd<Occurrence>,
    untaken: Arc<AtomicU64>,
    source: &'static str,
}

impl Journal {
    /// Notes something. Does not wait and does not allocate; what finds no room is counted.
    pub fn note(&mut self, when: When, severity: Severity, text: fmt::Arguments<'_>) {
        let mut cut = Cut(ArrayString::new());
        // Cut::write_str never fails.
        let _ = cut.write_fmt(text);
        let occurrence = Occurrence { when, severity, source: self.source, text: cut.0 };
        if self.entries.try_push(occurrence).is_err() {
            self.untaken.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Takes as much of a text as there is room for.
struct Cut(ArrayString<LONGEST_TEXT>);

impl Write for Cut {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.0.remaining_capacity();
        let fits = (0..=room.min(text.len())).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        self.0.push_str(&text[..fits]);
        Ok(())
    }
}

/// The journals of all drivers of a rig, and its amplifier's reports.
#[derive(Default)]
pub struct JournalReader {
    journals: Vec<HeapCons<Occurrence>>,
    untaken: Arc<AtomicU64>,
    telemetry: Option<TelemetryReader>,
}

impl JournalReader {
    /// A journal for another driver.
    pub fn journal(&mut self, source: &'static str) -> Journal {
        let (entries, taken) = HeapRb::new(AHEAD).split();
        self.journals.push(taken);
        Journal { entries, untaken: self.untaken.clone(), source }
    }

    /// What was noted since the last call, by driver and in the order in which each noted it.
    pub fn read(&mut self) -> Vec<Occurrence> {
        self.journals.iter_mut().flat_map(|journal| journal.pop_iter().collect::<Vec<_>>()).collect()
    }

    /// The amplifier's reports are read here, until [`JournalReader::take_telemetry`].
    pub fn keep_telemetry(&mut self, reader: Option<TelemetryReader>) {
        self.telemetry = reader;
    }

    /// Where the amplifier's reports are read: for whoever records them, once. `None`: there is no amplifier, or they were taken.
    pub fn take_telemetry(&mut self) -> Option<TelemetryReader> {
        self.telemetry.take()
    }

    /// Entries that found no room, since the start.
    pub fn untaken(&self) -> u64 {
        self.untaken.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_two_drivers_note_is_read_once() {
        let mut reader = JournalReader::default();
        let (mut serial, mut can) = (reader.journal("serial"), reader.journal("can"));
        serial.note(When::Tick(3), Severity::Error, format_args!("port {} is gone", "/dev/ttyS0"));
        can.note(When::MonotonicNs(9), Severity::Info, format_args!("bus active"));
        let read = reader.read();
        assert_eq!(read.iter().map(|entry| entry.source).collect::<Vec<_>>(), ["serial", "can"]);
        assert_eq!((read[0].when, &*read[0].text), (When::Tick(3), "port /dev/ttyS0 is gone"));
        assert_eq!(reader.read(), []);
    }

    #[test]
    fn a_long_text_is_cut_at_a_character_and_a_full_journal_counts() {
        let mut reader = JournalReader::default();
        let mut journal = reader.journal("can");
        let long = "ä".repeat(LONGEST_TEXT);
        for _ in 0..AHEAD + 3 {
            journal.note(When::Tick(0), Severity::Info, format_args!("x{long}"));
        }
        assert_eq!(reader.untaken(), 3);
        let read = reader.read();
        assert_eq!(read.len(), AHEAD);
        assert!(long.starts_with(&read[0].text[1..]) && read[0].text.len() >= LONGEST_TEXT - 1);
    }
}
