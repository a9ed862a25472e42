//! Every report of an amplifier as it arrived, for the recording: written by the thread that owns the port without waiting or
//! allocating, read by whoever records. The loop itself sees the newest report only.

use crate::amplifier::Telemetry;
use crate::exchange::{Giver, Taker, exchange};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Reports that the writer may be ahead of the reader: at one each tick 8 s, as long as samples wait for their logger.
pub const AHEAD: usize = 8192;

/// A report, and when it came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrived {
    /// When it was received: `CLOCK_MONOTONIC`, ns.
    pub received_ns: u64,
    /// What it says.
    pub telemetry: Telemetry,
}

/// Both ends of a log.
pub fn telemetry_log() -> (TelemetryLog, TelemetryReader) {
    let ((give, take), untaken) = (exchange(AHEAD), Arc::new(AtomicU64::new(0)));
    (TelemetryLog { reports: give, untaken: untaken.clone() }, TelemetryReader { reports: take, untaken })
}

/// The end of the thread that owns the port.
pub struct TelemetryLog {
    reports: Giver<Arrived>,
    untaken: Arc<AtomicU64>,
}

impl TelemetryLog {
    /// Notes a report. Does not wait and does not allocate; what finds no room is counted.
    pub fn note(&mut self, arrived: Arrived) {
        if !self.reports.give(arrived) {
            self.untaken.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The end of whoever records. Dropped, the reports find no room any more.
pub struct TelemetryReader {
    reports: Taker<Arrived>,
    untaken: Arc<AtomicU64>,
}

impl TelemetryReader {
    /// The oldest report that was not taken yet.
    pub fn take(&mut self) -> Option<Arrived> {
        self.reports.oldest()
    }

    /// Reports that found no room, since the link was opened.
    pub fn untaken(&self) -> u64 {
        self.untaken.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_come_in_order_and_what_finds_no_room_is_counted() {
        let (mut log, mut reader) = telemetry_log();
        let arrived = |received_ns| Arrived { received_ns, telemetry: Telemetry::default() };
        for n in 0..AHEAD as u64 + 3 {
            log.note(arrived(n));
        }
        assert_eq!(reader.untaken(), 3);
        assert_eq!(reader.take().map(|report| report.received_ns), Some(0));
        log.note(arrived(7_777_777));
        let rest: Vec<u64> = std::iter::from_fn(|| reader.take()).map(|report| report.received_ns).collect();
        assert!(rest.iter().copied().eq((1..AHEAD as u64).chain([7_777_777])));
        assert_eq!((reader.take(), reader.untaken()), (None, 3));
    }
}
