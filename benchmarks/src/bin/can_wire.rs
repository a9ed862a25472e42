//! How old the newest sample is that the loop sees over CAN, beside a bare socket in the same run.
//!
//! ```text
//! cargo run --release -p benchmarks --bin can_wire                       # over a Unix socket, 20 s
//! cargo run --release -p benchmarks --bin can_wire -- vcan0 60           # interface, seconds
//! drivers/tests/can-guest run [-r] target/release/can_wire vcan0 20      # in the emulated machine
//! ```
//!
//! Slices of a second take turns at 1 kHz. *Bare*: the loop sends one frame and waits for the answer. *Link*: [`CanLink`] with two
//! frames out and three in; what the loop sees at a tick was answered to the tick before. Every answer carries the time at which the
//! node made it, so the age at the tick is measured in the same way in both. Ends with 3 where a sample was missing at its tick more
//! often than twice in a thousand ticks: some of it is the machine's.

use benchmarks::wire::{head, row, ticks};
use benchmarks::{Target, exit};
use drivers::can::{CanLink, Frame, FrameId, Interface};
use drivers::journal::JournalReader;
use rt_core::system::time::monotonic_ns;
use rt_core::system::{Request, prepare_thread};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, accept, bind, connect, listen, socket_with};
use socketcan::{CanFilter, CanSocket, Socket, SocketOptions};
use std::error::Error;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

const PERIOD_NS: u64 = 1_000_000;
/// Ticks of a slice.
const SLICE: u64 = 1_000;
/// The bare socket's frame and its answer.
const BARE: (u16, u16) = (0x200, 0x201);
/// The link's commands, of which the first is answered, and the answers.
const COMMANDS: [u16; 2] = [0x100, 0x101];
const ANSWERS: [u16; 3] = [0x181, 0x182, 0x183];
/// Ticks without the sample of the tick before, of all.
const MISSING: Target = Target::AtMost(2e-3);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = match tempfile::tempdir() {
        Ok(folder) => folder,
        Err(error) => return exit(Err(error.into())),
    };
    let default = format!("unix:{}", folder.path().join("bus").display());
    let (interface, seconds) = match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => (default.as_str(), "20"),
        [interface] => (*interface, "20"),
        [interface, seconds] => (*interface, *seconds),
        _ => ("", ""),
    };
    let (Ok(interface), Ok(seconds)) = (interface.parse(), seconds.parse()) else {
        eprintln!("expected an interface (can0, vcan0, unix:PATH) and seconds, or less, got {arguments:?}");
        return ExitCode::from(2);
    };
    exit(measure(&interface, seconds))
}

fn measure(interface: &Interface, seconds: u64) -> Result<bool, Box<dyn Error>> {
    let stop = Arc::new(AtomicBool::new(false));
    let nodes = [
        Node::start(interface, "bare", &[BARE.0], stop.clone())?,
        Node::start(interface, "link", &COMMANDS, stop.clone())?,
    ];
    let bare = Plain::open(interface, "bare", &[BARE.1])?;
    let wanted = ANSWERS.map(FrameId::Standard);
    let mut journal = JournalReader::default();
    let prepare = || drop(prepare_thread(&Request { priority: 70, ..Request::default() }));
    let mut link = CanLink::open(&of(interface, "link"), &wanted, prepare, journal.journal("can"))?;
    let refused = prepare_thread(&Request::default()).iter().filter(|grant| grant.is_refused()).count();

    let (mut by_bare, mut by_link) = (Figures::default(), Figures::default());
    for _ in 0..seconds.div_ceil(2) {
        let start_ns = monotonic_ns() + PERIOD_NS;
        by_bare.slice(start_ns, |figures, tick| figures.bare(&bare, tick))?;
        let start_ns = monotonic_ns() + PERIOD_NS;
        by_link.slice(start_ns, |figures, tick| figures.link(&mut link, tick))?;
    }
    let state = link.state();
    drop(link);
    drop(bare);
    stop.store(true, Relaxed);
    nodes.into_iter().try_for_each(Node::join)?;

    println!(
        "{interface}: {} ticks each, us{}",
        by_bare.ticks,
        if refused > 0 { " (without real-time priority)" } else { "" }
    );
    head();
    let age = row("bare: age of the sample at the tick", &mut by_bare.age_ns, None);
    row("link: age of the newest sample at the tick", &mut by_link.age_ns, Some(age));
    let way = row("bare: from the command to the node", &mut by_bare.way_out_ns, None);
    row("link: from the first command to the node", &mut by_link.way_out_ns, Some(way));
    let way = row("bare: from the node until it is read", &mut by_bare.way_in_ns, None);
    row("link: from the node until the last has come", &mut by_link.way_in_ns, Some(way));
    let entries: Vec<String> = journal.read().iter().map(|entry| entry.text.to_string()).collect();
    println!(
        "link: {} frames sent, {} not sent, {} received, {} lost {entries:?}",
        state.sent, state.unsent, state.received, state.lost
    );
    let missing = by_link.missing as f64 / by_link.ticks as f64;
    println!(
        "ticks without the sample of the tick before: {} of {}, {}",
        by_link.missing,
        by_link.ticks,
        MISSING.judge(missing)
    );
    Ok(MISSING.reached_by(missing))
}

/// Times of one kind of slice, ns.
#[derive(Default)]
struct Figures {
    ticks: u64,
    missing: u64,
    /// When the loop's newest sample was made; that of the tick before, if all is well.
    newest_ns: u64,
    sent_ns: u64,
    age_ns: Vec<u64>,
    way_out_ns: Vec<u64>,
    way_in_ns: Vec<u64>,
}

impl Figures {
    fn slice(
        &mut self,
        start_ns: u64,
        mut tick: impl FnMut(&mut Figures, u64) -> Result<(), Box<dyn Error>>,
    ) -> Result<(), Box<dyn Error>> {
        ticks(start_ns, SLICE, |n| tick(self, n))
    }

    fn bare(&mut self, socket: &Plain, tick: u64) -> Result<(), Box<dyn Error>> {
        // The first tick of a slice has no sample of the tick before.
        if tick > 0 {
            self.ticks += 1;
            self.age_ns.push(monotonic_ns() - self.newest_ns);
        }
        let sent_ns = monotonic_ns();
        socket.write(BARE.0, tick)?;
        let (_, made_ns) = loop {
            if let Some(answer) = socket.read()? {
                break answer;
            }
        };
        self.way_out_ns.push(made_ns - sent_ns);
        self.way_in_ns.push(monotonic_ns() - made_ns);
        self.newest_ns = made_ns;
        Ok(())
    }

    fn link(&mut self, link: &mut CanLink, tick: u64) -> Result<(), Box<dyn Error>> {
        let (mut newest_ns, mut last_ns) = (0, 0);
        link.receive(&mut |frame| {
            let mut stamp = [0; 8];
            stamp.copy_from_slice(frame.frame.data());
            newest_ns = u64::from_le_bytes(stamp);
            last_ns = frame.received_ns;
        });
        if tick > 0 {
            self.ticks += 1;
            if newest_ns > self.sent_ns {
                self.way_out_ns.push(newest_ns - self.sent_ns);
                self.way_in_ns.push(last_ns.saturating_sub(newest_ns));
            } else {
                self.missing += 1;
            }
            self.newest_ns = self.newest_ns.max(newest_ns);
            self.age_ns.push(monotonic_ns() - self.newest_ns);
        }
        self.sent_ns = monotonic_ns();
        let frame = |id| Frame::new(FrameId::Standard(id), &tick.to_le_bytes()).ok_or("8 bytes are a frame");
        link.send(&[frame(COMMANDS[0])?, frame(COMMANDS[1])?]);
        Ok(())
    }
}

/// Answers each frame that it knows at once, with the time.
struct Node(std::thread::JoinHandle<Result<(), String>>);

impl Node {
    fn start(interface: &Interface, which: &str, ids: &[u16], stop: Arc<AtomicBool>) -> Result<Node, Box<dyn Error>> {
        let end = match of(interface, which) {
            Interface::SocketCan(_) => Plain::open(interface, which, ids)?,
            Interface::Unix(path) => {
                let listener = seqpacket()?;
                bind(&listener, &SocketAddrUnix::new(path)?)?;
                listen(&listener, 1)?;
                Plain::Unix(listener)
            }
        };
        let work = move || -> Result<(), Box<dyn Error>> {
            prepare_thread(&Request { priority: 60, ..Request::default() });
            let end = match end {
                Plain::Unix(listener) => Plain::unix(accept(&listener)?)?,
                can => can,
            };
            while !stop.load(Relaxed) {
                let answers = match end.read() {
                    Ok(Some((id, _))) if id == BARE.0 => &[BARE.1][..],
                    Ok(Some((id, _))) if id == COMMANDS[0] => &ANSWERS,
                    Ok(_) => continue,
                    // The loop has closed its end.
                    Err(_) => break,
                };
                let made_ns = monotonic_ns();
                answers.iter().try_for_each(|id| end.write(*id, made_ns))?;
            }
            Ok(())
        };
        Ok(Node(std::thread::Builder::new().name("node".to_owned()).spawn(move || work().map_err(|e| e.to_string()))?))
    }

    fn join(self) -> Result<(), Box<dyn Error>> {
        self.0.join().map_err(|_| "a node's thread panicked")?.map_err(Into::into)
    }
}

/// A bus of its own for each pair of ends; an interface carries them all.
fn of(interface: &Interface, which: &str) -> Interface {
    match interface {
        Interface::Unix(path) => Interface::Unix(PathBuf::from(format!("{}.{which}", path.display()))),
        can => can.clone(),
    }
}

/// A socket that blocks, without anything around it.
enum Plain {
    Can(CanSocket),
    Unix(OwnedFd),
}

impl Plain {
    fn open(interface: &Interface, which: &str, ids: &[u16]) -> Result<Plain, Box<dyn Error>> {
        match of(interface, which) {
            Interface::SocketCan(name) => {
                let socket = CanSocket::open(&name).map_err(|e| format!("{name}: {e}"))?;
                let exact = exact_mask();
                socket.set_filters(&ids.iter().map(|id| CanFilter::new(u32::from(*id), exact)).collect::<Vec<_>>())?;
                socket.set_read_timeout(Duration::from_millis(200))?;
                Ok(Plain::Can(socket))
            }
            Interface::Unix(path) => Plain::connect(&path),
        }
    }

    fn connect(path: &Path) -> Result<Plain, Box<dyn Error>> {
        let socket = seqpacket()?;
        connect(&socket, &SocketAddrUnix::new(path)?)?;
        Plain::unix(socket)
    }

    fn unix(socket: OwnedFd) -> Result<Plain, Box<dyn Error>> {
        let timeout = Some(Duration::from_millis(200));
        rustix::net::sockopt::set_socket_timeout(&socket, rustix::net::sockopt::Timeout::Recv, timeout)?;
        Ok(Plain::Unix(socket))
    }

    /// Sends 8 bytes.
    fn write(&self, id: u16, data: u64) -> Result<(), Box<dyn Error>> {
        let mut bytes = [0; 16];
        bytes[..4].copy_from_slice(&u32::from(id).to_ne_bytes());
        bytes[4] = 8;
        bytes[8..].copy_from_slice(&data.to_le_bytes());
        rustix::io::write(self, &bytes)?;
        Ok(())
    }

    /// Identifier and 8 bytes; `None` where nothing came for 200 ms.
    fn read(&self) -> Result<Option<(u16, u64)>, Box<dyn Error>> {
        let mut bytes = [0; 16];
        match rustix::io::read(self, &mut bytes[..]) {
            Ok(16) => {}
            Ok(got) => return Err(format!("expected a frame of 16 bytes, got {got}").into()),
            Err(rustix::io::Errno::AGAIN) => return Ok(None),
            Err(error) => return Err(error.into()),
        }
        let [a, b, c, d, ..] = bytes;
        let mut data = [0; 8];
        data.copy_from_slice(&bytes[8..]);
        Ok(Some((u32::from_ne_bytes([a, b, c, d]) as u16, u64::from_le_bytes(data))))
    }
}

impl AsFd for Plain {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Plain::Can(socket) => socket.as_fd(),
            Plain::Unix(socket) => socket.as_fd(),
        }
    }
}

/// All bits of a standard identifier, and both flags.
fn exact_mask() -> u32 {
    0x7FF | socketcan::id::CAN_EFF_FLAG | socketcan::id::CAN_RTR_FLAG
}

fn seqpacket() -> rustix::io::Result<OwnedFd> {
    socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
}
