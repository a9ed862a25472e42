//! From its first tick to its last, the loop's thread in real time makes no system call but its sleep. Not counted but enforced:
//! the thread runs under a filter of the kernel that kills the process at any other call.
//!
//! The filter can't be taken off again, so each run has a process of its own: this test binary once more.

use bench::controller::PumpController;
use bench::emulation::rig_for;
use model::{ModelFile, Parameters};
use profiles::{BUILTIN, Context, Playback, Script};
use rt_core::system::time::{monotonic_ns, sleep_until_ns};
use rt_core::{
    Controller, Delivery, Ended, Limits, Measurement, OverrunPolicy, Pace, Publication, RealTime, Reference, Run,
    RunReport, SampleSubscriber, Stages, Step, Supervisor, Switches, Tick,
};
use seccompiler::{BpfProgram, SeccompAction, SeccompFilter, TargetArch};
use std::io::Write;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Periods of the filtered run.
const PERIODS: u64 = 2_000;
/// The careless controller writes at this tick, or at the first one after it that is run.
const WRITES_AT: u64 = 500;
/// Longer than anything here takes on a busy machine.
const SOON: Duration = Duration::from_secs(60);

/// Set for the process under the filter: what it does there.
const PART: &str = "BENCH_TEST_UNDER_A_FILTER";
/// Set for it too: the name that it publishes under.
const INSTANCE: &str = "BENCH_TEST_INSTANCE";
/// Set for it where reading the clock is a system call.
const CLOCK_IS_A_CALL: &str = "BENCH_TEST_CLOCK_IS_A_CALL";

/// Kills the process at the first system call of this thread that is not the sleep.
fn filter_this_thread() {
    let mut allowed = vec![libc::SYS_clock_nanosleep];
    if std::env::var_os(CLOCK_IS_A_CALL).is_some() {
        allowed.push(libc::SYS_clock_gettime);
    }
    let arch = TargetArch::try_from(std::env::consts::ARCH).expect("an architecture that the filter knows");
    let rules = allowed.into_iter().map(|call| (call, Vec::new())).collect();
    let filter = SeccompFilter::new(rules, SeccompAction::KillProcess, SeccompAction::Allow, arch).expect("a filter");
    let program: BpfProgram = filter.try_into().expect("a program");
    // What is computed once, at the first reading, is no part of the loop.
    let _ = monotonic_ns();
    seccompiler::apply_filter(&program).expect("seccomp: expected a kernel that takes filters (CONFIG_SECCOMP_FILTER)");
    // Freeing it might be a system call.
    std::mem::forget(program);
}

/// The profile, cut to [`PERIODS`].
struct Cut(Playback);

impl Reference for Cut {
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
        let step = self.0.step(now, measured);
        Step { last: step.last || now.index + 1 >= PERIODS, ..step }
    }
}

/// The bench's controller, which may say a word in between.
struct Talkative {
    inner: PumpController,
    writes: bool,
}

impl Controller for Talkative {
    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64 {
        if self.writes && now.index >= WRITES_AT {
            self.writes = false;
            let _ = rustix::io::write(std::io::stderr(), b"tick\n");
        }
        self.inner.control(now, measured, step)
    }
}

/// What the filtered thread can still say when the run is over.
static SAID: AtomicU64 = AtomicU64::new(0);
const COMPLETED: u64 = 1 << 63;

fn say(report: &RunReport) {
    let periods = report.statistics.ticks + report.statistics.skipped;
    let completed = if report.ended == Ended::Completed { COMPLETED } else { 0 };
    SAID.store(completed | periods, Ordering::Release);
}

fn park() -> ! {
    loop {
        sleep_until_ns(monotonic_ns() + 1_000_000_000);
    }
}

/// The loop as `bench run --realtime` has it, on a thread under the filter. Never returns: neither could the thread end.
fn drive(instance: &str, writes: bool, ready: &mpsc::Sender<()>) -> ! {
    let truth = ModelFile::plain(Parameters::example());
    let (file, text) = BUILTIN.iter().find(|(file, _)| *file == "square_h.toml").expect("a built-in script");
    let script = Script::parse(text, file).expect("parses");
    let context = Context { u_max_v: truth.parameters.pump.u_max, seed: 1, hands: profiles::Hands::Rig };
    let mut reference = Cut(script.compile(&context).expect("compiles"));
    let mut rig = rig_for(&truth, &script, 1, 0).expect("a rig");
    let mut controller = Talkative { inner: PumpController::with_pump(truth.parameters.pump), writes };
    let mut publication = Publication::start(instance, Pace::RealTime).expect("shared memory");
    let mut supervisor = Supervisor::new(Limits::default()).expect("limits");
    let (mut flight, _log) = rt_core::flight::recorder();
    let switches = Switches::new();
    ready.send(()).expect("somebody waits");

    filter_this_thread();
    let stages = Stages {
        clock: &mut RealTime::default(),
        device: &mut rig,
        operator: &mut &switches,
        supervisor: &mut supervisor,
        reference: &mut reference,
        controller: &mut controller,
        publish: &mut publication,
        flight: &mut flight,
    };
    if let Ok(report) = rt_core::run(stages, Run { number: 0, overrun: OverrunPolicy::Skip }) {
        say(&report);
    }
    park()
}

/// What the process does beside its filtered thread: it hears the samples, and judges.
fn watch(instance: &str, writes: bool) -> Result<String, String> {
    let mut subscriber = SampleSubscriber::open(instance, Delivery::BestEffort).map_err(|e| e.to_string())?;
    let (ready, began) = mpsc::channel();
    let publish_on = instance.to_owned();
    std::thread::spawn(move || drive(&publish_on, writes, &ready));
    began.recv_timeout(SOON).map_err(|e| format!("the loop did not begin: {e}"))?;
    let begin = Instant::now();
    let mut samples = Vec::new();
    let certificate = loop {
        if begin.elapsed() >= SOON {
            return Err(format!("{} samples, and no end", samples.len()));
        }
        subscriber.receive(Duration::from_millis(50), &mut samples).map_err(|e| e.to_string())?;
        if let Some(certificate) = subscriber.take_certificate() {
            break certificate;
        }
    };
    while SAID.load(Ordering::Acquire) == 0 {
        if begin.elapsed() >= SOON {
            return Err("the run's samples ended, the run did not".to_owned());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let said = SAID.load(Ordering::Acquire);
    if said != COMPLETED | PERIODS || !certificate.is_lossless() {
        return Err(format!("completed {}, {} periods, {certificate}", said & COMPLETED != 0, said & !COMPLETED));
    }
    Ok(certificate.to_string())
}

/// Not a test of its own: the process under the filter.
#[test]
fn play_the_part_under_the_filter() {
    let Ok(part) = std::env::var(PART) else { return };
    let instance = std::env::var(INSTANCE).unwrap_or_default();
    let outcome = match part.as_str() {
        "clock" => {
            let thread = std::thread::spawn(|| {
                filter_this_thread();
                let mut latest_ns = 0;
                for _ in 0..10_000 {
                    latest_ns = monotonic_ns().max(latest_ns);
                }
                SAID.store(latest_ns, Ordering::Release);
                park()
            });
            while SAID.load(Ordering::Acquire) == 0 {
                std::thread::sleep(Duration::from_millis(1));
            }
            drop(thread);
            Ok("read".to_owned())
        }
        "loop" => watch(&instance, false),
        _ => watch(&instance, true),
    };
    // The filtered thread can't end by itself; the process can.
    let mut stderr = std::io::stderr();
    let _ = match &outcome {
        Ok(said) => writeln!(stderr, "under the filter: {said}"),
        Err(error) => writeln!(stderr, "under the filter: {error}"),
    };
    std::process::exit(if outcome.is_ok() { 0 } else { 1 });
}

/// Starts this test binary once more. Its status, and what it said.
fn under_the_filter(part: &str, clock_is_a_call: bool) -> (ExitStatus, String) {
    let instance = format!("filter-{}-{part}", std::process::id());
    let mut process = Command::new(std::env::current_exe().expect("this test"));
    process.args(["--exact", "play_the_part_under_the_filter", "--nocapture"]);
    process.env(PART, part).env(INSTANCE, &instance).stdout(Stdio::null());
    if clock_is_a_call {
        process.env(CLOCK_IS_A_CALL, "1");
    }
    let output = process.output().expect("this test, once more");
    // It leaves by force: whoever publishes next under this name tidies up.
    Publication::start(&instance, Pace::RealTime).expect("a free instance").stop().expect("stops");
    (output.status, String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Whether reading the clock is a system call on this machine: then the loop makes that one too, and it is said on a channel that
/// the test harness does not swallow.
fn clock_is_a_call() -> bool {
    let (status, said) = under_the_filter("clock", false);
    let killed = status.signal() == Some(libc::SIGSYS);
    assert!(killed || status.success(), "{status}: {said}");
    if killed {
        let _ = writeln!(
            std::io::stderr(),
            "\nWARNING: on this machine clock_gettime(CLOCK_MONOTONIC) is a system call (its clock source is not served by the \
             vDSO; see /sys/devices/system/clocksource/clocksource0/current_clocksource). The loop was tested with that call \
             allowed: its thread makes ten system calls a tick instead of one.\n"
        );
    }
    killed
}

#[test]
fn the_loop_makes_no_system_call_but_its_sleep() {
    let clock_is_a_call = clock_is_a_call();
    let (status, said) = under_the_filter("loop", clock_is_a_call);
    assert!(status.success(), "{status} (signal {}: a forbidden call): {said}", libc::SIGSYS);
    assert!(said.contains("samples"), "{said}");

    // The control: the same, but for one write in one tick.
    let (status, said) = under_the_filter("loop-that-writes", clock_is_a_call);
    assert_eq!(status.signal(), Some(libc::SIGSYS), "{status}: one write must be one too many; {said}");
    assert!(!said.contains("tick"), "the call itself was stopped: {said}");
}
