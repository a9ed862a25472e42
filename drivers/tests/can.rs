//! A bus over its thread: each test over a Unix socket, and over `vcan0` where there is one (`drivers/tests/can-tests`).
#![allow(clippy::unwrap_used, reason = "a test")]

mod counting;
mod vcan;

use drivers::can::{
    BusState, CanError, CanLink, Condition, End, Frame, FrameId, Heard, Interface, Port, TimedFrame, Wanted,
};
use drivers::journal::{JournalReader, Severity};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::{Duration, Instant};

const COMMAND: FrameId = FrameId::Standard(0x100);
const SENSOR: FrameId = FrameId::Standard(0x181);
const FAR_SENSOR: FrameId = FrameId::Extended(0x18FF_0181);
/// For what ends by itself; no test measures time.
const PATIENCE: Duration = Duration::from_secs(20);

/// A bus with nobody on it.
struct Bus {
    interface: Interface,
    _folder: tempfile::TempDir,
}

/// Each test over each kind of bus that there is.
fn on_each(test: impl Fn(&Bus)) {
    for interface in [None, vcan::vcan()] {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("bus");
        let interface = interface.map_or(Interface::Unix(socket), Interface::SocketCan);
        eprintln!("over {interface}");
        test(&Bus { interface, _folder: folder });
    }
}

/// The other end, in the test's own thread.
struct Node {
    port: Port,
    runtime: tokio::runtime::Runtime,
}

impl Node {
    fn on(bus: &Bus, wanted: Wanted<'_>) -> Node {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let port = runtime.block_on(async { Port::open(&bus.interface, wanted, End::Binds) }).unwrap();
        Node { port, runtime }
    }

    fn send(&self, frame: &Frame) {
        self.runtime.block_on(self.port.send(frame)).unwrap();
    }

    fn receive(&self) -> TimedFrame {
        let heard = self.runtime.block_on(async { tokio::time::timeout(PATIENCE, self.port.receive()).await });
        match heard.expect("a frame comes").unwrap() {
            Heard::Frame(frame) => frame,
            Heard::Error(error) => panic!("an error frame: {error}"),
        }
    }

    /// Lets a link in that has just been opened.
    fn meet(&self, link: &mut CanLink) {
        let hello = frame(COMMAND, &[0xFF; 8]);
        link.send(&[hello]);
        assert_eq!(self.receive().frame, hello);
    }
}

fn link(bus: &Bus, journal: &mut JournalReader) -> CanLink {
    CanLink::open(&bus.interface, &[FAR_SENSOR, SENSOR, SENSOR], || {}, journal.journal("can")).unwrap()
}

fn frame(id: FrameId, data: &[u8]) -> Frame {
    Frame::new(id, data).unwrap()
}

fn until<T>(what: &str, mut done: impl FnMut() -> Option<T>) -> T {
    let since = Instant::now();
    loop {
        if let Some(done) = done() {
            return done;
        }
        assert!(since.elapsed() < PATIENCE, "{what}: not within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn until_state(link: &CanLink, what: &str, is: impl Fn(&BusState) -> bool) -> BusState {
    until(what, || Some(link.state()).filter(&is))
}

fn next(link: &mut CanLink) -> TimedFrame {
    let mut heard = vec![];
    until("a frame", || {
        link.receive(&mut |frame| heard.push(*frame));
        heard.first().copied()
    })
}

fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn texts(journal: &mut JournalReader) -> Vec<String> {
    journal.read().iter().map(|entry| format!("{:?} {}", entry.severity, entry.text)).collect()
}

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

/// The next frame; times are in order, after it was sent, and not in the future.
fn next_of(link: &mut CanLink, last_ns: &mut u64, sent_ns: u64) -> Frame {
    // One at a time: those that come together would be passed over by `next`.
    thread_local!(static WAITING: std::cell::RefCell<std::collections::VecDeque<TimedFrame>> = const { std::cell::RefCell::new(std::collections::VecDeque::new()) });
    let heard = WAITING.with_borrow_mut(|waiting| {
        until("a frame", || {
            link.receive(&mut |frame| waiting.push_back(*frame));
            waiting.pop_front()
        })
    });
    let now_ns = monotonic_ns();
    assert!(heard.received_ns <= now_ns, "{} is after {now_ns}", heard.received_ns);
    // The kernel's clock of times is read at another moment than ours.
    assert!(heard.received_ns + 1_000_000 >= sent_ns.max(*last_ns), "{} is before {sent_ns}", heard.received_ns);
    *last_ns = heard.received_ns;
    heard.frame
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
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus { interface: Interface::Unix(folder.path().join("bus")), _folder: folder };
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

#[test]
fn error_frames_tell_the_condition_and_nothing_is_sent_off_the_bus() {
    on_each(|bus| {
        let errors = ErrorSource::on(bus);
        let mut journal = JournalReader::default();
        let mut link = link(bus, &mut journal);
        errors.meet();
        let is = |condition| move |state: &BusState| state.condition == condition;
        errors.send(libc::CAN_ERR_CRTL | libc::CAN_ERR_CNT, [0, 0x08, 0, 0, 0, 0, 96, 3]);
        let state = until_state(&link, "warning", is(Condition::Warning));
        assert_eq!(state.error_counters, Some((96, 3)));
        // By its counters alone, with a bus error.
        errors.send(libc::CAN_ERR_ACK | libc::CAN_ERR_BUSERROR | libc::CAN_ERR_CNT, [0, 0, 0, 0, 0, 0, 128, 3]);
        until_state(&link, "passive", is(Condition::Passive));
        errors.send(libc::CAN_ERR_BUSOFF, [0; 8]);
        let state = until_state(&link, "off", is(Condition::BusOff));
        assert_eq!((state.errors, state.error_counters), (3, Some((128, 3))));
        // What the counters say does not end it.
        errors.send(libc::CAN_ERR_BUSERROR | libc::CAN_ERR_CNT, [0, 0, 0, 0, 0, 0, 0, 0]);
        until_state(&link, "the next error", |state| state.errors == 4);
        assert_eq!(link.state().condition, Condition::BusOff);
        let sent = link.state().sent;
        for n in 1..=50 {
            link.send(&[frame(COMMAND, &[n])]);
            until_state(&link, "not sent", |state| state.unsent == u64::from(n));
        }
        assert_eq!(link.state().sent, sent);
        errors.send(libc::CAN_ERR_RESTARTED, [0; 8]);
        until_state(&link, "restarted", is(Condition::Active));
        link.send(&[frame(COMMAND, &[99])]);
        until_state(&link, "sent", |state| state.sent == sent + 1);
        // Nothing of what was commanded while it was off.
        assert_eq!(errors.receive_data(), 99);
        drop(link);
        let texts = texts(&mut journal);
        let starts = |n: usize, begin: &str, has: &str| {
            assert!(texts[n].starts_with(begin) && texts[n].contains(has), "{n}: {texts:#?}");
        };
        starts(0, "Warning", ": error-warning: controller problem: tx warning; error counters: tx=96, rx=3");
        starts(1, "Warning", ": error-passive: no ack");
        starts(2, "Error", ": bus-off: bus off");
        starts(3, "Info", ": error-active: restarted");
        if matches!(bus.interface, Interface::SocketCan(_)) {
            starts(2, "Error", "`ip link set vcan0 type can restart` (by itself: `restart-ms 100`)");
        }
        assert!(texts[4..].iter().all(|text| text.contains("error frames, first: ")), "{texts:#?}");
    });
}

/// Says what a controller would.
enum ErrorSource {
    SocketCan(socketcan::CanSocket),
    Unix { listener: std::os::fd::OwnedFd, peer: std::cell::OnceCell<std::os::fd::OwnedFd> },
}

impl ErrorSource {
    fn on(bus: &Bus) -> ErrorSource {
        use rustix::net::{AddressFamily, SocketAddrUnix, SocketType, bind, listen, socket};
        use socketcan::Socket;
        match &bus.interface {
            Interface::SocketCan(name) => ErrorSource::SocketCan(socketcan::CanSocket::open(name).unwrap()),
            Interface::Unix(path) => {
                let listener = socket(AddressFamily::UNIX, SocketType::SEQPACKET, None).unwrap();
                bind(&listener, &SocketAddrUnix::new(path).unwrap()).unwrap();
                listen(&listener, 1).unwrap();
                ErrorSource::Unix { listener, peer: std::cell::OnceCell::new() }
            }
        }
    }

    fn meet(&self) {
        if let ErrorSource::Unix { listener, peer } = self {
            peer.set(rustix::net::accept(listener).unwrap()).unwrap();
        }
    }

    fn send(&self, classes: u32, data: [u8; 8]) {
        use socketcan::Socket;
        let error = socketcan::CanErrorFrame::new_error(classes, &data).unwrap();
        match self {
            ErrorSource::SocketCan(socket) => socket.write_frame(&socketcan::CanFrame::Error(error)).unwrap(),
            ErrorSource::Unix { peer, .. } => {
                let mut bytes = [0; 16];
                bytes[..4].copy_from_slice(&(classes | libc::CAN_ERR_FLAG).to_ne_bytes());
                bytes[4] = 8;
                bytes[8..].copy_from_slice(&data);
                rustix::io::write(peer.get().unwrap(), &bytes).unwrap();
            }
        }
    }

    /// The first byte of the next frame.
    fn receive_data(&self) -> u8 {
        use socketcan::{EmbeddedFrame, Socket};
        match self {
            ErrorSource::SocketCan(socket) => socket.read_frame().unwrap().data()[0],
            ErrorSource::Unix { peer, .. } => {
                let mut bytes = [0; 16];
                assert_eq!(rustix::io::read(peer.get().unwrap(), &mut bytes[..]).unwrap(), 16);
                bytes[8]
            }
        }
    }
}

#[test]
fn a_bus_that_is_lost_is_found_again() {
    on_each(|bus| {
        let mut journal = JournalReader::default();
        let mut node = Node::on(bus, Wanted::All);
        let mut link = link(bus, &mut journal);
        node.meet(&mut link);
        for round in 0..2 {
            match &bus.interface {
                Interface::Unix(_) => drop(node),
                Interface::SocketCan(name) => ip(&["link", "set", name, "down"]),
            }
            // Commands go on at the loop's rate, and are not kept.
            let mut n = 0;
            until_state(&link, "down", |state| state.condition == Condition::Down);
            until("commands that are dropped", || {
                n += 1;
                link.send(&[frame(COMMAND, &[round, n as u8])]);
                (link.state().unsent > 300 * u64::from(round + 1)).then_some(())
            });
            node = match &bus.interface {
                Interface::Unix(_) => Node::on(bus, Wanted::All),
                Interface::SocketCan(name) => {
                    ip(&["link", "set", name, "up"]);
                    Node::on(bus, Wanted::All)
                }
            };
            until("active again", || {
                link.send(&[frame(COMMAND, &[round, 1])]);
                (link.state().condition == Condition::Active).then_some(())
            });
            link.send(&[frame(COMMAND, &[round, 200])]);
            while node.receive().frame.data() != [round, 200] {}
            node.send(&frame(SENSOR, &[round]));
            assert_eq!(next(&mut link).frame.data(), [round]);
        }
        drop(link);
        let entries = journal.read();
        let told = |severity, what: &str| {
            entries.iter().filter(|entry| entry.severity == severity && entry.text.contains(what)).count()
        };
        assert_eq!((told(Severity::Error, ": down: "), told(Severity::Info, "there again")), (2, 2), "{entries:#?}");
        assert!(entries.len() <= 8, "{entries:#?}");
    });
}

fn ip(arguments: &[&str]) {
    let said = std::process::Command::new("ip").args(arguments).output().unwrap();
    assert!(said.status.success(), "ip {arguments:?}: {}", String::from_utf8_lossy(&said.stderr));
}

#[test]
fn what_keeps_a_bus_from_being_opened_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str| {
        let interface: Interface = name.parse().unwrap();
        match CanLink::open(&interface, &[SENSOR], || {}, JournalReader::default().journal("can")) {
            Err(error) => error,
            Ok(_) => panic!("{name} was opened"),
        }
    };
    let path = |file: &str| format!("unix:{}", folder.path().join(file).display());
    let absent = refused(&path("absent"));
    assert!(matches!(absent, CanError::NobodyThere { .. }) && absent.to_string().contains("bench emulate"), "{absent}");
    // What a process left that has ended.
    let left = std::os::unix::net::UnixListener::bind(folder.path().join("left")).unwrap();
    let other = refused(&path("left"));
    assert!(other.to_string().contains("a socket of another kind"), "{other}");
    drop(left);
    assert!(matches!(refused(&path("left")), CanError::NobodyThere { .. }));
    let long = refused(&path(&"x".repeat(120)));
    assert!(matches!(long, CanError::System { .. }) && long.to_string().contains("too long"), "{long}");
    // The other way round: a path that is taken, and one that only looks so.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let bind = |file: &str| Port::open(&path(file).parse().unwrap(), Wanted::All, End::Binds);
        let first = bind("bus").unwrap();
        let second = bind("bus").err().expect("taken").to_string();
        assert!(second.contains("another process listens there"), "{second}");
        drop(first);
        assert!(!folder.path().join("bus").exists(), "its file goes with it");
        std::fs::write(folder.path().join("file"), "precious").unwrap();
        let file = bind("file").err().expect("taken").to_string();
        assert!(file.contains("a file that is no socket"), "{file}");
        assert_eq!(std::fs::read(folder.path().join("file")).unwrap(), b"precious");
        drop(bind("left").expect("nobody is there any more"));
    });
    if vcan::vcan().is_none() {
        let none = refused("can7");
        assert!(matches!(none, CanError::NoCan { .. } | CanError::NoSuchInterface { .. }), "{none}");
        return;
    }
    let none = refused("can7").to_string();
    assert!(none.contains("no network interface can7") && none.contains("vcan0"), "{none}");
    let kind = refused("lo").to_string();
    assert!(kind.contains("lo is no CAN interface (link type 772") && kind.contains("vcan0"), "{kind}");
    ip(&["link", "set", "vcan1", "down"]);
    let down = refused("vcan1");
    assert!(matches!(&down, CanError::Down { .. }) && down.to_string().contains("`ip link set vcan1 up`"), "{down}");
    ip(&["link", "set", "vcan1", "up"]);
    let many: Vec<FrameId> = (0..600).map(FrameId::Standard).collect();
    let interface = Interface::SocketCan("vcan1".into());
    let many = CanLink::open(&interface, &many, || {}, JournalReader::default().journal("can")).err();
    assert!(matches!(many, Some(CanError::TooManyWanted { count: 600, most: 512, .. })));
}

#[test]
fn a_second_peer_is_turned_away_and_the_next_one_is_let_in() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus { interface: Interface::Unix(folder.path().join("bus")), _folder: folder };
    let node = Node::on(&bus, Wanted::All);
    let mut journal = JournalReader::default();
    let mut first = link(&bus, &mut journal);
    node.meet(&mut first);
    let mut second = link(&bus, &mut journal);
    until("turned away", || {
        first.send(&[frame(COMMAND, &[1])]);
        node.receive();
        (second.state().condition == Condition::Down).then_some(())
    });
    drop(first);
    until("let in", || {
        second.send(&[frame(COMMAND, &[2])]);
        let heard =
            node.runtime.block_on(async { tokio::time::timeout(Duration::from_millis(5), node.port.receive()).await });
        heard.is_ok_and(|heard| matches!(heard, Ok(Heard::Frame(heard)) if heard.frame.data() == [2])).then_some(())
    });
}

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
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus { interface: Interface::SocketCan("can0".into()), _folder: folder };
    let mut journal = JournalReader::default();
    let mut link = link(&bus, &mut journal);
    assert_eq!(link.state().error_counters, Some((0, 0)));
    let far = Bus { interface: Interface::SocketCan("can1".into()), _folder: tempfile::tempdir().unwrap() };
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
    let bus = Bus { interface: Interface::SocketCan("vcan0".into()), _folder: tempfile::tempdir().unwrap() };
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
