//! What the tests of a bus share: a bus of each kind that there is, the node at its other end, and waiting for what comes.

use drivers::can::{BusState, CanLink, End, Frame, FrameId, Heard, Interface, Port, TimedFrame, Wanted};
use drivers::journal::JournalReader;
use std::time::{Duration, Instant};

pub const COMMAND: FrameId = FrameId::Standard(0x100);
pub const SENSOR: FrameId = FrameId::Standard(0x181);
pub const FAR_SENSOR: FrameId = FrameId::Extended(0x18FF_0181);
/// For what ends by itself; no test measures time.
const PATIENCE: Duration = Duration::from_secs(20);

/// A bus with nobody on it.
pub struct Bus {
    pub interface: Interface,
    _folder: Option<tempfile::TempDir>,
}

impl Bus {
    pub fn unix() -> Bus {
        let folder = tempfile::tempdir().unwrap();
        Bus { interface: Interface::Unix(folder.path().join("bus")), _folder: Some(folder) }
    }

    pub fn socket_can(name: impl Into<String>) -> Bus {
        Bus { interface: Interface::SocketCan(name.into()), _folder: None }
    }
}

/// Each test over each kind of bus that there is.
pub fn on_each(test: impl Fn(&Bus)) {
    for interface in [None, crate::vcan::vcan()] {
        let bus = interface.map_or_else(Bus::unix, Bus::socket_can);
        eprintln!("over {}", bus.interface);
        test(&bus);
    }
}

/// The other end, in the test's own thread.
pub struct Node {
    pub port: Port,
    pub runtime: tokio::runtime::Runtime,
}

impl Node {
    pub fn on(bus: &Bus, wanted: Wanted<'_>) -> Node {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let port = runtime.block_on(async { Port::open(&bus.interface, wanted, End::Binds) }).unwrap();
        Node { port, runtime }
    }

    pub fn send(&self, frame: &Frame) {
        self.runtime.block_on(self.port.send(frame)).unwrap();
    }

    pub fn receive(&self) -> TimedFrame {
        let heard = self.runtime.block_on(async { tokio::time::timeout(PATIENCE, self.port.receive()).await });
        match heard.expect("a frame comes").unwrap() {
            Heard::Frame(frame) => frame,
            Heard::Error(error) => panic!("an error frame: {error}"),
        }
    }

    /// Lets a link in that has just been opened.
    pub fn meet(&self, link: &mut CanLink) {
        let hello = frame(COMMAND, &[0xFF; 8]);
        link.send(&[hello]);
        assert_eq!(self.receive().frame, hello);
    }
}

pub fn link(bus: &Bus, journal: &mut JournalReader) -> CanLink {
    CanLink::open(&bus.interface, &[FAR_SENSOR, SENSOR, SENSOR], || {}, journal.journal("can")).unwrap()
}

pub fn frame(id: FrameId, data: &[u8]) -> Frame {
    Frame::new(id, data).unwrap()
}

pub fn until<T>(what: &str, mut done: impl FnMut() -> Option<T>) -> T {
    let since = Instant::now();
    loop {
        if let Some(done) = done() {
            return done;
        }
        assert!(since.elapsed() < PATIENCE, "{what}: not within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

pub fn until_state(link: &CanLink, what: &str, is: impl Fn(&BusState) -> bool) -> BusState {
    until(what, || Some(link.state()).filter(&is))
}

pub fn next(link: &mut CanLink) -> TimedFrame {
    let mut heard = vec![];
    until("a frame", || {
        link.receive(&mut |frame| heard.push(*frame));
        heard.first().copied()
    })
}

pub fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

pub fn texts(journal: &mut JournalReader) -> Vec<String> {
    journal.read().iter().map(|entry| format!("{:?} {}", entry.severity, entry.text)).collect()
}

/// The next frame; times are in order, after it was sent, and not in the future.
pub fn next_of(link: &mut CanLink, last_ns: &mut u64, sent_ns: u64) -> Frame {
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

pub fn ip(arguments: &[&str]) {
    let said = std::process::Command::new("ip").args(arguments).output().unwrap();
    assert!(said.status.success(), "ip {arguments:?}: {}", String::from_utf8_lossy(&said.stderr));
}
