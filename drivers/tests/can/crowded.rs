//! More than fits: what is dropped on the way in and out, and what goes out last.

use crate::bus::{Bus, COMMAND, FAR_SENSOR, Node, SENSOR, frame, link, next, on_each, texts, until, until_state};
use drivers::can::{BusState, Interface, Wanted};
use drivers::journal::JournalReader;
use std::time::Duration;

#[test]
fn a_flood_is_lost_beyond_what_the_loop_takes_and_commands_go_through_it() {
    on_each(|bus| {
        let node = Node::on(bus, Wanted::Only(&[COMMAND]));
        let mut journal = JournalReader::default();
        let mut link = link(bus, &mut journal);
        node.meet(&mut link);
        for n in 0..5_000u16 {
            node.send(&frame(SENSOR, &n.to_be_bytes()));
            if n % 1000 == 500 {
                link.send(&[frame(COMMAND, &n.to_be_bytes())]);
                assert_eq!(node.receive().frame.data(), n.to_be_bytes());
            }
        }
        // Over SocketCAN the kernel drops what a thread that is held up does not take.
        let least = if matches!(bus.interface, Interface::Unix(_)) { 5_000 } else { 1_025 };
        let state = until_state(&link, "the flood", |state| state.received >= least);
        let mut heard = vec![];
        link.receive(&mut |frame| heard.push(u16::from_be_bytes([frame.frame.data()[0], frame.frame.data()[1]])));
        assert_eq!(heard.len(), 1024);
        assert!(heard.is_sorted() && heard[0] == 0);
        assert!(state.lost >= least - 1024 && state.lost <= state.received - 1024, "{state:?}");
        // And then the bus is as before.
        until("silence", || {
            let received = link.state().received;
            std::thread::sleep(Duration::from_millis(20));
            (link.state().received == received).then_some(())
        });
        link.receive(&mut |_| {});
        node.send(&frame(FAR_SENSOR, &[1]));
        assert_eq!(next(&mut link).frame.id, FAR_SENSOR);
        drop(link);
        let texts = texts(&mut journal);
        assert!(!texts.is_empty() && texts.len() < 10, "{texts:?}");
        assert!(texts.iter().all(|text| text.starts_with("Warning") && text.contains("frames lost")), "{texts:?}");
    });
}

#[test]
fn of_commands_that_can_not_be_sent_the_newest_goes_when_there_is_room() {
    // A Unix socket is full when its peer does not read; a virtual bus never is.
    let bus = Bus::unix();
    let node = Node::on(&bus, Wanted::All);
    let mut journal = JournalReader::default();
    let mut link = link(&bus, &mut journal);
    node.meet(&mut link);
    let sets = 2_000u64;
    for n in 1..=sets {
        link.send(&[frame(COMMAND, &n.to_be_bytes()), frame(SENSOR, &n.to_be_bytes())]);
        let known = |state: &BusState| state.sent + state.unsent > 2 * (n - 1);
        until_state(&link, "the thread to take the set", known);
    }
    // Now there is room: what was in the socket, then the newest set, whole.
    let mut numbers = vec![];
    while numbers.last() != Some(&(SENSOR, sets)) {
        let heard = node.receive().frame;
        numbers.push((heard.id, u64::from_be_bytes(heard.data().try_into().unwrap())));
    }
    assert!(numbers.is_sorted_by_key(|(_, n)| *n));
    let state = until_state(&link, "all accounted for", |state| state.sent + state.unsent == 1 + 2 * sets);
    assert_eq!(state.sent as usize, 1 + numbers.len());
    assert!(numbers.len() < 200, "{} frames that had grown stale", numbers.len());
    assert_eq!(numbers[numbers.len() - 2..], [(COMMAND, sets), (SENSOR, sets)]);
    drop(link);
    let texts = texts(&mut journal);
    assert!(!texts.is_empty() && texts.iter().all(|text| text.contains("command frames not sent")), "{texts:?}");
}

#[test]
fn the_last_set_goes_out_when_the_link_is_dropped() {
    on_each(|bus| {
        let node = Node::on(bus, Wanted::All);
        for n in 0..30 {
            let mut link = link(bus, &mut JournalReader::default());
            node.meet(&mut link);
            // More at once than the thread's queue holds.
            for k in 0..20 {
                link.send(&[frame(COMMAND, &[n, k])]);
            }
            drop(link);
            while node.receive().frame.data() != [n, 19] {}
        }
    });
}
