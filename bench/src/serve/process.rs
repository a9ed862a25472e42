//! A run as a process of its own: `bench run --realtime`, which ends orderly when the service does, whatever the service dies of.

use super::state::Outcome;
use crate::failure::Kind;
use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::{Duration, Instant};

/// A run that was asked to stop and has not ended by then gets SIGTERM.
const STOPPED_WITHIN: Duration = Duration::from_secs(10);
/// One that has not ended by then, with its recording on a slow disk, is killed: its amplifier's own timeout stops the pump.
const KILLED_AFTER: Duration = Duration::from_secs(90);
/// Lines of a run that are kept for what it said at its end.
const LINES_KEPT: usize = 50;

/// What a run is to be.
#[derive(Clone, Debug)]
pub struct Order {
    /// Its number.
    pub number: u32,
    /// Name of the profile.
    pub profile: String,
    /// Its file; `None`: built in.
    pub file: Option<PathBuf>,
    /// Seed of its random steps.
    pub seed: u64,
    /// The recording to write.
    pub recording: PathBuf,
}

/// What all runs have in common.
#[derive(Clone, Debug)]
pub struct Common {
    /// Rig file; `None`: the emulated rig.
    pub rig: Option<PathBuf>,
    /// Under which they are published.
    pub instance: String,
    /// Further options of `bench run`: priority, processors.
    pub options: Vec<OsString>,
}

/// Where a line of the run came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Results.
    Stdout,
    /// Progress and messages.
    Stderr,
}

/// See the module. Lives in the thread that started it: the kernel ends the run with that thread.
pub struct RunProcess {
    /// What it is.
    pub order: Order,
    child: Child,
    lines: Receiver<(Line, String)>,
    said: Vec<String>,
    failure: Option<String>,
    asked_to_stop: Option<Instant>,
    terminated: bool,
    killed: bool,
}

/// A run that has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    /// How.
    pub outcome: Outcome,
    /// What it said at its end.
    pub text: String,
}

impl RunProcess {
    /// Starts the run.
    ///
    /// # Errors
    /// The system refuses.
    pub fn start(order: Order, common: &Common) -> io::Result<RunProcess> {
        // This very program, also where its file was replaced meanwhile: loop and service are of one build.
        let mut command = Command::new("/proc/self/exe");
        command.arg0("bench").arg("run");
        match &order.file {
            Some(file) => command.arg(file),
            None => command.arg(&order.profile),
        };
        command.arg("--realtime").arg("--instance").arg(&common.instance);
        command.arg("--seed").arg(order.seed.to_string()).arg("--out").arg(&order.recording);
        command.arg("--run-number").arg(order.number.to_string());
        command.arg("--with-parent").arg(std::process::id().to_string());
        if let Some(rig) = &common.rig {
            command.arg("--rig").arg(rig);
        }
        command.args(&common.options);
        // A group of its own: Ctrl-C in the service's terminal is for the service, which asks the run to stop.
        command.process_group(0).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // The service manager's socket is the service's alone.
        command.env_remove("NOTIFY_SOCKET").env_remove("WATCHDOG_USEC").env_remove("WATCHDOG_PID");
        let mut child = command.spawn()?;
        let (sender, lines) = mpsc::channel();
        let heard = child
            .stdout
            .take()
            .map(|pipe| reader(pipe, Line::Stdout, sender.clone()))
            .transpose()
            .and(child.stderr.take().map(|pipe| reader(pipe, Line::Stderr, sender)).transpose());
        let mut process = RunProcess {
            order,
            child,
            lines,
            said: Vec::new(),
            failure: None,
            asked_to_stop: None,
            terminated: false,
            killed: false,
        };
        if let Err(error) = heard {
            // A run that nobody hears would stand still at a full pipe.
            process.terminate();
            process.child.wait()?;
            return Err(error);
        }
        Ok(process)
    }

    /// Number of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it said since the last call.
    pub fn lines(&mut self) -> Vec<(Line, String)> {
        let lines: Vec<_> = self.lines.try_iter().collect();
        lines.iter().for_each(|(from, line)| self.keep(*from, line));
        lines
    }

    fn keep(&mut self, from: Line, line: &str) {
        if let Some(failure) = line.strip_prefix("error: ").filter(|_| from == Line::Stderr) {
            self.failure = Some(failure.to_owned());
        } else if from == Line::Stdout && self.said.len() < LINES_KEPT {
            self.said.push(line.to_owned());
        }
    }

    /// It was asked to stop: from now on it is expected to end.
    pub fn stop_asked(&mut self) {
        self.asked_to_stop.get_or_insert_with(Instant::now);
    }

    /// Sends SIGTERM: the run stops, and zeroes its outputs. Once only: a second signal would end it at once.
    pub fn terminate(&mut self) {
        self.stop_asked();
        if !std::mem::replace(&mut self.terminated, true) {
            self.signal(Signal::TERM);
        }
    }

    fn signal(&self, signal: Signal) {
        // It was not waited for yet, so the number is still its own.
        if let Some(pid) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            let _ = kill_process(pid, signal);
        }
    }

    /// Whether it has ended. To be called several times a second. `note` hears what had to be done.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn poll(&mut self, mut note: impl FnMut(&str)) -> io::Result<Option<Ended>> {
        let Some(status) = self.child.try_wait()? else {
            let waited = self.asked_to_stop.map(|asked| asked.elapsed()).unwrap_or_default();
            if waited > STOPPED_WITHIN && !self.terminated {
                note("the run was asked to stop and goes on: it gets SIGTERM");
                self.terminate();
            }
            if waited > KILLED_AFTER && !std::mem::replace(&mut self.killed, true) {
                note("the run was asked to stop and does not end: it is killed; look after the rig");
                self.signal(Signal::KILL);
            }
            return Ok(None);
        };
        // Its pipes are closed by now, or soon: what is in them belongs to its end.
        let deadline = Instant::now() + Duration::from_millis(500);
        while let Ok((from, line)) = self.lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            self.keep(from, &line);
        }
        let outcome = outcome(status);
        let said = if outcome == Outcome::Completed { None } else { self.failure.take() };
        let text = said.or_else(|| self.said.first().cloned()).unwrap_or_else(|| status.to_string());
        Ok(Some(Ended { outcome, text }))
    }

    /// Name of the recording, where there is one.
    pub fn recording_id(&self, data: &Path) -> Option<String> {
        self.order.recording.is_file().then(|| super::finished::id_of(data, &self.order.recording)).flatten()
    }
}

impl Drop for RunProcess {
    /// A service that goes takes nobody along, but nothing goes on without it.
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.terminate();
            let _ = self.child.wait();
        }
    }
}

/// By the exit codes of `bench run`.
fn outcome(status: ExitStatus) -> Outcome {
    let is = |kind: Kind| status.code() == Some(kind as i32);
    if status.success() {
        Outcome::Completed
    } else if is(Kind::Safety) {
        Outcome::Tripped
    } else if is(Kind::Interrupted) || status.signal() == Some(libc::SIGTERM) {
        Outcome::Stopped
    } else if is(Kind::Loss) {
        Outcome::Aborted
    } else {
        Outcome::Failed
    }
}

fn reader(pipe: impl Read + Send + 'static, from: Line, lines: Sender<(Line, String)>) -> io::Result<()> {
    let read = move || {
        // A line that is no text says nothing; a pipe that is closed ends the thread.
        for line in BufReader::new(pipe).split(b'\n') {
            let Ok(line) = line else { return };
            if lines.send((from, String::from_utf8_lossy(&line).into_owned())).is_err() {
                return;
            }
        }
    };
    thread::Builder::new().name("run-said".to_owned()).spawn(read).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_codes_are_outcomes() {
        let code = |code: i32| outcome(ExitStatus::from_raw(code << 8));
        assert_eq!(
            [0, 1, 2, 3, 4, 5, 6, 130].map(code),
            [
                Outcome::Completed,
                Outcome::Failed,
                Outcome::Failed,
                Outcome::Failed,
                Outcome::Failed,
                Outcome::Tripped,
                Outcome::Aborted,
                Outcome::Stopped
            ]
        );
        assert_eq!(outcome(ExitStatus::from_raw(libc::SIGTERM)), Outcome::Stopped);
        assert_eq!(outcome(ExitStatus::from_raw(libc::SIGKILL)), Outcome::Failed);
    }
}
