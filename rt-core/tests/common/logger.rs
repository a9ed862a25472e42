//! Instances, samples and loggers for the tests of the publication.
//! Each test has an instance of its own, named after the process, so that several test runs may go on at once.

use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rt_core::{
    Command, Delivery, Device, DeviceError, Fixture, Handover, Limits, Lockstep, LossCertificate, Measurement,
    OpenLoop, OverrunPolicy, Publication, Publish, Reference, Run, RunReport, Sample, SampleSubscriber, Stages, Step,
    Supervisor, Target, Tick, flags, flight,
};

/// Longer than anything here takes on a busy machine.
pub const SOON: Duration = Duration::from_secs(30);

pub fn instance(test: &str) -> String {
    format!("test-{}-{test}", std::process::id())
}

pub fn sample(run: u32, tick: u64, last: bool) -> Sample {
    Sample {
        run,
        tick,
        scheduled_ns: tick * 1_000_000,
        voltage_v: tick as f64,
        pressure1_bar: 0.5 * tick as f64,
        pressure2_bar: 2.0,
        segment: run,
        flags: if last { flags::LAST } else { 0 },
        ..Sample::BLANK
    }
}

pub fn publish_run(publication: &mut Publication, run: u32, ticks: u64) {
    for tick in 0..ticks {
        assert_eq!(publication.publish(&sample(run, tick, tick + 1 == ticks)), Handover::Taken);
    }
}

/// What a logger thread brings home.
pub struct Log {
    pub samples: Vec<Sample>,
    pub certificates: Vec<LossCertificate>,
}

/// A logger that lives until it has the certificates of `runs` runs, working `work` on each batch.
pub fn logger(instance: &str, delivery: Delivery, runs: usize, work: Duration) -> JoinHandle<Log> {
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

pub fn assert_all_there(samples: &[Sample], run: u32, ticks: u64) {
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
            fixture: Fixture::Free,
            segment: 0,
            index: 0,
            last: now.index + 1 == self.ticks,
            waiting: None,
            hands_on: false,
        }
    }
}

/// Runs so many ticks in lockstep, on a rig on which nothing happens, as fast as the publication takes them.
pub fn run_still(publication: &mut Publication, ticks: u64) -> RunReport {
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device: &mut Still,
        operator: &mut (),
        supervisor: &mut Supervisor::new(Limits::default()).unwrap(),
        reference: &mut Rest { ticks },
        controller: &mut OpenLoop,
        publish: publication,
        flight: &mut flight::recorder().0,
    };
    rt_core::run(stages, Run { number: 0, overrun: OverrunPolicy::Skip }).unwrap()
}
