//! How old the amplifier's newest answer is that the loop sees over a pty, beside the bare port in the same run.
//!
//! ```text
//! cargo run --release -p benchmarks --bin serial_wire -- 60      # seconds; 20 if not given
//! ```
//!
//! Slices of a second take turns at 1 kHz. *Bare*: the loop writes 10 bytes to a non-blocking port and polls it until 33 bytes are back.
//! *Link*: [`SerialLink`] with a command and a request for telemetry each tick, and an emulated VESC at the other end; what the loop
//! sees at a tick was answered to the tick before. Age counts from the reception of the answer in both; below it the way there
//! and back. Ends with 3 where an answer was missing at the next tick more often than once in a thousand ticks and than twice as often as
//! at the bare port.
//!
//! Bytes of a pty pass through a worker of the kernel without real-time priority: do nothing else on the machine meanwhile.

use benchmarks::wire::{head, row, ticks};
use benchmarks::{Target, exit};
use drivers::amplifier::{AmplifierSettings, DriveState, Outbox, protocol};
use drivers::journal::JournalReader;
use drivers::serial::{Pty, SerialLink};
use drivers::wired::{TmclSettings, settings::VescSettings};
use rt_core::system::time::monotonic_ns;
use rt_core::system::{Request, prepare_thread};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use std::error::Error;
use std::io::ErrorKind;
use std::os::fd::{AsFd, OwnedFd};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;

const PERIOD_NS: u64 = 1_000_000;
/// Ticks of a slice.
const SLICE: u64 = 1_000;
/// Bytes of the bare port's question and answer.
const BARE: (usize, usize) = (10, 33);
/// The bare port is polled for so long after the tick; then the answer is missing.
const PATIENCE_NS: u64 = 900_000;
/// Ticks without the answer to the tick before, of all, that are no fault of the machine.
const MISSING: f64 = 1e-3;
/// Below the loop's: the link's thread, and the amplifiers.
const PRIORITIES: [u8; 2] = [70, 60];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let seconds = match &arguments[..] {
        [] => Ok(20),
        [seconds] => seconds.parse(),
        _ => "".parse(),
    };
    match seconds {
        Ok(seconds) => exit(measure(seconds)),
        Err(_) => {
            eprintln!("expected seconds, or nothing, got {arguments:?}");
            ExitCode::from(2)
        }
    }
}

fn measure(seconds: u64) -> Result<bool, Box<dyn Error>> {
    let stop = Arc::new(AtomicBool::new(false));
    let (bare_pty, link_pty) = (Pty::open(None)?, Pty::open(None)?);
    let settings = AmplifierSettings {
        protocol: "vesc".into(),
        port: link_pty.path().to_owned(),
        baud: 460_800,
        full_scale_v: 24.0,
        reversed: false,
        telemetry_every_ticks: 1,
        timeout_ms: 1000.0,
        vesc: VescSettings::default(),
        tmcl: TmclSettings::default(),
    };
    let port =
        open(bare_pty.path(), OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
    let mut waiting = 0;
    let amplifiers = [
        amplifier(bare_pty, stop.clone(), move |asked, out| {
            waiting += asked.len();
            while waiting >= BARE.0 {
                waiting -= BARE.0;
                out.push(&[0x55; BARE.1]);
            }
        })?,
        amplifier(link_pty, stop.clone(), {
            let mut drive = (protocol("vesc")?.drive)(&settings)?;
            move |asked, out| {
                drive.hear(asked, monotonic_ns(), &DriveState::default(), out);
            }
        })?,
    ];
    let mut journal = JournalReader::default();
    let prepare = || drop(prepare_thread(&Request { priority: PRIORITIES[0], ..Request::default() }));
    let mut link = SerialLink::open(&settings, prepare, journal.journal("serial"))?;
    let refused = prepare_thread(&Request::default()).iter().filter(|grant| grant.is_refused()).count();

    let (mut by_bare, mut by_link) = (Figures::default(), Figures::default());
    for _ in 0..seconds.div_ceil(2) {
        by_bare.slice(|figures, tick| figures.bare(&port, tick))?;
        by_link.slice(|figures, tick| {
            figures.link(&mut link, tick);
            Ok(())
        })?;
    }
    drop(link);
    stop.store(true, Relaxed);
    for amplifier in amplifiers {
        amplifier.join().map_err(|_| "an amplifier's thread panicked")?;
    }

    let rights = if refused > 0 { " (without real-time priority)" } else { "" };
    println!("{} ticks each, us{rights}", by_link.ticks);
    head();
    let age = row("bare: age of the answer at the next tick", &mut by_bare.age_ns, None);
    row("link: age of the newest report at the tick", &mut by_link.age_ns, Some(age));
    let way = row("bare: from the question to the answer", &mut by_bare.way_ns, None);
    row("link: from the command to the report", &mut by_link.way_ns, Some(way));
    let call = row("bare: the write", &mut by_bare.call_ns, None);
    row("link: command and poll", &mut by_link.call_ns, Some(call));
    for note in journal.read() {
        println!("noted: {}", note.text);
    }
    println!("bare: ticks without the answer to the tick before: {} of {}", by_bare.missing, by_bare.ticks);
    // What the bare port misses, the machine and its pty miss.
    let share = |figures: &Figures| figures.missing as f64 / figures.ticks as f64;
    let (bare, missing) = (share(&by_bare), share(&by_link));
    let target = Target::AtMost(MISSING.max(2.0 * bare));
    let judged = target.judge(missing);
    println!("link: ticks without the answer to the tick before: {} of {}, {judged}", by_link.missing, by_link.ticks);
    Ok(target.reached_by(missing))
}

/// Times of one kind of slice, ns.
#[derive(Default)]
struct Figures {
    ticks: u64,
    missing: u64,
    /// When the newest answer came.
    newest_ns: u64,
    sent_ns: u64,
    age_ns: Vec<u64>,
    way_ns: Vec<u64>,
    call_ns: Vec<u64>,
}

impl Figures {
    fn slice(
        &mut self,
        mut tick: impl FnMut(&mut Figures, u64) -> Result<(), Box<dyn Error>>,
    ) -> Result<(), Box<dyn Error>> {
        ticks(monotonic_ns() + PERIOD_NS, SLICE, |n| tick(self, n))
    }

    fn bare(&mut self, port: &OwnedFd, tick: u64) -> Result<(), Box<dyn Error>> {
        // What was late for the tick before is not the answer to this one.
        let mut bytes = [0; 256];
        while rustix::io::read(port, &mut bytes[..]).is_ok() {}
        if tick > 0 {
            self.ticks += 1;
            self.age_ns.push(monotonic_ns() - self.newest_ns);
        }
        let sent_ns = monotonic_ns();
        rustix::io::write(port, &[0xaa; BARE.0])?;
        self.call_ns.push(monotonic_ns() - sent_ns);
        let mut heard = 0;
        while heard < BARE.1 {
            let left_ns = (sent_ns + PATIENCE_NS).saturating_sub(monotonic_ns());
            if left_ns == 0 {
                self.missing += 1;
                return Ok(());
            }
            let wait = Timespec { tv_sec: 0, tv_nsec: left_ns as i64 };
            poll(&mut [PollFd::new(port, PollFlags::IN)], Some(&wait))?;
            match rustix::io::read(port, &mut bytes[..]) {
                Ok(read) => heard += read,
                Err(Errno::AGAIN) => {}
                Err(e) => return Err(e.into()),
            }
        }
        self.newest_ns = monotonic_ns();
        self.way_ns.push(self.newest_ns - sent_ns);
        Ok(())
    }

    fn link(&mut self, link: &mut SerialLink, tick: u64) {
        let began_ns = monotonic_ns();
        let report = link.poll();
        if tick > 0 {
            self.ticks += 1;
            self.age_ns.push(began_ns.saturating_sub(report.telemetry_ns));
            if report.telemetry_ns > self.sent_ns {
                self.way_ns.push(report.telemetry_ns - self.sent_ns);
            } else {
                self.missing += 1;
            }
        }
        self.sent_ns = monotonic_ns();
        link.command(0.0);
        self.call_ns.push(monotonic_ns() - began_ns);
    }
}

/// Answers at the other end of a pty.
fn amplifier(
    pty: Pty,
    stop: Arc<AtomicBool>,
    mut answer: impl FnMut(&[u8], &mut Outbox) + Send + 'static,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("amplifier".into()).spawn(move || {
        prepare_thread(&Request { priority: PRIORITIES[1], ..Request::default() });
        let (mut out, mut bytes) = (Outbox::new(), [0; 256]);
        let wait = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
        while !stop.load(Relaxed) {
            // A signal or the time: it is read all the same.
            let _ = poll(&mut [PollFd::new(&pty.as_fd(), PollFlags::IN)], Some(&wait));
            match pty.try_read(&mut bytes) {
                Ok(read) => answer(&bytes[..read], &mut out),
                Err(e) if e.kind() == ErrorKind::WouldBlock => continue,
                Err(_) => return,
            }
            // What finds no room is lost, as at a UART.
            let _ = pty.try_write(out.bytes());
            out.clear();
        }
    })
}
