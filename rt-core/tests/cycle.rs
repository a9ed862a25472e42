//! The tick and the run: order of the stages, meaning of sample k, safe state, endings.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};

use rt_core::{
    Breach, Channel, Command, Controller, Device, DeviceError, Ended, Fixture, Handover, Limits, Lockstep, LoopError,
    Measurement, Publish, Reference, RunReport, Sample, Stages, Step, Supervisor, Target, Tick, flags, run,
};

/// A tank whose pressure 1 rises by 0.01 bar per volt and tick; every call is noted.
#[derive(Default)]
struct Tank {
    pressure_bar: f64,
    acting_v: f64,
    calls: Rc<RefCell<Vec<String>>>,
    written: Vec<(u64, Command)>,
    fail_read_at: Option<u64>,
    fail_write_at: Option<u64>,
    lose_pressure_from: Option<u64>,
}

impl Tank {
    fn note(&self, what: &str, now: Tick) {
        self.calls.borrow_mut().push(format!("{what} {}", now.index));
    }
}

fn broken(now: Tick) -> DeviceError {
    DeviceError { device: "tank", tick: now.index, what: "expected an answer, got none".to_owned() }
}

impl Device for Tank {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        self.note("read", now);
        if self.fail_read_at == Some(now.index) {
            return Err(broken(now));
        }
        self.pressure_bar += 0.01 * self.acting_v;
        let lost = self.lose_pressure_from.is_some_and(|from| now.index >= from);
        let pressure1_bar = if lost { f64::NAN } else { 2.0 + self.pressure_bar };
        Ok(Measurement { angle_deg: 0.0, pressure1_bar, pressure2_bar: 2.0, ..Measurement::NONE })
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.note("write", now);
        if self.fail_write_at == Some(now.index) {
            return Err(broken(now));
        }
        self.acting_v = command.voltage_v;
        self.written.push((now.index, *command));
        Ok(())
    }
}

/// A constant voltage over some ticks; the segment counts from 7.
struct Script {
    ticks: u64,
    voltage_v: f64,
    calls: Rc<RefCell<Vec<String>>>,
}

impl Reference for Script {
    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        self.calls.borrow_mut().push(format!("reference {}", now.index));
        Step {
            target: Target::VoltageV(self.voltage_v),
            brake_open: true,
            bypass_open: false,
            fixture: Fixture::Free,
            segment: 7 + now.index as u32 / 10,
            last: now.index + 1 == self.ticks,
        }
    }
}

struct Follow {
    calls: Rc<RefCell<Vec<String>>>,
    not_a_number_at: Option<u64>,
}

impl Controller for Follow {
    fn control(&mut self, now: Tick, _measured: &Measurement, step: &Step) -> f64 {
        self.calls.borrow_mut().push(format!("control {}", now.index));
        match step.target {
            _ if self.not_a_number_at == Some(now.index) => f64::NAN,
            Target::VoltageV(voltage_v) | Target::FlowMlS(voltage_v) => voltage_v,
        }
    }
}

struct Book {
    samples: Vec<Sample>,
    calls: Rc<RefCell<Vec<String>>>,
    full_after: usize,
}

impl Publish for Book {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.calls.borrow_mut().push(format!("publish {}", sample.tick));
        if self.samples.len() >= self.full_after {
            return Handover::Lost;
        }
        self.samples.publish(sample)
    }
}

/// Everything a run needs, and what it left.
struct Rig {
    tank: Tank,
    script: Script,
    follow: Follow,
    supervisor: Supervisor,
    book: Book,
}

impl Rig {
    fn new(ticks: u64, voltage_v: f64) -> Self {
        let calls = Rc::new(RefCell::new(Vec::new()));
        let limits = Limits { pressure_max_bar: 3.0, aftermath_ticks: 5, missing_max_ticks: 3, ..Limits::default() };
        Rig {
            tank: Tank { calls: calls.clone(), ..Tank::default() },
            script: Script { ticks, voltage_v, calls: calls.clone() },
            follow: Follow { calls: calls.clone(), not_a_number_at: None },
            supervisor: Supervisor::new(limits).unwrap(),
            book: Book { samples: Vec::new(), calls, full_after: usize::MAX },
        }
    }

    fn run(&mut self, number: u32) -> Result<RunReport, LoopError> {
        self.run_with(number, &AtomicBool::new(false))
    }

    fn run_with(&mut self, number: u32, stop: &AtomicBool) -> Result<RunReport, LoopError> {
        let stages = Stages {
            clock: &mut Lockstep::default(),
            device: &mut self.tank,
            supervisor: &mut self.supervisor,
            reference: &mut self.script,
            controller: &mut self.follow,
            publish: &mut self.book,
        };
        run(stages, number, stop)
    }

    fn calls(&self) -> Vec<String> {
        self.book.calls.borrow().clone()
    }
}

#[test]
fn stages_run_in_order_once_a_tick_and_the_safe_state_ends_the_run() {
    let mut rig = Rig::new(2, 1.0);
    let report = rig.run(0).unwrap();
    let expected = "read 0, reference 0, control 0, write 0, publish 0, \
                    read 1, reference 1, control 1, write 1, publish 1, write 2";
    assert_eq!(rig.calls().join(", "), expected);
    assert_eq!((report.ended, report.statistics.ticks), (Ended::Completed, 2));
    assert_eq!(rig.tank.written[2], (2, Command { segment: 7, ..Command::SAFE }));
}

#[test]
fn sample_k_holds_the_state_at_k_and_the_command_that_acts_from_k() {
    let mut rig = Rig::new(30, 2.0);
    rig.run(42).unwrap();
    let samples = &rig.book.samples;
    assert_eq!(samples.len(), 30);
    for (k, sample) in samples.iter().enumerate() {
        assert_eq!((sample.run, sample.tick, sample.scheduled_ns), (42, k as u64, k as u64 * 1_000_000));
        // The command of tick 0 shows for the first time in the measurement of tick 1.
        assert!((sample.pressure1_bar - (2.0 + 0.02 * k as f64)).abs() < 1e-12, "tick {k}");
        assert_eq!((sample.voltage_v, sample.brake_open(), sample.bypass_open()), (2.0, true, false));
        assert_eq!(sample.segment, 7 + k as u32 / 10);
        assert_eq!(sample.last(), k == 29);
        assert!(!sample.tripped() && !sample.fault());
        assert!(sample.torque_nm.is_nan() && sample.volume_ml.is_nan(), "not measured stays NaN");
    }
}

#[test]
fn two_runs_of_the_same_script_are_identical_bit_by_bit() {
    let record = || {
        let mut rig = Rig::new(200, 0.4);
        rig.run(1).unwrap();
        let bits =
            |s: &Sample| (s.tick, s.pressure1_bar.to_bits(), s.voltage_v.to_bits(), s.angle_deg.to_bits(), s.flags);
        rig.book.samples.iter().map(bits).collect::<Vec<_>>()
    };
    assert_eq!(record(), record());
}

#[test]
fn a_trip_is_safe_within_its_tick_latches_and_is_reported() {
    let mut rig = Rig::new(1000, 10.0);
    let report = rig.run(0).unwrap();
    // 2.0 + 0.1 k exceeds 3.0 at tick 11 (at tick 10 it is 3.0 but for rounding).
    let trip = report.trip.unwrap();
    assert!(trip.tick == 10 || trip.tick == 11);
    let k = trip.tick as usize;
    assert_eq!((trip.channel, trip.breach), (Channel::Pressure1, Breach::Above(3.0)));
    assert_eq!(trip.value, rig.book.samples[k].pressure1_bar);
    assert!(trip.value > 3.0 && rig.book.samples[k - 1].pressure1_bar <= 3.0, "at the first tick above");
    assert_eq!(report.ended, Ended::Tripped);

    let (before, after) = rig.book.samples.split_at(k);
    assert!(before.iter().all(|s| !s.tripped() && s.voltage_v == 10.0));
    assert!(after.iter().all(|s| s.tripped() && s.voltage_v == 0.0 && !s.brake_open() && s.bypass_open()));
    assert_eq!(after.len(), 6, "the tick itself and 5 of aftermath");
    assert!(after.last().unwrap().last() && !after[0].last());
    assert_eq!(after[0].segment, 7 + k as u32 / 10, "the segment goes on");
    assert!(rig.tank.written[k..].iter().all(|(_, command)| command.voltage_v == 0.0 && command.bypass_open));
    assert!(!rig.calls().contains(&format!("control {k}")), "the controller does not integrate against a tripped rig");
    assert!(report.to_string().contains("pressure 1") && report.to_string().contains("above 3 bar"));
}

#[test]
fn a_trip_is_cleared_by_the_operator_only() {
    let mut rig = Rig::new(50, 10.0);
    let trip = rig.run(0).unwrap().trip.unwrap();
    let writes = rig.tank.written.len();
    assert_eq!(rig.run(1), Err(LoopError::StillTripped { run: 1, trip }));
    assert_eq!(rig.tank.written.len(), writes, "a refused run touches nothing");
    rig.supervisor.reset();
    rig.tank.pressure_bar = 0.0;
    rig.script.voltage_v = 0.0;
    assert_eq!(rig.run(2).unwrap().ended, Ended::Completed);
}

#[test]
fn a_command_that_is_no_number_never_reaches_the_device() {
    let mut rig = Rig::new(100, 1.0);
    rig.follow.not_a_number_at = Some(4);
    let report = rig.run(0).unwrap();
    let trip = report.trip.unwrap();
    assert_eq!((trip.tick, trip.channel, trip.breach), (4, Channel::Voltage, Breach::NotFinite));
    assert!(rig.tank.written.iter().all(|(_, command)| command.voltage_v.is_finite()));
    assert_eq!(rig.tank.written[4].1.voltage_v, 0.0);
    assert!(rig.book.samples[4].tripped());
}

#[test]
fn a_required_channel_may_be_missing_for_a_while_but_no_longer() {
    let mut rig = Rig::new(100, 0.0);
    rig.tank.lose_pressure_from = Some(20);
    let trip = rig.run(0).unwrap().trip.unwrap();
    assert_eq!((trip.tick, trip.channel, trip.breach), (23, Channel::Pressure1, Breach::Missing(3)));
    assert!(trip.value.is_nan());
}

#[test]
fn a_stop_zeroes_the_output_and_closes_the_run() {
    let mut rig = Rig::new(u64::MAX, 1.0);
    let stop = AtomicBool::new(true);
    let report = rig.run_with(0, &stop).unwrap();
    assert_eq!(report.ended, Ended::Stopped);
    assert_eq!(rig.book.samples.len(), 1);
    let sample = rig.book.samples[0];
    assert!(sample.last() && !sample.tripped() && sample.voltage_v == 0.0 && sample.bypass_open());
    assert!(stop.load(Ordering::Relaxed), "who stops decides when to go on");
}

#[test]
fn a_device_that_fails_is_made_safe_and_the_run_is_closed() {
    for (read, write) in [(Some(3), None), (None, Some(3))] {
        let mut rig = Rig::new(100, 1.0);
        (rig.tank.fail_read_at, rig.tank.fail_write_at) = (read, write);
        let error = rig.run(0).unwrap_err();
        let LoopError::Device { source, safe_state, .. } = &error else { panic!("{error}") };
        assert_eq!(source.tick, 3);
        assert_eq!(safe_state.is_ok(), write.is_none(), "whether it could be written is said");
        assert_eq!(error.to_string().contains("NOT written"), write.is_some(), "{error}");
        let last = rig.book.samples.last().unwrap();
        assert_eq!((last.tick, last.fault(), last.last()), (3, true, true));
        assert!(last.pressure1_bar.is_nan() && last.voltage_v == 0.0 && last.flags & flags::BYPASS_OPEN != 0);
    }
}

#[test]
fn samples_that_nobody_takes_are_counted_and_do_not_stop_the_loop() {
    let mut rig = Rig::new(100, 0.0);
    rig.book.full_after = 60;
    let report = rig.run(0).unwrap();
    assert_eq!((report.statistics.ticks, report.statistics.not_taken), (100, 40));
    assert!(report.to_string().contains("40 samples"));
}
