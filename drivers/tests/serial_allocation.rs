//! The loop's side of the serial link allocates nothing and never waits: it runs inside the 1 kHz loop.

#![allow(clippy::unwrap_used, reason = "a test")]

mod counting;
mod serial_pty;

use counting::allocations;
use drivers::amplifier::PROTOCOLS;
use drivers::journal::JournalReader;
use drivers::serial::SerialLink;
use serial_pty::{Amplifier, Mood, settings, until};
use std::time::Duration;

#[test]
fn no_exchange_allocates_whatever_the_amplifier_does() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut journal = JournalReader::default();
        let settings = settings(kind.name, &amplifier.port);
        let mut link = SerialLink::open(&settings, || {}, journal.journal("serial")).unwrap();
        for (mood, connected) in [(Mood::Answers, true), (Mood::Mute, false), (Mood::Answers, true)] {
            amplifier.state().mood = mood;
            let (mut heard, mut told) = (0, 0);
            until("the exchanges", || {
                let before = allocations();
                link.arm();
                link.command(3.0);
                let report = link.poll();
                assert_eq!(allocations() - before, 0, "{}, {mood:?}", kind.name);
                told += usize::from(report.heard_ns != heard);
                heard = report.heard_ns;
                report.connected == connected && (told > 100 || !connected)
            });
        }
        assert!(amplifier.commands().iter().any(|&voltage_v| voltage_v > 2.9), "commands were obeyed");
        // The counter counts.
        let before = allocations();
        std::hint::black_box(vec![1u8; 100]);
        assert_eq!(allocations() - before, 2);
        std::thread::sleep(Duration::from_millis(1));
    }
}
