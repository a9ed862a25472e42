//! Programs that run beside each other, and recordings that are compared.
#![allow(dead_code)] // each test binary uses its part

pub mod network;

use recordings::{Item, McapReader};
use rt_core::{LossCertificate, Sample};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Longest wait for anything; only a failing test waits that long.
pub const PATIENCE: Duration = Duration::from_secs(60);
pub const BENCH: &str = env!("CARGO_BIN_EXE_bench");

/// A program that runs, with what it says on stdout and stderr. Killed when it goes out of scope.
pub struct Running {
    child: Child,
    lines: Receiver<String>,
    pub said: String,
}

impl Running {
    pub fn start(mut command: Command, arguments: &[&str]) -> Running {
        command.args(arguments).env_remove("RUST_LOG");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("the program starts");
        let (line, lines) = channel();
        follow(child.stdout.take().expect("it is piped"), line.clone());
        follow(child.stderr.take().expect("it is piped"), line);
        Running { child, lines, said: String::new() }
    }

    /// Waits until it has said this.
    #[track_caller]
    pub fn wait_for(&mut self, text: &str) {
        let begin = Instant::now();
        while !self.said.contains(text) {
            match self.lines.recv_timeout(PATIENCE.saturating_sub(begin.elapsed())) {
                Ok(line) => self.said = format!("{}{line}\n", self.said),
                Err(error) => panic!("{text:?} was never said ({error}), but: {}", self.said),
            }
        }
    }

    /// What it has said by now.
    pub fn so_far(&mut self) -> &str {
        while let Ok(line) = self.lines.try_recv() {
            self.said = format!("{}{line}\n", self.said);
        }
        &self.said
    }

    /// `ip netns exec` becomes the program that it starts: the signal is for that one.
    pub fn interrupt(&self) {
        let id = i32::try_from(self.child.id()).expect("a process number");
        // SAFETY: a plain system call; the process is our own child and was not waited for yet.
        assert_eq!(unsafe { libc::kill(id, libc::SIGINT) }, 0);
    }

    /// Waits for its end: exit code, and all that it said.
    #[track_caller]
    pub fn end(mut self) -> (i32, String) {
        let begin = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("our own child") {
                break status;
            }
            assert!(begin.elapsed() < PATIENCE, "it does not end; it said: {}", self.said);
            thread::sleep(Duration::from_millis(10));
        };
        while let Ok(line) = self.lines.recv() {
            self.said = format!("{}{line}\n", self.said);
        }
        (status.code().expect("it ended by itself"), std::mem::take(&mut self.said))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn follow(stream: impl std::io::Read + Send + 'static, line: Sender<String>) {
    thread::spawn(move || {
        let _ = BufReader::new(stream).lines().map_while(Result::ok).try_for_each(|text| line.send(text));
    });
}

/// The samples of a recording by their numbers, and its certificate.
pub fn read(path: &Path) -> (BTreeMap<u64, Sample>, LossCertificate) {
    let mut reader = McapReader::open(path).expect("a recording");
    let mut samples = BTreeMap::new();
    for item in reader.by_ref() {
        if let Item::Sample(sample) = item.expect("a sound recording") {
            samples.insert(sample.sequence(), sample);
        }
    }
    let certificate = reader.certificate().expect("a closed recording").clone();
    (samples, certificate)
}

/// What the far recording holds is what the rig's holds, and what it lacks is what its certificate says.
#[track_caller]
pub fn compare(rig: &Path, far: &Path) -> (BTreeMap<u64, Sample>, LossCertificate) {
    let (all, whole) = read(rig);
    assert!(whole.is_lossless(), "the rig's own recording: {whole}");
    let (crossed, certificate) = read(far);
    let text = |sample: &Sample| format!("{sample:?}"); // NaN is not equal to itself
    for (number, sample) in &crossed {
        assert_eq!(text(sample), text(&all[number]), "sample {number}");
    }
    let end = if certificate.end_seen { all.len() as u64 } else { certificate.expected };
    let missing: Vec<u64> = (0..end).filter(|number| !crossed.contains_key(number)).collect();
    let certified: Vec<u64> = certificate.gaps.iter().flat_map(|(first, last)| *first..=*last).collect();
    assert_eq!(certified, missing, "{certificate}");
    assert_eq!((certificate.received, certificate.expected), (crossed.len() as u64, end), "{certificate}");
    (crossed, certificate)
}
