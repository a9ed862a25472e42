//! Processes that are killed: neither a logger nor a service leaves anything in the way of the others.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use std::collections::BTreeSet;
use std::fs::File;
use std::path::PathBuf;
use std::process::{Child, Command as Process, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use common::logger::{SOON, assert_all_there, instance, logger, publish_run, sample};
use rt_core::{Delivery, LossCertificate, Pace, Publication, Publish, SampleSubscriber};

/// Set for the process that plays the logger to be killed.
const PLAY_LOGGER: &str = "RT_CORE_TEST_PLAY_LOGGER";

/// Not a test of its own: the other process of the test below, which takes a few samples and then stands still.
#[test]
fn play_a_logger_in_a_process_of_its_own() {
    let Ok(instance) = std::env::var(PLAY_LOGGER) else { return };
    let mut subscriber = SampleSubscriber::open(&instance, Delivery::Lossless).unwrap();
    let mut samples = Vec::new();
    while samples.is_empty() {
        subscriber.receive(Duration::from_millis(100), &mut samples).unwrap();
    }
    thread::sleep(SOON * 4);
}

/// Set for the process that plays the service to be killed.
const PLAY_SERVICE: &str = "RT_CORE_TEST_PLAY_SERVICE";

/// Not a test of its own: the other process of a test below, which publishes the first half of run 0.
#[test]
fn play_a_service_in_a_process_of_its_own() {
    let Ok(instance) = std::env::var(PLAY_SERVICE) else { return };
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    publication.wait_for_loggers(1, SOON).unwrap();
    for tick in 0..500 {
        publication.publish(&sample(0, tick, false));
    }
    thread::sleep(SOON * 4);
}

/// Starts this test binary once more, to play one of the parts above.
fn play(part: &str, variable: &str, instance: &str) -> Killed {
    let process = Process::new(std::env::current_exe().unwrap())
        .args(["--exact", part])
        .env(variable, instance)
        .stdout(Stdio::null())
        .spawn();
    Killed(process.unwrap())
}

/// Ends the process also when the test fails.
struct Killed(Child);

impl Killed {
    /// The transport's shared memory that the process holds.
    fn shared_memory(&self) -> BTreeSet<PathBuf> {
        let maps = std::fs::read_to_string(format!("/proc/{}/maps", self.0.id())).unwrap();
        let paths = maps.lines().filter_map(|line| line.split_ascii_whitespace().nth(5));
        paths.filter(|path| path.starts_with("/dev/shm/iox2_")).map(PathBuf::from).collect()
    }

    fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Killed {
    fn drop(&mut self) {
        // It may be dead already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_logger_process_that_is_killed_does_not_hang_the_run_nor_harm_another_logger() {
    let instance = instance("killed");
    let mut publication = Publication::start(&instance, Pace::Lockstep { patience: SOON * 2 }).unwrap();
    let mut victim = play("play_a_logger_in_a_process_of_its_own", PLAY_LOGGER, &instance);
    let log = logger(&instance, Delivery::Lossless, 2, Duration::ZERO);
    publication.wait_for_loggers(2, SOON).unwrap();
    let begin = Instant::now();
    let publisher = thread::spawn(move || {
        publish_run(&mut publication, 0, 50_000);
        publish_run(&mut publication, 1, 50_000);
        let settled = publication.settle(SOON).unwrap();
        (publication, settled)
    });
    // By now the run stands still: the victim has stopped to take its samples.
    thread::sleep(Duration::from_millis(300));
    assert!(!publisher.is_finished(), "the victim was waited for");
    victim.kill();
    let (publication, settled) = publisher.join().unwrap();
    assert!(begin.elapsed() < SOON, "well before the patience is over");
    assert_eq!((settled.published, settled.pending), (100_000, 0));
    assert!(settled.loggers <= 1, "the dead one was removed; the other one may have left already");
    assert!(log.join().unwrap().certificates.iter().all(LossCertificate::is_lossless));
    publication.stop().unwrap();
}

#[test]
fn a_service_that_is_killed_leaves_no_debris_in_the_way_of_the_next_one() {
    let instance = instance("restart");
    let mut subscriber = SampleSubscriber::open(&instance, Delivery::Lossless).unwrap();
    let mut victim = play("play_a_service_in_a_process_of_its_own", PLAY_SERVICE, &instance);
    let mut samples = Vec::new();
    let begin = Instant::now();
    while samples.len() < 500 {
        assert!(begin.elapsed() < SOON, "{} samples", samples.len());
        subscriber.receive(Duration::from_millis(100), &mut samples).unwrap();
    }
    victim.kill();

    // Without the removal of what the killed process left, the instance would be in use for ever.
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    publication.wait_for_loggers(1, SOON).unwrap();
    publish_run(&mut publication, 0, 1000);
    while samples.len() < 1500 {
        assert!(begin.elapsed() < SOON, "{} samples", samples.len());
        subscriber.receive(Duration::from_millis(100), &mut samples).unwrap();
    }
    // Both services counted their runs from 0; the subscriber keeps them apart.
    let (first, second) = (subscriber.take_certificate().unwrap(), subscriber.take_certificate().unwrap());
    assert_eq!((first.received, first.end_seen), (500, false));
    assert_eq!((second.received, second.is_lossless()), (1000, true));
    assert_all_there(&samples[500..], 0, 1000);
}

#[test]
fn memory_that_a_killed_process_left_without_a_size_is_waited_for_by_nobody() {
    let (victim_instance, next) = (instance("half-made"), instance("after-half-made"));
    let mut victim = play("play_a_service_in_a_process_of_its_own", PLAY_SERVICE, &victim_instance);
    let mut subscriber = SampleSubscriber::open(&victim_instance, Delivery::Lossless).unwrap();
    let (mut samples, begin) = (Vec::new(), Instant::now());
    while samples.is_empty() {
        assert!(begin.elapsed() < SOON, "nothing was published");
        subscriber.receive(Duration::from_millis(100), &mut samples).unwrap();
    }
    drop(subscriber);
    // As if it had been killed between a name and its size. It still lives, so no other test's process removes it meanwhile.
    let mut half_made = victim.shared_memory();
    half_made.retain(|path| path.extension().is_some_and(|suffix| suffix == "dynamic"));
    assert!(!half_made.is_empty(), "the victim holds services");
    for path in &half_made {
        let file = File::options().write(true).open(path).unwrap();
        file.set_len(0).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(5)).unwrap();
    }
    victim.kill();
    // On a thread of its own: without the removal it never returns.
    let (done, opened) = mpsc::channel();
    thread::spawn(move || done.send(Publication::start(&next, Pace::LOCKSTEP).map(|_| ())).unwrap());
    opened.recv_timeout(SOON).expect("the next service starts").unwrap();
    assert!(half_made.iter().all(|path| !path.exists()), "{half_made:?}");
}
