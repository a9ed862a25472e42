//! What a run is reaches recorders that are there, recorders that come later, and none that listens elsewhere.

use rt_core::announce::{Announcements, Announcer};
use rt_core::{LinkError, Pace, Publication, presence::is_published};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(30);
const NONE: Duration = Duration::from_millis(60);

fn instance(test: &str) -> String {
    format!("announce-{test}-{}", std::process::id())
}

fn bytes(length: usize, seed: u8) -> Vec<u8> {
    (0..length).map(|n| (n as u8).wrapping_mul(31).wrapping_add(seed)).collect()
}

#[test]
fn every_run_s_setup_reaches_a_recorder_that_is_there_whatever_its_size() {
    let instance = instance("sizes");
    let mut heard = Announcements::open(&instance).expect("shared memory is there");
    let announcer = Announcer::start(&instance).expect("shared memory is there");
    for (run, length) in [0, 1, 40_000, 3, 2_000_000, 32 * 1024, 700_000].into_iter().enumerate() {
        let run = run as u32;
        announcer.announce(run, bytes(length, run as u8)).expect("there is room");
        // It is there at once: the run's first sample may come right after.
        assert_eq!(heard.of_run(run, Duration::ZERO), Ok(Some(&*bytes(length, run as u8))), "{length} bytes");
    }
    assert_eq!(heard.of_run(2, Duration::ZERO), Ok(Some(&*bytes(40_000, 2))), "the ones before are remembered");
    assert_eq!(heard.of_run(99, NONE), Ok(None));
}

#[test]
fn who_comes_later_gets_the_last_one_and_a_service_that_begins_anew_is_believed() {
    let instance = instance("late");
    let announcer = Announcer::start(&instance).expect("shared memory is there");
    announcer.announce(0, bytes(100, 0)).expect("there is room");
    announcer.announce(1, bytes(100_000, 1)).expect("there is room");
    let mut heard = Announcements::open(&instance).expect("shared memory is there");
    assert_eq!(heard.of_run(1, PATIENCE), Ok(Some(&*bytes(100_000, 1))));
    drop(announcer);
    let announcer = Announcer::start(&instance).expect("shared memory is there");
    announcer.announce(1, bytes(50, 7)).expect("there is room");
    assert_eq!(heard.of_run(1, Duration::ZERO), Ok(Some(&*bytes(50, 7))), "the newest run of this number");
}

#[test]
fn where_nobody_announces_nothing_is_waited_for() {
    let instance = instance("nobody");
    let mut heard = Announcements::open(&instance).expect("shared memory is there");
    // Longer than any test may take.
    assert_eq!(heard.of_run(0, Duration::from_secs(100_000)), Ok(None));
}

#[test]
fn a_recorder_that_sleeps_through_many_runs_gets_the_newest_and_blocks_nobody() {
    let instance = instance("slow");
    let mut heard = Announcements::open(&instance).expect("shared memory is there");
    let announcer = Announcer::start(&instance).expect("shared memory is there");
    for run in 0..50 {
        announcer.announce(run, bytes(1_000, run as u8)).expect("there is room");
    }
    assert_eq!(heard.of_run(49, Duration::ZERO), Ok(Some(&*bytes(1_000, 49))));
    assert_eq!(heard.of_run(0, NONE), Ok(None));
}

#[test]
fn a_name_that_is_none_is_refused_and_who_publishes_is_seen() {
    assert!(matches!(Announcements::open("a/b"), Err(LinkError::InstanceName(_))));
    assert!(matches!(Announcer::start("a b"), Err(LinkError::InstanceName(_))));
    let instance = instance("presence");
    let publication = Publication::start(&instance, Pace::RealTime).expect("shared memory is there");
    assert_eq!(is_published(&instance), Ok(true));
    // Somebody else holds the service open when the publisher leaves.
    let subscriber = rt_core::SampleSubscriber::open(&instance, rt_core::Delivery::BestEffort).expect("it subscribes");
    publication.stop().expect("it ends");
    assert_eq!(is_published(&instance), Ok(false));
    drop(subscriber);
}
