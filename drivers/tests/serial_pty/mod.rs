//! An emulated amplifier at a pty, for tests of the serial link.

#![allow(clippy::unwrap_used, reason = "a test")]
#![allow(dead_code, reason = "not every test binary uses all of it")]

use drivers::amplifier::{AmplifierSettings, DriveState, Outbox, Telemetry, protocol};
use drivers::serial::Pty;
use rt_core::system::time::monotonic_ns;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub const FULL_SCALE_V: f64 = 24.0;

pub fn settings(protocol: &str, port: &Path) -> AmplifierSettings {
    let text = format!("protocol = {protocol:?}\nport = {port:?}\nfull_scale_v = {FULL_SCALE_V:?}\n");
    toml::from_str(&text).unwrap()
}

/// Waits until it is so; generously, since machines stall.
pub fn until(what: &str, mut so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !so() {
        assert!(start.elapsed() < Duration::from_secs(30), "expected {what} within 30 s");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// What the amplifier does with its port.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mood {
    /// Reads and answers.
    Answers,
    /// Reads, does not answer.
    Mute,
    /// Answers, with noise before each answer.
    Noisy,
    /// Answers with noise only.
    Babbles,
    /// Sends back what it reads.
    Echoes,
    /// Does not read.
    Stuck,
}

pub struct State {
    pub mood: Mood,
    pub telemetry: Telemetry,
    /// Every voltage that was commanded, in order.
    pub commands: Vec<f64>,
    /// Bytes that came.
    pub bytes: usize,
    end: bool,
}

/// Dropped, its port is gone.
pub struct Amplifier {
    state: Arc<Mutex<State>>,
    pub port: PathBuf,
    thread: Option<JoinHandle<()>>,
}

impl Amplifier {
    pub fn start(name: &str, link: Option<&Path>, mood: Mood) -> Amplifier {
        let pty = Pty::open(link).unwrap();
        let port = pty.path().to_owned();
        let mut drive = (protocol(name).unwrap().drive)(&settings(name, &port)).unwrap();
        let state = State { mood, telemetry: Telemetry::UNTOLD, commands: vec![], bytes: 0, end: false };
        let state = Arc::new(Mutex::new(state));
        let shared = state.clone();
        let thread = std::thread::spawn(move || {
            let mut bytes = [0; 256];
            let mut out = Outbox::new();
            loop {
                let mood = {
                    let state = shared.lock().unwrap();
                    if state.end {
                        return;
                    }
                    state.mood
                };
                if mood == Mood::Stuck {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
                let wait = Timespec { tv_sec: 0, tv_nsec: 5_000_000 };
                poll(&mut [PollFd::new(&pty, PollFlags::IN)], Some(&wait)).unwrap();
                let Ok(read) = pty.try_read(&mut bytes) else { continue };
                let mut state = shared.lock().unwrap();
                state.bytes += read;
                let now = DriveState { telemetry: state.telemetry };
                for &byte in &bytes[..read] {
                    // One at a time: the drive tells the newest command only.
                    let commanded = drive.hear(&[byte], monotonic_ns(), &now, &mut out);
                    state.commands.extend(commanded);
                }
                let noise = [0x00, 0x5a, 0x02, 0xff, 0x13, 0x37, 0x81];
                match mood {
                    Mood::Noisy if !out.is_empty() => drop(pty.try_write(&noise)),
                    Mood::Babbles => drop(pty.try_write(&noise)),
                    Mood::Echoes => drop(pty.try_write(&bytes[..read])),
                    _ => {}
                }
                if matches!(mood, Mood::Answers | Mood::Noisy) {
                    // What finds no room is lost, as at a UART.
                    let _ = pty.try_write(out.bytes());
                }
                out.clear();
            }
        });
        Amplifier { state, port, thread: Some(thread) }
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }

    pub fn commands(&self) -> Vec<f64> {
        self.state().commands.clone()
    }

    /// Bytes and commands so far.
    pub fn received(&self) -> (usize, usize) {
        let state = self.state();
        (state.bytes, state.commands.len())
    }

    pub fn last(&self) -> Option<f64> {
        self.state().commands.last().copied()
    }
}

impl Drop for Amplifier {
    fn drop(&mut self) {
        if let Ok(mut state) = self.state.lock() {
            state.end = true;
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
