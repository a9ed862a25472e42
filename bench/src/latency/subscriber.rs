//! Subscribers in processes of their own: the program starts itself again, follows the samples of one run event by event,
//! and tells when each of them came.

use crate::failure::{Failure, Kind};
use crate::latency::statistics::Distribution;
use rt_core::system::time::monotonic_ns;
use rt_core::{Delivery, LossCertificate, Sample, SampleSubscriber};
use rustix::process::{Pid, Signal, kill_process, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

/// Hidden option of `bench latency` by which the program is a subscriber: `--subscribe INSTANCE`.
pub const OPTION: &str = "--subscribe";
/// What a subscriber says when samples that are published from now on reach it.
const READY: &str = "ready";
/// Longest wait for one sample before the subscriber takes another look.
const LOOK: Duration = Duration::from_millis(200);
/// A subscriber that has heard nothing for this long ends: its parent went another way.
const SILENCE_NS: u64 = 15_000_000_000;

/// What a subscriber has to say about a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heard {
    /// Samples that arrived.
    pub received: u64,
    /// Samples that the run has, as far as the subscriber knows.
    pub expected: u64,
    /// From the loop's wake-up to the moment at which the subscriber had the sample: pairs of ns and how often.
    woken: Vec<(u64, u64)>,
    /// The same from the time at which the tick should have begun.
    scheduled: Vec<(u64, u64)>,
}

impl Heard {
    /// From the loop's wake-up to the subscriber.
    pub fn from_woken(&self) -> Distribution {
        distribution(&self.woken)
    }

    /// From the scheduled time to the subscriber.
    pub fn from_scheduled(&self) -> Distribution {
        distribution(&self.scheduled)
    }
}

fn distribution(pairs: &[(u64, u64)]) -> Distribution {
    let mut distribution = Distribution::default();
    pairs.iter().for_each(|(ns, times)| distribution.record_times_ns(*ns, *times));
    distribution
}

/// The subscriber itself: says `ready`, follows the samples of `instance` until a run's last one, and prints a [`Heard`].
///
/// # Errors
/// The samples can't be received (4), stdout is closed (1).
pub fn follow(instance: &str) -> Result<(), Failure> {
    // Stopped or not, it must not outlive its parent.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    let link = |e| Failure::of(Kind::Device, &e);
    let mut subscriber = SampleSubscriber::open(instance, Delivery::BestEffort).map_err(link)?;
    say(READY)?;
    let mut clock = Arrivals::default();
    let mut samples = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
    let mut silent_since_ns = monotonic_ns();
    let certificate = loop {
        samples.clear();
        subscriber.receive(LOOK, &mut samples).map_err(link)?;
        let now_ns = monotonic_ns();
        samples.iter().for_each(|sample| clock.arrived(sample, now_ns));
        if let Some(certificate) = subscriber.take_certificate() {
            break certificate;
        }
        if !samples.is_empty() {
            silent_since_ns = now_ns;
        } else if now_ns - silent_since_ns > SILENCE_NS {
            subscriber.abandon_run();
            break subscriber.take_certificate().unwrap_or(NOTHING);
        }
    };
    let heard = clock.heard(&certificate);
    say(&serde_json::to_string(&heard).expect("numbers always have a JSON form"))
}

/// The certificate where no run was seen.
const NOTHING: LossCertificate =
    LossCertificate { run: 0, expected: 0, received: 0, gaps: Vec::new(), end_seen: false };

fn say(line: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    let said = writeln!(out, "{line}").and_then(|()| out.flush());
    said.map_err(|e| Failure::new(Kind::Internal, format!("subscriber: expected to write to stdout, got \"{e}\"")))
}

/// When samples came.
#[derive(Default)]
struct Arrivals {
    woken: Distribution,
    scheduled: Distribution,
}

impl Arrivals {
    fn arrived(&mut self, sample: &Sample, now_ns: u64) {
        self.woken.record_ns(now_ns.saturating_sub(sample.woken_ns));
        self.scheduled.record_ns(now_ns.saturating_sub(sample.woken_ns.saturating_sub(sample.lateness_ns)));
    }

    fn heard(&self, certificate: &LossCertificate) -> Heard {
        let LossCertificate { received, expected, .. } = *certificate;
        Heard { received, expected, woken: self.woken.pairs_ns(), scheduled: self.scheduled.pairs_ns() }
    }
}

/// The subscribers of a slice. Dropping them ends those that are left.
pub struct Subscribers {
    processes: Vec<Process>,
}

struct Process {
    child: Child,
    said: BufReader<ChildStdout>,
    /// It was stopped or killed: what it says is no measurement.
    disturbed: bool,
}

/// What becomes of a subscriber within a slice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// It is stopped (SIGSTOP) for the rest of the slice.
    Stall,
    /// It is killed (SIGKILL).
    Kill,
}

impl Subscribers {
    /// Starts `count` of them; all are there when this returns.
    ///
    /// # Errors
    /// The program can't be started again (1); the instance can't be followed (4).
    pub fn start(instance: &str, count: usize) -> Result<Self, Failure> {
        let failed = |what: String| Failure::new(Kind::Internal, format!("subscriber process: {what}"));
        let program =
            std::env::current_exe().map_err(|e| failed(format!("expected to find this program, got \"{e}\"")))?;
        let mut subscribers = Subscribers { processes: Vec::with_capacity(count) };
        for _ in 0..count {
            let mut child = Command::new(&program)
                .args(["latency", OPTION, instance])
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .spawn()
                .map_err(|e| failed(format!("{}: expected to start it, got \"{e}\"", program.display())))?;
            let said = child.stdout.take().expect("it was asked to be a pipe");
            subscribers.processes.push(Process { child, said: BufReader::new(said), disturbed: false });
        }
        for process in &mut subscribers.processes {
            let line = process.line();
            if line != READY {
                let message = format!("subscriber process: expected {READY:?}, got {line:?}; its message stands above");
                return Err(Failure::new(Kind::Device, message));
            }
        }
        Ok(subscribers)
    }

    /// Stalls or kills subscriber `index`; nothing where it is gone already.
    pub fn disturb(&mut self, index: usize, disturbance: Disturbance) {
        if let Some(process) = self.processes.get_mut(index) {
            process.disturbed = true;
            process.signal(match disturbance {
                Disturbance::Stall => Signal::STOP,
                Disturbance::Kill => Signal::KILL,
            });
        }
    }

    /// What those say that were left in peace, after the run's end.
    ///
    /// # Errors
    /// One of them gave no figures (4).
    pub fn heard(mut self) -> Result<Vec<Heard>, Failure> {
        let mut heard = Vec::with_capacity(self.processes.len());
        for process in self.processes.iter_mut().filter(|p| !p.disturbed) {
            let line = process.line();
            heard.push(serde_json::from_str(&line).map_err(|e| {
                Failure::new(Kind::Device, format!("subscriber process: expected its figures, got {line:?}: {e}"))
            })?);
            // It has said all, and takes its leave; killed in the middle of that, it would leave half of a service behind.
            let _ = process.child.wait();
        }
        Ok(heard)
    }
}

impl Process {
    /// The next line; empty when the process has ended.
    fn line(&mut self) -> String {
        let mut line = String::new();
        // A pipe that can't be read says as little as one that is closed.
        let _ = self.said.read_line(&mut line);
        line.trim_end().to_owned()
    }

    fn signal(&self, signal: Signal) {
        // Nobody is disturbed after the run, so it was not waited for yet, and the number is still its own.
        if let Some(pid) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            let _ = kill_process(pid, signal);
        }
    }
}

impl Drop for Subscribers {
    fn drop(&mut self) {
        for process in &mut self.processes {
            // A stopped process dies of this too; to one that was waited for it is not sent.
            let _ = process.child.kill();
            let _ = process.child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_timed_from_its_wake_up_and_from_its_schedule() {
        let mut arrivals = Arrivals::default();
        for (lateness_ns, now_ns) in [(10_000, 1_040_000), (20_000, 1_060_000), (0, 1_030_000)] {
            arrivals.arrived(&Sample { woken_ns: 1_000_000, lateness_ns, ..Sample::BLANK }, now_ns);
        }
        let certificate = LossCertificate { received: 3, expected: 5, ..NOTHING };
        let said = serde_json::to_string(&arrivals.heard(&certificate)).expect("JSON");
        let heard: Heard = serde_json::from_str(&said).expect("what was said is understood");
        assert_eq!((heard.received, heard.expected), (3, 5));
        let near = |us: f64, expected: f64| assert!((us - expected).abs() < 0.2, "expected {expected}, got {us}");
        near(heard.from_woken().figures().p50, 40.0);
        near(heard.from_woken().figures().max, 60.0);
        near(heard.from_scheduled().figures().p50, 50.0);
        near(heard.from_scheduled().figures().max, 80.0);
    }
}
