//! The publication through real shared memory: nothing lost for loggers, loss certified for the others, nobody hangs.
//! Each test has an instance of its own, named after the process, so that several test runs may go on at once.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use std::process::{Child, Command as Process, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rt_core::{
    Command, Delivery, Device, DeviceError, Ended, Handover, LinkError, Lockstep, LossCertificate, Measurement, Pace,
    Publication, Publish, Reference, SAMPLE_VERSION, Sample, SampleSubscriber, Stages, Step, Supervisor, Target, Tick,
    cycle::OpenLoop, flags, link,
};

const SOON: Duration = Duration::from_secs(30);

fn instance(test: &str) -> String {
    format!("test-{}-{test}", std::process::id())
}

fn sample(run: u32, tick: u64, last: bool) -> Sample {
    Sample {
        version: SAMPLE_VERSION,
        run,
        tick,
        scheduled_ns: tick * 1_000_000,
        lateness_ns: 0,
        input_age_ns: 0,
        voltage_v: tick as f64,
        angle_deg: f64::NAN,
        pressure1_bar: 0.5 * tick as f64,
        pressure2_bar: 2.0,
        torque_nm: f64::NAN,
        volume_ml: f64::NAN,
        segment: run,
        flags: if last { flags::LAST } else { 0 },
    }
}

fn publish_run(publication: &mut Publication, run: u32, ticks: u64) {
    for tick in 0..ticks {
        assert_eq!(publication.publish(&sample(run, tick, tick + 1 == ticks)), Handover::Taken);
    }
}

/// What a logger thread brings home.
struct Log {
    samples: Vec<Sample>,
    certificates: Vec<LossCertificate>,
}

/// A logger that lives until it has the certificates of `runs` runs, working `work` on each batch.
fn logger(instance: &str, delivery: Delivery, runs: usize, work: Duration) -> JoinHandle<Log> {
    let (ready, opened) = mpsc::channel();
    let instance = instance.to_owned();
    let thread = thread::spawn(move || {
        let mut subscriber = SampleSubscriber::open(&instance, delivery).unwrap();
        ready.send(()).unwrap();
        let mut log = Log { samples: Vec::new(), certificates: Vec::new() };
        let begin = Instant::now();
        while log.certificates.len() < runs {
            assert!(begin.elapsed() < SOON, "only {} certificates", log.certificates.len());
            subscriber.receive(Duration::from_millis(100), &mut log.samples).unwrap();
            while let Some(certificate) = subscriber.take_certificate() {
                log.certificates.push(certificate);
            }
            thread::sleep(work);
        }
        log
    });
    opened.recv().unwrap();
    thread
}

fn assert_all_there(samples: &[Sample], run: u32, ticks: u64) {
    let of_run: Vec<_> = samples.iter().filter(|s| s.run == run).collect();
    assert_eq!(of_run.len() as u64, ticks);
    for (tick, received) in of_run.into_iter().enumerate() {
        let sent = sample(run, tick as u64, tick as u64 + 1 == ticks);
        assert_eq!((received.tick, received.flags, received.segment), (sent.tick, sent.flags, sent.segment));
        assert_eq!(
            (received.pressure1_bar.to_bits(), received.angle_deg.to_bits()),
            (sent.pressure1_bar.to_bits(), sent.angle_deg.to_bits())
        );
    }
}

/// A rig on which nothing happens.
struct Still;

impl Device for Still {
    fn read(&mut self, _now: Tick) -> Result<Measurement, DeviceError> {
        Ok(Measurement { angle_deg: 0.0, pressure1_bar: 2.0, pressure2_bar: 2.0, ..Measurement::NONE })
    }

    fn write(&mut self, _now: Tick, _command: &Command) -> Result<(), DeviceError> {
        Ok(())
    }
}

struct Rest {
    ticks: u64,
}

impl Reference for Rest {
    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        Step {
            target: Target::VoltageV(0.0),
            brake_open: false,
            bypass_open: true,
            fixture: rt_core::Fixture::Free,
            segment: 0,
            last: now.index + 1 == self.ticks,
        }
    }
}

#[test]
fn a_hundred_thousand_ticks_of_the_loop_reach_the_logger_n_of_n() {
    let instance = instance("n-of-n");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let log = logger(&instance, Delivery::Lossless, 1, Duration::ZERO);
    publication.wait_for_loggers(1, SOON).unwrap();
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device: &mut Still,
        supervisor: &mut Supervisor::new(rt_core::Limits::default()).unwrap(),
        reference: &mut Rest { ticks: 100_000 },
        controller: &mut OpenLoop,
        publish: &mut publication,
    };
    let begin = Instant::now();
    let report = rt_core::run(stages, 0, &AtomicBool::new(false)).unwrap();
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
fn a_sample_of_another_version_is_refused() {
    let instance = instance("version");
    let mut publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let mut subscriber = SampleSubscriber::open(&instance, Delivery::BestEffort).unwrap();
    publication.publish(&Sample { version: 99, ..sample(0, 0, true) });
    publication.settle(SOON).unwrap();
    assert_eq!(subscriber.drain(&mut Vec::new()), Err(LinkError::Version { got: 99 }));
}

#[test]
fn waiting_in_vain_says_for_what() {
    let instance = instance("vain");
    let publication = Publication::start(&instance, Pace::LOCKSTEP).unwrap();
    let error = publication.wait_for_loggers(1, Duration::from_millis(50)).unwrap_err();
    assert!(error.to_string().contains("1 lossless loggers, 0 came"), "{error}");
}
