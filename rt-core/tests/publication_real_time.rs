//! The publication in real time: nobody is waited for, and what does not fit is counted.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use std::thread;
use std::time::Duration;

use common::logger::{SOON, instance, logger, run_still, sample};
use rt_core::{Delivery, Ended, Handover, Pace, Publication, Publish, SampleSubscriber};

#[test]
fn in_real_time_a_stalled_logger_is_not_waited_for_and_one_that_keeps_up_gets_all() {
    let instance = instance("real-time");
    let mut publication = Publication::start(&instance, Pace::RealTime).unwrap();
    let stalled = SampleSubscriber::open(&instance, Delivery::Lossless).unwrap();
    let log = logger(&instance, Delivery::Lossless, 1, Duration::ZERO);
    publication.wait_for_loggers(2, SOON).unwrap();
    for tick in 0..30_000 {
        assert_eq!(publication.publish(&sample(0, tick, tick == 29_999)), Handover::Taken);
        if tick % 1000 == 999 {
            publication.settle(SOON).unwrap();
            thread::sleep(Duration::from_millis(5));
        }
    }
    assert!(log.join().unwrap().certificates[0].is_lossless());
    drop(stalled);
    publication.stop().unwrap();
}

/// Hands samples over faster than anybody could send them, until one finds no room. Returns how many were taken.
fn overfill(publication: &mut Publication) -> u64 {
    (0..100_000_000)
        .find(|&tick| publication.publish(&sample(0, tick, false)) == Handover::Lost)
        .expect("a queue that never fills")
}

#[test]
fn the_last_sample_arrives_although_the_queue_was_full_when_it_was_handed_over() {
    let instance = instance("patient");
    let mut publication = Publication::start(&instance, Pace::RealTime).unwrap();
    let mut subscriber = SampleSubscriber::open(&instance, Delivery::BestEffort).unwrap();
    let taken = overfill(&mut publication);
    // One sample was lost; the one that ends the run waits for room.
    assert_eq!(publication.publish_patiently(&sample(0, taken + 1, true)), Handover::Taken);
    assert_eq!(publication.settle(SOON).unwrap().published, taken + 1);
    let mut samples = Vec::new();
    while subscriber.drain(&mut samples).unwrap() > 0 {}
    assert!(samples.last().unwrap().last());
    let certificate = subscriber.take_certificate().unwrap();
    assert!(certificate.end_seen && certificate.expected == taken + 2);
    assert_eq!(certificate.gaps.last(), Some(&(taken, taken)), "the lost one, {certificate}");
    publication.stop().unwrap();
}

#[test]
fn a_loop_that_is_faster_than_its_publication_counts_every_sample_that_was_lost() {
    let instance = instance("too-fast");
    let mut publication = Publication::start(&instance, Pace::RealTime).unwrap();
    let log = logger(&instance, Delivery::Lossless, 1, Duration::ZERO);
    publication.wait_for_loggers(1, SOON).unwrap();
    let report = run_still(&mut publication, 300_000);
    let not_taken = report.statistics.not_taken;
    assert_eq!((report.ended, report.statistics.ticks), (Ended::Completed, 300_000), "the loop waits for nobody");
    assert!(not_taken > 0, "nothing sends 300,000 samples in that time");
    let settled = publication.settle(SOON).unwrap();
    assert_eq!(settled.published + not_taken, 300_000);
    let certificate = log.join().unwrap().certificates.remove(0);
    assert!(certificate.end_seen, "the last sample arrives in any case: {certificate}");
    let missing: u64 = certificate.gaps.iter().map(|(first, last)| last - first + 1).sum();
    assert_eq!(certificate.received + missing, 300_000);
    assert!(missing >= not_taken, "what was not taken can't have arrived");
    publication.stop().unwrap();
}
