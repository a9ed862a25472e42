//! The logger alone, against a publication that is driven by hand.

use bench::logger::{Logger, LoggerError};
use drivers::amplifier::Telemetry;
use drivers::telemetry::{AHEAD, Arrived, telemetry_log};
use recordings::{Event, Item, McapReader, Plane, Protocol, Role, RunMetadata, Severity};
use rt_core::{PERIOD_NS, Pace, Publication, Publish, Sample, flags};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(20);

fn metadata() -> RunMetadata {
    RunMetadata::new("run", Protocol::RandomSteps, Role::Identify, Plane::Horizontal)
}

fn sample(run: u32, tick: u64, last: bool) -> Sample {
    Sample {
        run,
        tick,
        scheduled_ns: tick * PERIOD_NS,
        voltage_v: 1.0,
        angle_deg: tick as f64,
        pressure1_bar: 2.0,
        pressure2_bar: 2.0,
        flags: if last { flags::LAST } else { 0 },
        ..Sample::BLANK
    }
}

/// Publishes these ticks as run `run`.
fn publish(publication: &mut Publication, run: u32, ticks: impl Iterator<Item = u64>, last: Option<u64>) {
    for tick in ticks {
        publication.publish(&sample(run, tick, Some(tick) == last));
    }
    publication.settle(PATIENCE).expect("the logger takes them");
}

fn start(instance: &str) -> (Publication, Logger) {
    // The process number keeps two test runs on one machine apart.
    let instance = format!("{instance}-{}", std::process::id());
    let publication = Publication::start(&instance, Pace::LOCKSTEP).expect("shared memory is there");
    let logger = Logger::start(&instance).expect("it subscribes");
    publication.wait_for_loggers(1, PATIENCE).expect("it is seen");
    (publication, logger)
}

#[test]
fn a_gap_is_certified_not_hidden_and_the_next_run_is_whole_again() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (mut publication, mut logger) = start("logger-gap");
    let seen = Arc::new(AtomicU64::new(0));

    let count = Arc::clone(&seen);
    logger
        .begin(0, dir.path().join("a.mcap"), metadata(), move |n| count.store(n, Ordering::SeqCst))
        .expect("a new file");
    publish(&mut publication, 0, (0..5000).filter(|t| !(1234..1240).contains(t)), Some(4999));
    let event = Event {
        tick: 7,
        scheduled_ns: 7 * PERIOD_NS,
        severity: Severity::Warning,
        source: "test".into(),
        text: "t".into(),
    };
    let recorded = logger.end(0, Some(5000), vec![event.clone()]).expect("closed");
    assert_eq!(recorded.certificate.to_string(), "4994 of 5000 samples; missing samples 1234..=1239");
    assert_eq!(seen.load(Ordering::SeqCst), 4994, "progress counts what is recorded");

    logger.begin(1, dir.path().join("b.mcap"), metadata(), |_| {}).expect("a new file");
    publish(&mut publication, 1, 0..3000, Some(2999));
    let recorded = logger.end(1, Some(3000), vec![]).expect("closed");
    assert!(recorded.certificate.is_lossless(), "{}", recorded.certificate);

    let items =
        McapReader::open(&dir.path().join("a.mcap")).expect("readable").collect::<Result<Vec<_>, _>>().expect("sound");
    assert!(items.iter().any(|item| matches!(item, Item::Event(e) if *e == event)), "the event is in the file");
    assert_eq!(items.len(), 4995);
}

#[test]
fn a_sample_that_no_recording_can_hold_is_left_out_certified_and_costs_no_other() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (mut publication, mut logger) = start("logger-infinite");
    let path = dir.path().join("a.mcap");
    logger.begin(0, path.clone(), metadata(), |_| {}).expect("a new file");
    publish(&mut publication, 0, 0..50, None);
    for tick in [50, 51] {
        publication.publish(&Sample { pressure1_bar: f64::INFINITY, ..sample(0, tick, false) });
    }
    publish(&mut publication, 0, 52..100, None);
    // The last one is refused, too: that it is the last is known all the same.
    publication.publish(&Sample { angle_deg: f64::NEG_INFINITY, ..sample(0, 100, true) });
    publication.settle(PATIENCE).expect("the logger takes it");
    let recorded = logger.end(0, Some(101), vec![]).expect("closed");
    let expected = "98 of 101 samples; missing samples 50..=51, 100..=100";
    assert_eq!(recorded.certificate.to_string(), expected);
    assert_eq!(recorded.refused.samples, 3);
    assert!(recorded.refused.first.contains("tick 50, pressure1_bar"), "{}", recorded.refused.first);
    let mut reader = McapReader::open(&path).expect("readable");
    let ticks = (&mut reader).filter_map(|item| match item.expect("sound") {
        Item::Sample(sample) => Some(sample.tick),
        _ => None,
    });
    assert!(ticks.eq((0..50).chain(52..100)));
    assert_eq!(reader.certificate().map(ToString::to_string).as_deref(), Some(expected));

    logger.begin(1, dir.path().join("b.mcap"), metadata(), |_| {}).expect("the logger goes on");
    publish(&mut publication, 1, 0..10, Some(9));
    let recorded = logger.end(1, Some(10), vec![]).expect("closed");
    assert!(recorded.certificate.is_lossless() && recorded.refused.samples == 0, "{}", recorded.certificate);
}

#[test]
fn a_run_whose_last_samples_are_lost_is_not_certified_whole() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (mut publication, mut logger) = start("logger-tail");
    logger.begin(0, dir.path().join("a.mcap"), metadata(), |_| {}).expect("a new file");
    publish(&mut publication, 0, 0..90, None);
    let recorded = logger.end(0, Some(100), vec![]).expect("closed");
    assert_eq!(recorded.certificate.to_string(), "90 of 100 samples; missing samples 90..=99");
}

#[test]
fn what_can_t_be_written_is_said() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(dir.path().join("a.mcap"), b"a measurement").expect("writable");
    let (_publication, mut logger) = start("logger-refused");
    let error = logger.begin(0, dir.path().join("a.mcap"), metadata(), |_| {}).expect_err("the file is there");
    assert!(matches!(error, LoggerError::Recording(_)), "{error}");
    assert!(error.to_string().contains("a.mcap"), "{error}");
    let error = logger.begin(1, dir.path().join("b.mcap"), metadata(), |_| {}).expect_err("the logger has ended");
    assert!(error.to_string().contains("ended"), "{error}");
    assert_eq!(std::fs::read(dir.path().join("a.mcap")).expect("still there"), b"a measurement");
}

#[test]
fn samples_of_a_run_that_was_not_announced_are_refused() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (mut publication, mut logger) = start("logger-other");
    logger.begin(3, dir.path().join("a.mcap"), metadata(), |_| {}).expect("a new file");
    publish(&mut publication, 4, 0..10, Some(9));
    let error = logger.end(3, Some(10), vec![]).expect_err("the samples are another run's");
    assert!(matches!(error, LoggerError::OtherRun { expected: 3, got: 4 }), "{error}");
    assert!(!dir.path().join("a.mcap").exists(), "nothing bears its name that is not whole");
}

const FULL_DISK: &str = "LOGGER_FULL_DISK";

/// The limit on the size of files stands for a full disk. It belongs to the whole process, so this needs one of its own.
#[test]
fn a_full_disk_is_told_at_once_and_the_run_goes_on_unrecorded() {
    let Ok(instance) = std::env::var(FULL_DISK) else {
        let mut command = Command::new(std::env::current_exe().expect("this test"));
        command.args(["--exact", "a_full_disk_is_told_at_once_and_the_run_goes_on_unrecorded"]);
        command.env(FULL_DISK, format!("logger-full-{}", std::process::id())).stdin(Stdio::null());
        let output = command.output().expect("this test starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let told = Arc::new(Mutex::new(Vec::new()));
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).expect("shared memory is there");
    let hear = Arc::clone(&told);
    let on_cut = move |cut: &recordings::CutShort| hear.lock().expect("nobody panics with it").push(cut.to_string());
    let mut logger = Logger::start_with(&instance, on_cut).expect("it subscribes");
    publication.wait_for_loggers(1, PATIENCE).expect("it is seen");
    logger.begin(0, dir.path().join("a.mcap"), metadata(), |_| {}).expect("a new file");
    limit_file_size(100_000);
    publish(&mut publication, 0, 0..8_000, None);
    // Before the run is over: who drives the rig may want to end it.
    let begin = std::time::Instant::now();
    while told.lock().expect("nobody panics with it").is_empty() {
        assert!(begin.elapsed() < PATIENCE, "nobody is told");
        std::thread::sleep(Duration::from_millis(5));
    }
    publish(&mut publication, 0, 8_000..9_000, Some(8_999));
    let recorded = logger.end(0, Some(9_000), vec![]).expect("closed");
    let cut = recorded.cut_short.expect("it was cut short");
    let kept = cut.certificate.received;
    assert!(cut.closed && kept > 500 && kept < 8_000, "{cut}");
    assert_eq!(recorded.certificate.to_string(), format!("{kept} of 9000 samples; missing samples {kept}..=8999"));
    assert_eq!(recorded.path, dir.path().join("a.mcap"));
    let told = told.lock().expect("nobody panics with it").clone();
    assert_eq!(told, [cut.to_string()], "once");
    assert!(told[0].contains("a.mcap") && told[0].contains("File too large"), "{told:?}");
    let items = McapReader::open(&recorded.path).expect("readable").collect::<Result<Vec<_>, _>>().expect("sound");
    assert_eq!(items.len() as u64, kept + 1, "the samples, and an event that says why they end");

    // Once there is room again, the next run is recorded.
    limit_file_size(libc::RLIM_INFINITY);
    logger.begin(1, dir.path().join("b.mcap"), metadata(), |_| {}).expect("a new file");
    publish(&mut publication, 1, 0..3_000, Some(2_999));
    assert!(logger.end(1, Some(3_000), vec![]).expect("closed").certificate.is_lossless());
}

fn limit_file_size(bytes: u64) {
    let limit = libc::rlimit { rlim_cur: bytes, rlim_max: libc::RLIM_INFINITY };
    // SAFETY: plain system calls; this process runs one test, which expects what they do.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        assert_eq!(libc::setrlimit(libc::RLIMIT_FSIZE, &raw const limit), 0);
    }
}

#[test]
fn the_amplifier_s_reports_stand_in_the_recording_and_what_is_missing_is_said() {
    const ORIGIN_NS: u64 = 55_000_000_000;
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (mut publication, mut logger) = start("logger-reports");
    let (mut log, reader) = telemetry_log();
    logger.record_amplifier(reader).expect("it runs");
    let mut at = |since_origin_ns: u64, speed_rpm: f32| {
        let telemetry = Telemetry { speed_rpm, ..Telemetry::UNTOLD };
        log.note(Arrived { received_ns: ORIGIN_NS + since_origin_ns, telemetry });
    };
    let mut run = |number: u32, publication: &mut Publication, logger: &mut Logger| {
        let path = dir.path().join(format!("{number}.mcap"));
        logger.begin(number, path.clone(), metadata(), |_| {}).expect("a new file");
        let reports = if number == 0 { 300 } else { AHEAD as u64 + 5 };
        (0..reports).for_each(|n| at(n * PERIOD_NS / if number == 0 { 1 } else { 100 } + 250, n as f32));
        for tick in 0..300 {
            let woken_ns = ORIGIN_NS + tick * PERIOD_NS + 40;
            let sample = Sample { woken_ns, lateness_ns: 40, ..sample(number, tick, tick == 299) };
            publication.publish(&sample);
        }
        publication.settle(PATIENCE).expect("the logger takes them");
        let recorded = logger.end(number, Some(300), vec![]).expect("closed");
        let items: Vec<Item> = McapReader::open(&path).expect("ours").map(|item| item.expect("sound")).collect();
        (recorded, items)
    };
    let (recorded, items) = run(0, &mut publication, &mut logger);
    assert_eq!(recorded.lost_reports, 0);
    let expected = (0..300u64).flat_map(|n| [(false, n), (true, n)]);
    let got = items.iter().map(|item| match item {
        Item::Sample(sample) => (false, sample.tick),
        Item::Amplifier(report) => {
            assert_eq!((report.arrived_ns, report.speed_rpm), (report.tick * PERIOD_NS + 250, report.tick as f64));
            (true, report.tick)
        }
        Item::Event(event) => panic!("{event:?}"),
    });
    assert!(got.eq(expected), "each report after the sample of its tick");

    let (recorded, items) = run(1, &mut publication, &mut logger);
    assert_eq!(recorded.lost_reports, 5);
    assert_eq!(items.iter().filter(|item| matches!(item, Item::Amplifier(_))).count(), AHEAD);
    let said = |item: &Item| matches!(item, Item::Event(event) if event.text.contains("5 reports"));
    assert!(items.iter().any(said) && recorded.certificate.is_lossless());
}
