//! A running `bench record`, and a publication for it that is driven by hand.
#![allow(dead_code)] // each test binary uses its part

use recordings::{Item, McapReader};
use rt_core::{LossCertificate, PERIOD_NS, Pace, Publication, Publish, Sample, flags};
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

/// Longest wait for anything; only a failing test waits that long.
pub const PATIENCE: Duration = Duration::from_secs(60);

pub fn instance(test: &str) -> String {
    format!("record-{test}-{}", std::process::id())
}

pub fn sample(run: u32, tick: u64) -> Sample {
    Sample {
        run,
        tick,
        scheduled_ns: tick * PERIOD_NS,
        woken_ns: 1_000_000_000 * u64::from(run + 1) + tick * PERIOD_NS,
        voltage_v: (tick % 12) as f64,
        angle_deg: (tick as f64 * 0.01).sin(),
        pressure1_bar: 2.0 + (tick % 7919) as f64 * 1e-4,
        pressure2_bar: 2.0,
        ..Sample::BLANK
    }
}

/// Publishes these ticks of a run; the last one ends it where `ends` says so. Where the publication does not wait for room, this does.
pub fn publish(publication: &mut Publication, run: u32, ticks: impl Iterator<Item = u64>, ends: Option<u64>) {
    for tick in ticks {
        let flags = if ends == Some(tick) { flags::LAST } else { 0 };
        let sample = Sample { flags, ..sample(run, tick) };
        while publication.publish(&sample) == rt_core::Handover::Lost {
            thread::sleep(Duration::from_millis(1));
        }
    }
    publication.settle(PATIENCE).expect("the publication goes on");
}

/// In virtual time: it waits for the recorder, however busy the machine is.
pub fn publication(instance: &str) -> Publication {
    Publication::start(instance, Pace::LOCKSTEP).expect("shared memory is there")
}

/// In real time: it waits for nobody.
pub fn hasty_publication(instance: &str) -> Publication {
    Publication::start(instance, Pace::RealTime).expect("shared memory is there")
}

/// A running `bench record`, with what it says. Killed when it goes out of scope, whatever the test's outcome.
pub struct Recorder {
    child: Child,
    pub says: Receiver<String>,
    pub said: String,
}

/// A file may not grow beyond this in the process that is started.
pub type FileLimit = Option<u64>;

impl Recorder {
    pub fn start(out: &Path, instance: &str, extra: &[&str], limit: FileLimit) -> Recorder {
        let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
        command.args(["record", "--out"]).arg(out).args(["--instance", instance]).args(extra).env_remove("RUST_LOG");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        if let Some(bytes) = limit {
            // SAFETY: only system calls that are allowed between fork and exec.
            unsafe { command.pre_exec(move || limit_file_size(bytes)) };
        }
        let mut child = command.spawn().expect("the program starts");
        let stderr = child.stderr.take().expect("it is piped");
        let (line, says) = mpsc::channel();
        thread::spawn(move || {
            BufReader::new(stderr).lines().map_while(Result::ok).try_for_each(|text| line.send(text))
        });
        let mut recorder = Recorder { child, says, said: String::new() };
        recorder.wait_for("waiting for a run");
        recorder
    }

    /// Waits until it has said this on stderr.
    #[track_caller]
    pub fn wait_for(&mut self, text: &str) {
        let begin = Instant::now();
        while !self.said.contains(text) {
            match self.says.recv_timeout(PATIENCE.saturating_sub(begin.elapsed())) {
                Ok(line) => self.said = format!("{}{line}\n", self.said),
                Err(error) => panic!("{text:?} was never said ({error}), but: {}", self.said),
            }
        }
    }

    pub fn signal(&self, signal: i32) {
        let id = i32::try_from(self.child.id()).expect("a process number");
        // SAFETY: a plain system call; the process is our own child and was not waited for yet.
        assert_eq!(unsafe { libc::kill(id, signal) }, 0);
    }

    /// Waits for its end: exit code (or the signal's number, negative), stdout, stderr.
    #[track_caller]
    pub fn end(mut self) -> (i32, String, String) {
        let begin = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("our own child") {
                break status;
            }
            assert!(begin.elapsed() < PATIENCE, "it does not end; it said: {}", self.said);
            thread::sleep(Duration::from_millis(10));
        };
        while let Ok(line) = self.says.recv() {
            self.said = format!("{}{line}\n", self.said);
        }
        let mut stdout = String::new();
        self.child.stdout.take().expect("it is piped").read_to_string(&mut stdout).expect("text");
        let code = status.code().or(status.signal().map(|signal| -signal)).expect("it ended");
        (code, stdout, std::mem::take(&mut self.said))
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn limit_file_size(bytes: u64) -> std::io::Result<()> {
    let limit = libc::rlimit { rlim_cur: bytes, rlim_max: bytes };
    // SAFETY: plain system calls with a valid argument.
    let refused = unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        libc::setrlimit(libc::RLIMIT_FSIZE, &raw const limit)
    };
    if refused == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
}

/// What a closed recording holds: its samples' numbers, its certificate.
pub fn read(path: &Path) -> (Vec<u64>, LossCertificate) {
    let mut reader = McapReader::open(path).expect("a recording");
    let items: Vec<Item> = reader.by_ref().map(|item| item.expect("sound")).collect();
    let samples =
        items.iter().filter_map(|item| if let Item::Sample(sample) = item { Some(sample.sequence()) } else { None });
    (samples.collect(), reader.certificate().expect("it was closed").clone())
}

pub fn folder() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let out = dir.path().join("a.mcap");
    (dir, out)
}
