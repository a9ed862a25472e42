//! Every report of the amplifier reaches the recorder, once and in order, at 1 kHz: both sides count. The amplifier here reports without being
//! asked, a thousand times a second on average however busy the machine is, and numbers its reports in the speed that it tells.
//! `REC_BENCH_SECONDS=60` makes it a minute.

#![allow(clippy::unwrap_used, reason = "a test")]

mod serial_pty;

use drivers::amplifier::{DriveState, Outbox, Telemetry, protocol};
use drivers::journal::JournalReader;
use drivers::serial::{Pty, SerialLink};
use rt_core::system::time::{monotonic_ns, sleep_until_ns};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serial_pty::{settings, until};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;

const PERIOD_NS: u64 = 1_000_000;

/// An amplifier that sends so many numbered reports, one each millisecond, besides its answers, and counts what it sends.
fn report(pty: &Pty, count: u64, sent: &AtomicU64, end: &AtomicBool) {
    let kind = protocol("vesc").unwrap();
    let settings = settings("vesc", pty.path());
    let mut drive = (kind.drive)(&settings).unwrap();
    let mut request = Outbox::new();
    (kind.client)(&settings).unwrap().request(&mut request);
    let (mut bytes, mut out, mut waiting) = ([0; 256], Outbox::new(), VecDeque::new());
    let mut hear = |bytes: &[u8], waiting: &mut VecDeque<u8>| {
        let speed_rpm = sent.load(Relaxed) as f32;
        let state = DriveState { telemetry: Telemetry { speed_rpm, ..Telemetry::UNTOLD } };
        drive.hear(bytes, monotonic_ns(), &state, &mut out);
        sent.fetch_add(u64::from(!out.is_empty()), Relaxed);
        waiting.extend(out.bytes());
        out.clear();
    };
    let begin_ns = monotonic_ns();
    while !end.load(Relaxed) {
        poll(&mut [PollFd::new(pty, PollFlags::IN)], Some(&Timespec { tv_sec: 0, tv_nsec: 500_000 })).unwrap();
        let read = pty.try_read(&mut bytes).unwrap_or(0);
        // One at a time, so that one answer has one number.
        bytes[..read].iter().for_each(|byte| hear(&[*byte], &mut waiting));
        let due = (monotonic_ns() - begin_ns) / PERIOD_NS;
        while sent.load(Relaxed) < due.min(count) {
            hear(request.bytes(), &mut waiting);
        }
        // What finds no room now does later: here nothing but the link and its reader may lose any.
        let wrote = pty.try_write(waiting.make_contiguous()).unwrap_or(0);
        waiting.drain(..wrote);
    }
}

#[test]
fn no_report_is_lost_between_the_port_and_the_recorder() {
    let seconds: u64 = std::env::var("REC_BENCH_SECONDS").map_or(3, |text| text.parse().expect("seconds"));
    let count = seconds * 1000;
    let (sent, end) = (AtomicU64::new(0), AtomicBool::new(false));
    let pty = Pty::open(None).unwrap();
    let settings = settings("vesc", pty.path());
    thread::scope(|scope| {
        scope.spawn(|| report(&pty, count, &sent, &end));
        // The amplifier's thread ends with the test, whatever its outcome.
        let ends = EndsOnDrop(&end);
        let mut journal = JournalReader::default();
        let mut link = SerialLink::open(&settings, || {}, journal.journal("serial")).unwrap();
        let mut reader = link.take_telemetry().unwrap();
        assert!(link.take_telemetry().is_none(), "one reader");

        let begin_ns = monotonic_ns();
        let mut reports = vec![];
        for tick in 1..=count {
            sleep_until_ns(begin_ns + tick * PERIOD_NS);
            link.command(0.0);
            link.poll();
            if tick % 20 == 0 {
                reports.extend(std::iter::from_fn(|| reader.take()));
            }
        }
        until("every report that was sent", || {
            reports.extend(std::iter::from_fn(|| reader.take()));
            let newest = reports.last().map_or(0, |report| report.telemetry.speed_rpm as u64);
            sent.load(Relaxed) >= count && newest + 1 == sent.load(Relaxed)
        });
        drop(ends);

        let numbers: Vec<u64> = reports.iter().map(|report| report.telemetry.speed_rpm as u64).collect();
        let first = numbers[0];
        println!("{} reports in {seconds} s, all that were sent since the link was opened", numbers.len());
        assert!(numbers.iter().copied().eq(first..first + numbers.len() as u64), "each once and in order");
        assert!(numbers.len() as u64 > count / 2, "{first} were sent before the link was open");
        assert_eq!(reader.untaken(), 0);
        assert!(reports.is_sorted_by_key(|report| report.received_ns));
        assert!(reports.iter().all(|report| report.received_ns <= monotonic_ns()), "times of this clock");
    });
}

struct EndsOnDrop<'a>(&'a AtomicBool);

impl Drop for EndsOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}
