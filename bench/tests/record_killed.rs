//! SIGKILL of the recorder and SIGKILL of the service, in real time: what was recorded stays, and nobody waits for the dead.

mod recorder;

use recorder::{PATIENCE, Recorder, folder, hasty_publication, instance, publish, read};
use rt_core::{
    Command as RigCommand, Delivery, Device, DeviceError, Fixture, Limits, Measurement, OpenLoop, OverrunPolicy, Pace,
    Publication, RealTime, Reference, Run, SampleSubscriber, Stages, Step, Supervisor, Switches, Target, Tick,
};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

/// A rig on which nothing happens.
struct Still;

impl Device for Still {
    fn read(&mut self, _now: Tick) -> Result<Measurement, DeviceError> {
        Ok(Measurement { angle_deg: 0.0, pressure1_bar: 2.0, pressure2_bar: 2.0, ..Measurement::NONE })
    }

    fn write(&mut self, _now: Tick, _command: &RigCommand) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// Rest, until it is stopped.
struct Rest;

impl Reference for Rest {
    fn step(&mut self, _now: Tick, _measured: &Measurement) -> Step {
        Step {
            target: Target::VoltageV(0.0),
            brake_open: false,
            bypass_open: true,
            fixture: Fixture::Free,
            segment: 0,
            index: 0,
            last: false,
            waiting: None,
            hands_on: false,
        }
    }
}

/// Runs the loop in real time until the switches stop it.
fn run_in_real_time(publication: &mut Publication, number: u32, switches: &Switches) {
    let mut supervisor = Supervisor::new(Limits::default()).expect("limits that can be enforced");
    let (mut flight, _log) = rt_core::flight::recorder();
    let stages = Stages {
        clock: &mut RealTime::default(),
        device: &mut Still,
        operator: &mut &*switches,
        supervisor: &mut supervisor,
        reference: &mut Rest,
        controller: &mut OpenLoop,
        publish: publication,
        flight: &mut flight,
    };
    rt_core::run(stages, Run { number, overrun: OverrunPolicy::Skip }).expect("nothing fails on this rig");
    publication.settle(PATIENCE).expect("the publication goes on");
}

/// Follows the samples of an instance as a monitor does.
struct Monitor {
    subscriber: SampleSubscriber,
    newest: Option<u64>,
}

impl Monitor {
    fn of(instance: &str) -> Monitor {
        let subscriber = SampleSubscriber::open(instance, Delivery::BestEffort).expect("shared memory is there");
        Monitor { subscriber, newest: None }
    }

    /// Waits until so many samples more than now were published; the number of the newest one.
    fn after(&mut self, samples: u64) -> u64 {
        let begin = Instant::now();
        let mut received = Vec::new();
        let mut until = self.newest.map(|newest| newest + samples);
        loop {
            assert!(begin.elapsed() < PATIENCE, "no samples come");
            received.clear();
            self.subscriber.receive(Duration::from_millis(100), &mut received).expect("samples");
            let Some(newest) = received.last().map(rt_core::Sample::sequence) else { continue };
            self.newest = Some(newest);
            if newest >= *until.get_or_insert(newest + samples) {
                return newest;
            }
        }
    }
}

/// Recovers an unfinished recording with the program; the numbers of its samples.
fn recovered(part: &Path) -> Vec<u64> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    let output = command.arg("recover").arg(part).output().expect("the program starts");
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{stderr}");
    assert!(stdout.contains("the end of the run did not arrive"), "{stdout}");
    assert!(part.exists(), "what was damaged stays as it was");
    let (samples, certificate) = read(&part.with_extension(""));
    assert!(!certificate.end_seen && certificate.received == samples.len() as u64);
    samples
}

#[test]
fn a_recorder_that_is_killed_loses_one_second_at_most_and_the_service_does_not_care() {
    let (dir, _) = folder();
    let instance = instance("killed");
    let switches = Switches::new();
    let mut publication = hasty_publication(&instance);
    thread::scope(|scope| {
        // Thrown when the test fails, too: the scope waits for the loop.
        let _stop = StopOnDrop(&switches);
        let mut monitor = Monitor::of(&instance);
        scope.spawn(|| run_in_real_time(&mut publication, 0, &switches));
        for (kill, span) in [1_100, 1_610, 1_270, 1_850].into_iter().enumerate() {
            let out = dir.path().join(format!("{kill}.mcap"));
            let mut recorder = Recorder::start(&out, &instance, &[], None);
            recorder.wait_for("recording to");
            let newest = monitor.after(span);
            recorder.signal(libc::SIGKILL);
            assert_eq!(recorder.end().0, -libc::SIGKILL);
            let samples = recovered(&dir.path().join(format!("{kill}.mcap.part")));
            let (first, last) = (samples[0], *samples.last().expect("a chunk was complete"));
            assert_eq!(samples.len() as u64, last - first + 1, "no hole within");
            let missing = newest.saturating_sub(last);
            println!("kill {kill}: {} samples recovered, {missing} missing", samples.len());
            assert!(missing <= 1_000, "{missing} samples are missing");
        }
        let newest = monitor.after(100);
        assert!(newest > 0, "the run goes on");
    });
}

struct StopOnDrop<'a>(&'a Switches);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.stop.store(true, Ordering::Relaxed);
    }
}

const SERVICE_INSTANCE: &str = "RECORD_KILLED_SERVICE";

/// The service of the test below, when this binary is started again by it.
#[test]
fn service_process() {
    let Ok(instance) = std::env::var(SERVICE_INSTANCE) else { return };
    let mut publication = Publication::start(&instance, Pace::RealTime).expect("shared memory is there");
    publication.wait_for_loggers(1, PATIENCE).expect("the recorder subscribes");
    // Until it is killed; by itself it ends some time after the test has given up.
    let switches = Switches::new();
    thread::scope(|scope| {
        scope.spawn(|| {
            thread::sleep(2 * PATIENCE);
            switches.stop.store(true, Ordering::Relaxed);
        });
        run_in_real_time(&mut publication, 0, &switches);
    });
}

/// Ends with the test, whatever its outcome.
struct Service(Child);

impl Drop for Service {
    fn drop(&mut self) {
        // It may be dead already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_recorder_whose_service_is_killed_closes_the_recording_and_says_so() {
    let (dir, out) = folder();
    let instance = instance("orphan");
    let recorder = Recorder::start(&out, &instance, &["--runs", "2"], None);
    let mut monitor = Monitor::of(&instance);
    let mut command = Command::new(std::env::current_exe().expect("this test"));
    command.args(["--exact", "service_process"]).env(SERVICE_INSTANCE, &instance);
    let mut service = Service(command.stdin(Stdio::null()).stdout(Stdio::null()).spawn().expect("this test starts"));
    let newest = monitor.after(1_500);
    service.0.kill().expect("our own child");
    service.0.wait().expect("our own child");

    let mut recorder = recorder;
    recorder.wait_for("recording to");
    let begin = Instant::now();
    while !out.exists() {
        assert!(begin.elapsed() < PATIENCE, "the recording is never closed");
        thread::sleep(Duration::from_millis(20));
    }
    let (samples, certificate) = read(&out);
    assert!(!certificate.end_seen && certificate.gaps.is_empty(), "{certificate}");
    assert!(samples.len() as u64 > newest, "what was published before it died is there: {certificate}");

    // The next start cleans up after the dead and is recorded by the same recorder.
    let mut publication = hasty_publication(&instance);
    publication.wait_for_loggers(1, PATIENCE).expect("the recorder is still there");
    publish(&mut publication, 0, 0..500, Some(499));
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 6, "{stderr}");
    assert!(stdout.contains("run 0: 500 of 500 samples"), "{stdout}");
    assert!(stderr.contains("the service is gone") && stderr.contains("a.mcap"), "{stderr}");
    assert_eq!(read(&dir.path().join("a-2.mcap")).0.len(), 500);
}
