//! `bench record` as a process of its own: nothing lost where nothing has to be, every loss certified, no stall hangs it.
//! Each test has an instance of its own, named after the process, so that several test runs may go on at once.

mod recorder;

use recorder::{FileLimit, PATIENCE, Recorder, folder, hasty_publication, instance, publication, publish, read};
use recordings::{McapReader, Plane, Protocol, Recording, Role};
use rt_core::{CommandServer, Switches};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

#[test]
fn every_sample_of_every_run_is_recorded_one_file_a_run() {
    let (dir, out) = folder();
    let instance = instance("whole");
    let mut publication = publication(&instance);
    let said = ["--runs", "2", "--protocol", "square-wave", "--role", "identify", "--plane", "vertical"];
    let mut recorder = Recorder::start(&out, &instance, &said, None);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    publish(&mut publication, 0, 0..3_000, Some(2_999));
    publish(&mut publication, 1, 0..1_234, Some(1_233));
    recorder.wait_for("a-2.mcap");
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.contains("run 0: 3000 of 3000 samples") && stdout.contains("run 1: 1234 of 1234 samples"),
        "{stdout}"
    );
    let second = dir.path().join("a-2.mcap");
    assert_eq!(Recording::read(&out, Protocol::SquareWave).expect("data").len(), 3_000);
    assert_eq!(Recording::read(&second, Protocol::SquareWave).expect("data").len(), 1_234);
    let reader = McapReader::open(&second).expect("a recording");
    let run = reader.run();
    assert_eq!((run.name.as_str(), run.role, run.plane), ("a-2", Role::Identify, Plane::Vertical));
    assert_eq!(run.notes["instance"], instance);
}

#[test]
fn a_run_that_is_joined_late_lacks_its_beginning_and_says_so() {
    let (_dir, out) = folder();
    let instance = instance("late");
    let mut publication = publication(&instance);
    publish(&mut publication, 0, 0..500, None);
    let recorder = Recorder::start(&out, &instance, &[], None);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    publish(&mut publication, 0, 500..2_000, Some(1_999));
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 6, "{stderr}");
    assert!(stdout.contains("1500 of 2000 samples; missing samples 0..=499"), "{stdout}");
    assert!(stderr.contains("was under way") && stderr.contains("missing: samples 0 to 499 (500)"), "{stderr}");
    let (samples, certificate) = read(&out);
    assert!(samples.iter().copied().eq(500..2_000));
    assert_eq!(certificate.gaps, [(0, 499)]);
}

#[test]
fn five_seconds_of_stall_lose_nothing_and_what_is_beyond_the_buffer_is_certified() {
    let (dir, out) = folder();
    let instance = instance("stall");
    let mut publication = hasty_publication(&instance);
    let mut recorder = Recorder::start(&out, &instance, &["--runs", "2"], None);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    publish(&mut publication, 0, 0..1_000, None);
    recorder.wait_for("recording to");
    recorder.signal(libc::SIGSTOP);
    publish(&mut publication, 0, 1_000..6_000, None); // 5 s at 1 kHz
    recorder.signal(libc::SIGCONT);
    publish(&mut publication, 0, 6_000..6_001, Some(6_000));

    publish(&mut publication, 1, 0..1, None);
    recorder.wait_for("a-2.mcap");
    recorder.signal(libc::SIGSTOP);
    publish(&mut publication, 1, 1..12_000, None); // more than the buffer holds
    recorder.signal(libc::SIGCONT);
    publish(&mut publication, 1, 12_000..12_001, Some(12_000));
    let (code, stdout, stderr) = recorder.end();
    assert!(stdout.contains("run 0: 6001 of 6001 samples"), "{stdout}");
    assert_eq!(code, 6, "{stderr}");
    let (samples, certificate) = read(&dir.path().join("a-2.mcap"));
    assert!(certificate.end_seen && certificate.expected == 12_001, "{certificate}");
    let missing: u64 = certificate.gaps.iter().map(|(first, last)| last - first + 1).sum();
    assert_eq!(samples.len() as u64 + missing, 12_001);
    assert!(missing > 0 && samples.len() >= rt_core::link::BUFFER_SAMPLES, "the buffer was kept: {certificate}");
    assert!(certificate.gaps.iter().all(|(first, last)| !samples.iter().any(|s| (first..=last).contains(&s))));
    assert!(stderr.contains("were lost; the gap is certified"), "{stderr}");
}

#[test]
fn a_recorder_that_is_interrupted_closes_what_it_has() {
    let (_dir, out) = folder();
    let instance = instance("interrupt");
    let mut publication = publication(&instance);
    let mut recorder = Recorder::start(&out, &instance, &[], None);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    publish(&mut publication, 0, 0..700, None);
    recorder.wait_for("recording to");
    recorder.signal(libc::SIGINT);
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 130, "{stderr}");
    assert!(stdout.contains("of at least") && stdout.contains("the end of the run did not arrive"), "{stdout}");
    let (samples, certificate) = read(&out);
    assert!(!certificate.end_seen && samples.len() as u64 == certificate.received);
}

#[test]
fn a_recorder_that_waits_for_runs_ends_on_ctrl_c_without_complaint() {
    let (_dir, out) = folder();
    let instance = instance("runs");
    let mut publication = publication(&instance);
    let recorder = Recorder::start(&out, &instance, &["--runs", "0"], None);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    publish(&mut publication, 0, 0..100, Some(99));
    let begin = Instant::now();
    while !out.exists() {
        assert!(begin.elapsed() < PATIENCE, "the recording is never closed");
        thread::sleep(Duration::from_millis(10));
    }
    recorder.signal(libc::SIGINT);
    let (code, stdout, stderr) = recorder.end();
    assert_eq!((code, stdout.contains("run 0: 100 of 100 samples")), (0, true), "{stdout}{stderr}");
}

/// Hears demands on this instance while `body` runs.
fn hearing<T>(instance: &str, body: impl FnOnce(&Switches) -> T) -> T {
    let switches = Switches::new();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        let (ready, opened) = mpsc::channel();
        scope.spawn(|| {
            let ready = ready; // the channel closes should the listener not open
            let mut server = CommandServer::open(instance).expect("shared memory is there");
            ready.send(()).expect("the test waits");
            while !over.load(Ordering::Relaxed) {
                server.serve(Duration::from_millis(10), &switches, &String::new).expect("it listens");
            }
        });
        opened.recv().expect("it listens");
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| body(&switches)));
        over.store(true, Ordering::Relaxed);
        result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Room for some thousands of samples; the transport's own files are smaller.
const SMALL_DISK: FileLimit = Some(600_000);

#[test]
fn a_full_disk_ends_the_run_where_that_is_asked_for_and_the_file_stays_readable() {
    let (_dir, out) = folder();
    let instance = instance("full-stop");
    let mut publication = publication(&instance);
    let recorder = Recorder::start(&out, &instance, &["--on-full", "stop"], SMALL_DISK);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    let ran = hearing(&instance, |switches| {
        let begin = Instant::now();
        let mut tick = 0;
        while !switches.stop.load(Ordering::Relaxed) {
            assert!(begin.elapsed() < PATIENCE, "nobody asks for a stop");
            publish(&mut publication, 0, tick..tick + 100, None);
            tick += 100;
            thread::sleep(Duration::from_millis(1));
        }
        publish(&mut publication, 0, tick..tick + 1, Some(tick));
        tick + 1
    });
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 6, "{stderr}");
    for word in ["a.mcap", "File too large", "make room", "asked to stop", "is closed: readable"] {
        assert!(stderr.contains(word), "{word:?} is not in: {stderr}");
    }
    assert_eq!(stderr.matches("could not be closed").count(), 0, "{stderr}");
    assert!(stdout.contains(&format!("of {ran} samples")), "{stdout}");
    let (samples, certificate) = read(&out);
    assert!(samples.len() > 1_000 && samples.iter().copied().eq(0..samples.len() as u64), "{}", samples.len());
    assert!(!certificate.end_seen && certificate.received == samples.len() as u64);
}

#[test]
fn a_full_disk_lets_the_run_go_on_where_nothing_else_is_asked_for() {
    let (_dir, out) = folder();
    let instance = instance("full-go-on");
    let mut publication = publication(&instance);
    let mut recorder = Recorder::start(&out, &instance, &[], SMALL_DISK);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    let asked = hearing(&instance, |switches| {
        let mut tick = 0;
        while !recorder.said.contains("the run goes on unrecorded") {
            publish(&mut publication, 0, tick..tick + 500, None);
            tick += 500;
            assert!(tick < 100_000, "the disk does not run full: {}", recorder.said);
            if let Ok(line) = recorder.says.recv_timeout(Duration::from_millis(20)) {
                recorder.said.push_str(&format!("{line}\n"));
            }
        }
        publish(&mut publication, 0, tick..tick + 3_000, Some(tick + 2_999));
        switches.stop.load(Ordering::Relaxed)
    });
    assert!(!asked);
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 6, "{stderr}");
    let (samples, _) = read(&out);
    assert!(stdout.contains(&format!("{} of ", samples.len())) && stdout.contains("missing samples"), "{stdout}");
}

#[test]
fn a_gap_ends_the_run_where_that_is_asked_for() {
    let (_dir, out) = folder();
    let instance = instance("gap-stop");
    let mut publication = publication(&instance);
    let recorder = Recorder::start(&out, &instance, &["--on-gap", "stop"], None);
    publication.wait_for_loggers(1, PATIENCE).expect("it subscribes");
    hearing(&instance, |switches| {
        publish(&mut publication, 0, 0..300, None);
        publish(&mut publication, 0, 310..400, None);
        let begin = Instant::now();
        while !switches.stop.load(Ordering::Relaxed) {
            assert!(begin.elapsed() < PATIENCE, "nobody asks for a stop");
            thread::sleep(Duration::from_millis(5));
        }
        publish(&mut publication, 0, 400..401, Some(400));
    });
    let (code, stdout, stderr) = recorder.end();
    assert_eq!(code, 6, "{stderr}");
    assert!(stdout.contains("391 of 401 samples; missing samples 300..=309"), "{stdout}");
    assert!(stderr.contains("samples 300..=309 were lost") && stderr.contains("asked to stop"), "{stderr}");
}

#[test]
fn what_can_t_be_recorded_to_is_refused_before_a_run_begins() {
    let (dir, out) = folder();
    std::fs::write(&out, b"a measurement").expect("writable");
    std::fs::write(dir.path().join("b.mcap.part"), b"a measurement").expect("writable");
    for (name, word) in
        [("a.mcap", "exists"), ("b.mcap", "bench recover"), ("c.csv", ".mcap"), ("no/d.mcap", "no folder")]
    {
        let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
        let output = command.args(["record", "--out"]).arg(dir.path().join(name)).output().expect("the program starts");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && stderr.contains(word), "{name}: {stderr}");
    }
    assert_eq!(std::fs::read(&out).expect("still there"), b"a measurement");
}
