//! The publication through real shared memory: what the loop hands over arrives, whole and in order.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use std::time::{Duration, Instant};

use common::logger::{SOON, assert_all_there, instance, logger, publish_run, run_still, sample};
use rt_core::{Delivery, Ended, LinkError, Pace, Publication, Publish, Sample, SampleSubscriber};

#[test]
fn a_hundred_thousand_ticks_of_the_loop_reach_the_logger_n_of_n() {
    let instance = instance("n-of-n");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let log = logger(&instance, Delivery::Lossless, 1, Duration::ZERO);
    publication.wait_for_loggers(1, SOON).unwrap();
    let begin = Instant::now();
    let report = run_still(&mut publication, 100_000);
    let settled = publication.settle(SOON).unwrap();
    let rate = 100_000.0 / begin.elapsed().as_secs_f64();
    println!("{rate:.0} samples a second through loop, publication and one logger");
    assert_eq!((report.ended, report.statistics.not_taken), (Ended::Completed, 0));
    assert_eq!((settled.published, settled.pending), (100_000, 0));
    let log = log.join().unwrap();
    assert_eq!(log.certificates[0].to_string(), "100000 of 100000 samples");
    assert!(log.samples.iter().enumerate().all(|(k, s)| s.tick == k as u64));
    publication.stop().unwrap();
}

#[test]
fn runs_of_any_length_over_one_service_are_certified_one_by_one() {
    let instance = instance("runs");
    let log = logger(&instance, Delivery::Lossless, 4, Duration::ZERO);
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    publication.wait_for_loggers(1, SOON).unwrap();
    let lengths = [20_000, 1, 37, 30_000];
    for (run, &ticks) in lengths.iter().enumerate() {
        publish_run(&mut publication, run as u32, ticks);
    }
    let log = log.join().unwrap();
    for (run, &ticks) in lengths.iter().enumerate() {
        let certificate = &log.certificates[run];
        assert_eq!((certificate.run, certificate.received, certificate.is_lossless()), (run as u32, ticks, true));
        assert_all_there(&log.samples, run as u32, ticks);
    }
}

#[test]
fn one_instance_has_one_publication_and_is_free_again_afterwards() {
    let instance = instance("one");
    let publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let error = Publication::start(&instance, Pace::LOCKSTEP).err();
    assert_eq!(error, Some(LinkError::InUse { instance: instance.clone() }));
    publication.stop().unwrap();
    Publication::start(&instance, Pace::LOCKSTEP).unwrap().stop().unwrap();
}

#[test]
fn of_many_that_start_at_the_same_moment_one_publishes() {
    const MANY: usize = 8;
    for round in 0..5 {
        let instance = instance(&format!("race-{round}"));
        let together = std::sync::Barrier::new(MANY);
        let start = || {
            together.wait();
            let publication = Publication::start(&instance, Pace::LOCKSTEP);
            together.wait();
            publication.err()
        };
        let errors: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..MANY).map(|_| scope.spawn(start)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let refused = errors.iter().flatten().filter(|e| matches!(e, LinkError::InUse { .. })).count();
        assert_eq!(refused, MANY - 1, "{errors:?}");
    }
}

#[test]
fn a_sample_of_another_version_is_refused() {
    let instance = instance("version");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let mut subscriber = SampleSubscriber::open(&instance, Delivery::BestEffort).unwrap();
    publication.publish(&Sample { version: 99, ..sample(0, 0, true) });
    publication.settle(SOON).unwrap();
    assert_eq!(subscriber.drain(&mut Vec::new()), Err(LinkError::Version { got: 99 }));
}

#[test]
fn a_sample_with_numbers_that_no_run_comes_to_is_refused() {
    let instance = instance("beyond");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let mut subscriber = SampleSubscriber::open(&instance, Delivery::BestEffort).unwrap();
    publication.publish(&Sample { tick: u64::MAX, ..sample(3, 0, true) });
    publication.settle(SOON).unwrap();
    let mut samples = Vec::new();
    let error = subscriber.drain(&mut samples).unwrap_err();
    assert!(matches!(error, LinkError::BeyondRange { run: 3, beyond } if beyond.field == "tick"), "{error}");
    assert_eq!(samples, []);
}

/// Hung for ever: to the transport a wait of no length is one without end. Not called from here, so that it fails instead.
#[test]
fn a_look_without_a_wait_comes_back_where_nobody_publishes() {
    let (done, looked) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let mut subscriber = SampleSubscriber::open(&instance("no-wait"), Delivery::BestEffort).unwrap();
        let counts = [Duration::ZERO, Duration::from_nanos(1)].map(|wait| subscriber.receive(wait, &mut Vec::new()));
        done.send(counts).unwrap();
    });
    assert_eq!(looked.recv_timeout(SOON), Ok([Ok(0), Ok(0)]));
}

#[test]
fn waiting_in_vain_says_for_what() {
    let instance = instance("vain");
    let publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let error = publication.wait_for_loggers(1, Duration::from_millis(50)).unwrap_err();
    assert!(error.to_string().contains("1 lossless loggers, 0 came"), "{error}");
}
