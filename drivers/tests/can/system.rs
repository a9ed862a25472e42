//! Against others on the system: `candump`, the drivers of controllers, a wall clock that is set.

use crate::bus::{
    Bus, COMMAND, FAR_SENSOR, Node, SENSOR, frame, ip, link, monotonic_ns, next_of, texts, until, until_state,
};
use crate::vcan;
use drivers::can::{CanLink, Condition, Frame, FrameId, Interface, Wanted};
use drivers::journal::JournalReader;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// An independent reader: `candump` of can-utils.
#[test]
fn candump_reads_what_was_sent() {
    use std::process::{Command, Stdio};
    let Some(name) = vcan::vcan() else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let sent: Vec<Frame> = (0..200)
        .map(|n| {
            let id = if n % 2 == 0 {
                FrameId::Standard(rng.random_range(0..0x800))
            } else {
                FrameId::Extended(rng.random_range(0..0x2000_0000))
            };
            let length = n % 9;
            frame(id, &(0..length).map(|_| rng.random()).collect::<Vec<u8>>())
        })
        .collect();
    let candump =
        Command::new("candump").args(["-L", "-n", "200", "-T", "20000", &name]).stdout(Stdio::piped()).spawn();
    let candump = candump.expect("candump of the package can-utils is installed");
    // An interface without a receiver has a line, too: `(vcan0: no entry)`.
    let listens = || {
        let list = std::fs::read_to_string("/proc/net/can/rcvlist_all").unwrap();
        list.lines().any(|line| line.trim_start().starts_with(&format!("{name} ")))
    };
    until("candump to listen", || listens().then_some(()));
    let mut link =
        CanLink::open(&Interface::SocketCan(name.clone()), &[], || {}, JournalReader::default().journal("can"))
            .unwrap();
    for (n, set) in sent.chunks(4).enumerate() {
        link.send(set);
        until_state(&link, "sent", |state| state.sent == 4 * (n as u64 + 1));
    }
    let said = candump.wait_with_output().unwrap();
    let said = String::from_utf8(said.stdout).unwrap();
    let lines: Vec<&str> = said.lines().map(|line| line.rsplit(' ').next().unwrap()).collect();
    let expected: Vec<String> = sent
        .iter()
        .map(|frame| {
            format!("{}#{}", frame.id, frame.data().iter().map(|byte| format!("{byte:02X}")).collect::<String>())
        })
        .collect();
    assert_eq!(lines, expected);
}

/// Two controllers on one bus, where the emulated machine has them; it acknowledges every frame, so none goes passive or off.
#[test]
fn controllers_tell_their_counters_and_are_found_again_after_they_were_down() {
    if vcan::vcan().is_none() || !std::path::Path::new("/sys/class/net/can1").exists() {
        use std::io::Write;
        let _ =
            writeln!(std::io::stderr(), "controllers: SKIPPED: no can0 and can1; `drivers/tests/can-tests` has them");
        return;
    }
    let bus = Bus::socket_can("can0");
    let mut journal = JournalReader::default();
    let mut link = link(&bus, &mut journal);
    assert_eq!(link.state().error_counters, Some((0, 0)));
    let far = Bus::socket_can("can1");
    let mut node = Node::on(&far, Wanted::All);
    let mut last_ns = 0;
    for n in 0..200u8 {
        let set = [frame(COMMAND, &[n; 8]), frame(FrameId::Extended(0x1234_5678), &[])];
        link.send(&set);
        assert_eq!([node.receive().frame, node.receive().frame], set);
        let sent_ns = monotonic_ns();
        node.send(&frame(FAR_SENSOR, &[n]));
        assert_eq!(next_of(&mut link, &mut last_ns, sent_ns).data(), [n]);
    }
    ip(&["link", "set", "can0", "down"]);
    until_state(&link, "down", |state| state.condition == Condition::Down);
    ip(&["link", "set", "can0", "up", "type", "can", "bitrate", "500000", "restart-ms", "100"]);
    until_state(&link, "up", |state| state.condition == Condition::Active);
    node.meet(&mut link);
    drop(link);
    // The other one is down: nothing comes, nothing is wrong.
    ip(&["link", "set", "can1", "down"]);
    assert!(node.runtime.block_on(node.port.receive()).is_err_and(|e| e.raw_os_error() == Some(libc::ENETDOWN)));
    ip(&["link", "set", "can1", "up"]);
    node = Node::on(&far, Wanted::All);
    drop(node);
    let texts = texts(&mut journal);
    assert_eq!(texts.iter().filter(|text| text.contains("can0: restart-ms is 0")).count(), 1, "{texts:#?}");
    assert!(texts.iter().any(|text| text.starts_with("Error can0: down: Network is down")), "{texts:#?}");
    assert!(texts.last().unwrap().starts_with("Info can0: error-active: there again"), "{texts:#?}");
}

/// Only where the clock is nobody's.
#[test]
fn a_wall_clock_that_is_set_makes_no_frame_older_or_newer() {
    if vcan::vcan().is_none() || std::env::var_os("CAN_GUEST_OUT").is_none() {
        use std::io::Write;
        let _ = writeln!(
            std::io::stderr(),
            "wall clock: SKIPPED: set in the emulated machine alone (`drivers/tests/can-tests`)"
        );
        return;
    }
    use rustix::time::{ClockId, clock_gettime, clock_settime};
    let bus = Bus::socket_can("vcan0");
    let node = Node::on(&bus, Wanted::All);
    let mut link = link(&bus, &mut JournalReader::default());
    node.meet(&mut link);
    let mut last_ns = 0;
    for n in 0..300u64 {
        let sent_ns = monotonic_ns();
        node.send(&frame(SENSOR, &n.to_be_bytes()));
        if n % 3 != 0 {
            let mut wall = clock_gettime(ClockId::Realtime);
            wall.tv_sec += if n % 2 == 0 { 3600 } else { -3600 };
            clock_settime(ClockId::Realtime, wall).unwrap();
        }
        assert_eq!(next_of(&mut link, &mut last_ns, sent_ns).data(), n.to_be_bytes());
    }
}
