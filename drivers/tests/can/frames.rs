//! Frames: whole, in order, only those that are wanted, and without a step of the loop that allocates.

use crate::bus::{COMMAND, FAR_SENSOR, Node, SENSOR, frame, link, monotonic_ns, next, next_of, on_each, texts, until};
use crate::counting;
use drivers::can::{Condition, FrameId, Interface, Wanted};
use drivers::journal::JournalReader;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn frames_come_whole_in_order_and_with_the_time_of_their_reception() {
    on_each(|bus| {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut any = |id: FrameId| {
            let length = rng.random_range(0..=8);
            frame(id, &(0..length).map(|_| rng.random()).collect::<Vec<u8>>())
        };
        let node = Node::on(bus, Wanted::All);
        let mut journal = JournalReader::default();
        let mut link = link(bus, &mut journal);
        node.meet(&mut link);
        let mut last_ns = 0;
        for _ in 0..300 {
            let set = [any(COMMAND), any(FrameId::Extended(0x100)), any(FrameId::Standard(0x7FF))];
            link.send(&set);
            assert_eq!([(); 3].map(|()| node.receive().frame), set);
            let before_ns = monotonic_ns();
            let answers = [any(SENSOR), any(FAR_SENSOR)];
            answers.iter().for_each(|answer| node.send(answer));
            for answer in answers {
                let heard = next_of(&mut link, &mut last_ns, before_ns);
                assert_eq!(heard, answer);
            }
        }
        let state = link.state();
        assert_eq!((state.sent, state.unsent, state.received, state.lost), (901, 0, 600, 0));
        assert_eq!((state.condition, state.errors), (Condition::Active, 0));
        drop(link);
        assert_eq!(texts(&mut journal), [""; 0]);
    });
}

#[test]
fn what_the_loop_calls_allocates_nothing() {
    on_each(|bus| {
        let node = Node::on(bus, Wanted::All);
        let mut link = link(bus, &mut JournalReader::default());
        node.meet(&mut link);
        let set = [frame(COMMAND, &[1; 8]), frame(COMMAND, &[2; 8])];
        let mut heard = 0;
        for _ in 0..200 {
            node.send(&frame(SENSOR, &[7; 8]));
            let before = counting::allocations();
            link.send(&set);
            link.receive(&mut |frame| heard += usize::from(frame.frame.data()[0] == 7));
            let state = link.state();
            assert_eq!(counting::allocations(), before);
            assert_eq!(state.condition, Condition::Active);
            node.receive();
            node.receive();
        }
        until("all frames", || {
            link.receive(&mut |_| heard += 1);
            (heard == 200).then_some(())
        });
    });
}

#[test]
fn only_frames_with_exactly_the_wanted_identifiers_come() {
    on_each(|bus| {
        let node = Node::on(bus, Wanted::All);
        let mut link = link(bus, &mut JournalReader::default());
        node.meet(&mut link);
        // The same bits in the other name space, and the neighbours.
        let unwanted = [
            FrameId::Extended(0x181),
            FrameId::Standard(0x182),
            FrameId::Standard(0x101),
            FrameId::Extended(0x18FF_0182),
        ];
        let before = wake_ups(&bus.interface);
        for n in 0..500 {
            unwanted.iter().for_each(|id| node.send(&frame(*id, &[n as u8])));
        }
        let woken = wake_ups(&bus.interface).zip(before).map(|(after, before)| after - before);
        node.send(&frame(SENSOR, &[42]));
        node.send(&frame(FAR_SENSOR, &[43]));
        let mut heard = vec![];
        until("both", || {
            link.receive(&mut |frame| heard.push((frame.frame.id, frame.frame.data()[0])));
            (heard.len() >= 2).then_some(())
        });
        assert_eq!(heard, [(SENSOR, 42), (FAR_SENSOR, 43)]);
        assert_eq!(link.state().received, 2);
        if let Some(woken) = woken {
            // The thread's own timer, once a second.
            eprintln!("2000 unwanted frames woke the thread {woken} times");
            assert!(woken < 20, "2000 unwanted frames woke the thread {woken} times");
        }
    });
}

/// How often the thread of a bus has waited so far; over a Unix socket every frame wakes it.
fn wake_ups(interface: &Interface) -> Option<u64> {
    if matches!(interface, Interface::Unix(_)) {
        return None;
    }
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().flatten();
    let of = |file: std::path::PathBuf| std::fs::read_to_string(file).unwrap_or_default();
    let can = tasks.map(|task| task.path()).find(|task| of(task.join("comm")).trim() == "can").expect("the thread");
    let status = of(can.join("status"));
    status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:")?.trim().parse().ok())
}

#[test]
fn own_frames_do_not_come_back() {
    on_each(|bus| {
        let node = Node::on(bus, Wanted::All);
        let mut link = link(bus, &mut JournalReader::default());
        node.meet(&mut link);
        link.send(&[frame(SENSOR, &[1]), frame(FAR_SENSOR, &[2])]);
        assert_eq!([node.receive().frame.id, node.receive().frame.id], [SENSOR, FAR_SENSOR]);
        node.send(&frame(SENSOR, &[3]));
        assert_eq!(next(&mut link).frame.data(), [3]);
    });
}
