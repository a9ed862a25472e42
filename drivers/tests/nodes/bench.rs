//! The other end of an emulated rig's wires, by hand: raw frames and a raw protocol, none of the drivers' threads.

use super::rig::{factory, preparation};
use drivers::amplifier::{Outbox, Protocol, Telemetry, Told, protocol};
use drivers::can::{End, Frame, Heard, Interface, Port, Wanted};
use drivers::dbc::Database;
use drivers::journal::JournalReader;
use drivers::nodes::{Emulator, EmulatorError, EmulatorSettings};
use drivers::wired::{AmplifierSettings, CanSettings};
use rustix::fs::{Mode, OFlags};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use serde::Deserialize;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// How long something may take that is bound to come.
const PATIENCE: Duration = Duration::from_secs(20);

#[derive(Deserialize)]
struct Wires {
    amplifier: AmplifierSettings,
    can: CanSettings,
}

pub fn database() -> Database {
    Database::parse(include_str!("../../../bench/rigs/rec.dbc"), "rec.dbc").unwrap()
}

/// The built-in wired rig, with this protocol.
pub fn settings(protocol: &str, interface: Interface) -> EmulatorSettings {
    let mut wires: Wires = toml::from_str(include_str!("../../../bench/rigs/wired.toml")).unwrap();
    wires.amplifier.protocol = protocol.to_owned();
    EmulatorSettings::new(wires.amplifier, wires.can, interface)
}

pub struct Bench {
    runtime: Runtime,
    port: Port,
    tty: OwnedFd,
    client: Box<dyn Protocol>,
    database: Database,
    pub emulator: Emulator,
    pub journal: JournalReader,
}

/// What the sensors answered: every frame that came up to the last sensor's.
pub struct Answers {
    database: Database,
    pub frames: Vec<Frame>,
}

impl Answers {
    /// Every value of this signal, in the order in which they came.
    pub fn all(&self, path: &str) -> Vec<f64> {
        let (message, signal) = self.database.signal(path).unwrap();
        let frames = self.frames.iter().filter(|frame| frame.id == message.id);
        frames.filter_map(|frame| signal.codec.decode(frame.data())).collect()
    }

    /// The one value of this signal.
    pub fn one(&self, path: &str) -> f64 {
        match self.all(path)[..] {
            [value] => value,
            ref others => panic!("{path}: expected one value, got {others:?}"),
        }
    }
}

/// An emulated rig alone.
pub fn start(settings: &EmulatorSettings) -> Result<Emulator, EmulatorError> {
    Emulator::start(settings, &database(), factory(), || {}, JournalReader::default().journal("rig"))
}

impl Bench {
    /// Starts an emulated rig and opens both wires.
    pub fn open(settings: &EmulatorSettings) -> Bench {
        let database = database();
        let mut journal = JournalReader::default();
        let emulator = Emulator::start(settings, &database, factory(), || {}, journal.journal("rig")).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let port = {
            let _inside = runtime.enter();
            Port::open(&settings.interface, Wanted::All, End::Connects).unwrap()
        };
        let tty = open(emulator.port());
        let client = (protocol(&settings.amplifier.protocol).unwrap().client)(&settings.amplifier).unwrap();
        let bench = Bench { runtime, port, tty, client, database, emulator, journal };
        bench.set_baud(settings.amplifier.baud);
        bench
    }

    pub fn set_baud(&self, baud: u32) {
        let mut termios = tcgetattr(&self.tty).unwrap();
        termios.make_raw();
        termios.set_speed(baud).unwrap();
        tcsetattr(&self.tty, OptionalActions::Now, &termios).unwrap();
    }

    /// Sends a message with these signals; all others are 0.
    pub fn send(&self, message: &str, values: &[(&str, f64)]) {
        let message = self.database.message(message).unwrap();
        let mut frame = Frame::new(message.id, &[0; 8][..message.length]).unwrap();
        for (name, value) in values {
            message.signal(name).unwrap().codec.encode(*value, frame.data_mut()).unwrap();
        }
        self.runtime.block_on(self.port.send(&frame)).unwrap();
    }

    /// Sends a SYNC.
    pub fn sync(&self, counter: u64, running: bool, brake_open: bool) {
        let bit = |set: bool| f64::from(u8::from(set));
        let values = [
            ("BrakeOpen", bit(brake_open)),
            ("BypassOpen", 0.0),
            ("Running", bit(running)),
            ("Counter", counter as f64),
        ];
        self.send("VALVES", &values);
    }

    /// Sends a SYNC and hears what the sensors answer: all that comes until the cylinder, which is the last, has echoed the counter.
    pub fn ask(&self, counter: u64, running: bool) -> Answers {
        self.sync(counter, running, true);
        self.until(|answers| answers.all("CYLINDER.Counter").contains(&(counter as f64)))
    }

    /// Everything that comes until there is enough.
    pub fn until(&self, enough: impl Fn(&Answers) -> bool) -> Answers {
        let mut answers = Answers { database: self.database.clone(), frames: vec![] };
        let begin = Instant::now();
        while !enough(&answers) {
            let last = answers.frames.len().saturating_sub(10);
            assert!(begin.elapsed() < PATIENCE, "{last} frames, then {:?}", &answers.frames[last..]);
            let heard = self.runtime.block_on(async { tokio::time::timeout(PATIENCE, self.port.receive()).await });
            if let Heard::Frame(received) = heard.expect("something is sent all the time").unwrap() {
                answers.frames.push(received.frame);
            }
        }
        answers
    }

    /// Says something to the amplifier.
    pub fn say(&mut self, with: impl FnOnce(&mut dyn Protocol, &mut Outbox)) {
        let mut out = Outbox::new();
        with(&mut *self.client, &mut out);
        let mut bytes = out.bytes();
        while !bytes.is_empty() {
            let written = rustix::io::write(&self.tty, bytes).unwrap();
            bytes = &bytes[written..];
        }
    }

    /// What the amplifier has said, if anything.
    pub fn heard(&mut self) -> Vec<Told> {
        let mut bytes = [0; 256];
        let mut told = vec![];
        while let Ok(count @ 1..) = rustix::io::read(&self.tty, &mut bytes[..]) {
            self.client.hear(&bytes[..count], &mut |what| told.push(what));
        }
        told
    }

    /// Waits until the amplifier says something of this kind.
    pub fn wait<T>(&mut self, of: impl Fn(Told) -> Option<T>) -> T {
        let begin = Instant::now();
        loop {
            if let Some(found) = self.heard().into_iter().find_map(&of) {
                return found;
            }
            assert!(begin.elapsed() < PATIENCE, "the amplifier did not answer: {:?}", self.client.garbled());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Asks for telemetry until it is as wanted.
    pub fn telemetry(&mut self, wanted: impl Fn(&Telemetry) -> bool) -> Telemetry {
        let begin = Instant::now();
        loop {
            self.say(|client, out| client.request(out));
            let telemetry =
                self.wait(|told| if let Told::Telemetry(telemetry) = told { Some(telemetry) } else { None });
            if wanted(&telemetry) {
                return telemetry;
            }
            assert!(begin.elapsed() < PATIENCE, "{telemetry:?}");
        }
    }

    /// Prepares run 0 as a free lever.
    pub fn prepare(&self, fill_bar: f64) -> Answers {
        assert_eq!(preparation(0, super::rig::FREE).run, 0);
        self.send("FIXTURE_POSE", &[("Kind", 0.0)]);
        self.send("FIXTURE_RUN", &[("Run", 0.0), ("FillBar", fill_bar)]);
        self.ask(40_000, false)
    }
}

fn open(path: &Path) -> OwnedFd {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    rustix::fs::open(path, flags, Mode::empty()).unwrap()
}
