//! Loggers and monitors of every kind in virtual time: nothing lost for those that are waited for, loss certified for the others,
//! nobody hangs.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use common::logger::{SOON, assert_all_there, instance, logger, publish_run};
use rt_core::{Delivery, LossCertificate, Pace, Publication, SampleSubscriber, link};

#[test]
fn a_slow_logger_is_waited_for_and_loses_nothing() {
    let instance = instance("slow");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let slow = logger(&instance, Delivery::Lossless, 1, Duration::from_millis(5));
    let fast = logger(&instance, Delivery::Lossless, 1, Duration::ZERO);
    publication.wait_for_loggers(2, SOON).unwrap();
    publish_run(&mut publication, 0, 60_000);
    for log in [slow, fast] {
        let log = log.join().unwrap();
        assert!(log.certificates[0].is_lossless(), "{}", log.certificates[0]);
        assert_all_there(&log.samples, 0, 60_000);
    }
}

#[test]
fn a_stalled_monitor_costs_the_logger_nothing_and_its_own_loss_is_certified() {
    let instance = instance("monitor");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let mut monitor = SampleSubscriber::open(&instance, Delivery::BestEffort).unwrap();
    let log = logger(&instance, Delivery::Lossless, 1, Duration::ZERO);
    publication.wait_for_loggers(1, SOON).unwrap();
    publish_run(&mut publication, 0, 50_000);
    assert_eq!(publication.settle(SOON).unwrap().pending, 0);
    assert!(log.join().unwrap().certificates[0].is_lossless());

    let mut samples = Vec::new();
    while monitor.drain(&mut samples).unwrap() > 0 {}
    let certificate = monitor.take_certificate().unwrap();
    // The newest samples are kept, a buffer full of them.
    let kept = link::BUFFER_SAMPLES as u64;
    assert_eq!((certificate.received, certificate.expected), (kept, 50_000));
    assert_eq!(certificate.gaps, [(0, 50_000 - kept - 1)]);
    assert!(!certificate.is_lossless() && samples.last().unwrap().last());
}

#[test]
fn a_logger_that_stalls_for_good_is_given_up_and_its_loss_is_certified() {
    let instance = instance("stall");
    let patience = Duration::from_millis(200);
    let mut publication = Publication::start(&instance, Pace::Lockstep { patience }).unwrap();
    let mut stalled = SampleSubscriber::open(&instance, Delivery::Lossless).unwrap();
    let log = logger(&instance, Delivery::Lossless, 2, Duration::ZERO);
    publication.wait_for_loggers(2, SOON).unwrap();
    publish_run(&mut publication, 0, 40_000);
    let settled = publication.settle(SOON).unwrap();
    assert_eq!((settled.published, settled.loggers, settled.pending), (40_000, 2, 0));

    let mut samples = Vec::new();
    while stalled.drain(&mut samples).unwrap() > 0 {}
    let certificate = stalled.take_certificate().unwrap();
    assert!(certificate.end_seen && !certificate.is_lossless());
    let missing: u64 = certificate.gaps.iter().map(|(first, last)| last - first + 1).sum();
    assert_eq!(certificate.received + missing, 40_000, "{certificate}");

    // It has caught up, so it is waited for again: the next run reaches it whole, far beyond its buffer.
    let done = Arc::new(AtomicBool::new(false));
    let publisher = thread::spawn({
        let done = Arc::clone(&done);
        move || {
            thread::sleep(Duration::from_millis(50));
            publish_run(&mut publication, 1, 40_000);
            done.store(true, Ordering::Release);
            publication
        }
    });
    let begin = Instant::now();
    let certificate = loop {
        assert!(begin.elapsed() < SOON);
        stalled.receive(Duration::from_millis(20), &mut samples).unwrap();
        if let Some(certificate) = stalled.take_certificate() {
            break certificate;
        }
    };
    assert!(certificate.is_lossless(), "{certificate}");
    publisher.join().unwrap().stop().unwrap();
    assert!(log.join().unwrap().certificates.iter().all(LossCertificate::is_lossless));
}

#[test]
fn a_logger_that_leaves_within_a_run_is_not_waited_for() {
    let instance = instance("leaves");
    let mut publication = Publication::start(&instance, Pace::Lockstep { patience: SOON * 2 }).unwrap();
    let mut leaver = SampleSubscriber::open(&instance, Delivery::Lossless).unwrap();
    publication.wait_for_loggers(1, SOON).unwrap();
    let begin = Instant::now();
    let publisher = thread::spawn(move || {
        publish_run(&mut publication, 0, 50_000);
        publication
    });
    let mut samples = Vec::new();
    while samples.len() < 2000 {
        leaver.receive(Duration::from_millis(20), &mut samples).unwrap();
    }
    leaver.abandon_run();
    let certificate = leaver.take_certificate().unwrap();
    assert!(!certificate.end_seen && certificate.gaps.is_empty());
    drop(leaver);
    publisher.join().unwrap().stop().unwrap();
    assert!(begin.elapsed() < SOON, "held up by a logger that is gone");
}
