//! The logger alone, against a publication that is driven by hand.

use bench::logger::{Logger, LoggerError};
use recordings::{Event, Item, McapReader, Plane, Protocol, Role, RunMetadata, Severity};
use rt_core::{Measurement, PERIOD_NS, Pace, Publication, Publish, SAMPLE_VERSION, Sample, flags};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(20);

fn metadata() -> RunMetadata {
    RunMetadata {
        name: "run".into(),
        protocol: Protocol::RandomSteps,
        role: Role::Identify,
        plane: Plane::Horizontal,
        profile: String::new(),
        notes: Default::default(),
    }
}

fn sample(run: u32, tick: u64, last: bool) -> Sample {
    let Measurement { torque_nm, volume_ml, .. } = Measurement::NONE;
    Sample {
        version: SAMPLE_VERSION,
        run,
        tick,
        scheduled_ns: tick * PERIOD_NS,
        lateness_ns: 0,
        input_age_ns: 0,
        voltage_v: 1.0,
        angle_deg: tick as f64,
        pressure1_bar: 2.0,
        pressure2_bar: 2.0,
        torque_nm,
        volume_ml,
        segment: 0,
        flags: if last { flags::LAST } else { 0 },
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
    assert_eq!(recorded.certificate.to_string(), "4994 of 5000 samples; missing ticks 1234..=1239");
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
fn a_run_whose_last_samples_are_lost_is_not_certified_whole() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (mut publication, mut logger) = start("logger-tail");
    logger.begin(0, dir.path().join("a.mcap"), metadata(), |_| {}).expect("a new file");
    publish(&mut publication, 0, 0..90, None);
    let recorded = logger.end(0, Some(100), vec![]).expect("closed");
    assert_eq!(recorded.certificate.to_string(), "90 of 100 samples; missing ticks 90..=99");
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
