//! The tick and the run: order of the stages, meaning of sample k, safe state, endings.

mod common;

use common::world::{At, Forge, ORIGIN_NS, People, Rig, limits};
use rt_core::{
    Breach, Channel, Command, ControlledPressure, Controller, Demand, Ended, Fixture, Input, Limits, Lockstep,
    LoopError, Measurement, OverrunPolicy, PERIOD_NS, Reference, Run, SAMPLE_VERSION, SafeState, Stages, Step, Target,
    TargetKind, Tick, flags,
};

#[test]
fn stages_run_in_order_once_a_tick_and_the_safe_state_ends_the_run() {
    let mut rig = Rig::new(2, 1.0);
    let report = rig.run_in_lockstep(0).unwrap();
    let expected = "read 0, reference 0, control 0, write 0, publish 0, \
                    read 1, reference 1, control 1, write 1, publish 1, write 2";
    assert_eq!(rig.world.calls().join(", "), expected);
    assert_eq!((report.ended, report.statistics.ticks), (Ended::Completed, 2));
    assert_eq!(rig.tank.written[2], (2, SafeState::default().command(Fixture::Free, 7)));
}

#[test]
fn sample_k_holds_the_state_at_k_and_the_command_that_acts_from_k() {
    let mut rig = Rig::new(30, 2.0);
    rig.run_in_lockstep(42).unwrap();
    let samples = &rig.book.samples;
    assert_eq!(samples.len(), 30);
    for (k, sample) in samples.iter().enumerate() {
        assert_eq!((sample.version, sample.run, sample.tick), (SAMPLE_VERSION, 42, k as u64));
        assert_eq!((sample.scheduled_ns, sample.sequence()), (k as u64 * 1_000_000, k as u64));
        // The command of tick 0 shows for the first time in the measurement of tick 1.
        assert!((sample.pressure1_bar - (2.0 + 0.02 * k as f64)).abs() < 1e-12, "tick {k}");
        assert_eq!((sample.voltage_v, sample.brake_open(), sample.bypass_open()), (2.0, true, false));
        assert_eq!((sample.segment, sample.step), (7 + k as u32 / 10, k as u32 / 5));
        assert_eq!(sample.flags & !flags::LAST, flags::BRAKE_OPEN, "nothing else happened");
        assert_eq!(sample.last(), k == 29);
        assert!(sample.torque_nm.is_nan() && sample.volume_ml.is_nan(), "not measured stays NaN");
        assert_eq!(sample.quality, Input::Angle.bit() | Input::Pressure1.bit() | Input::Pressure2.bit());
        assert_eq!((sample.woken_ns, sample.execution_ns(), sample.publish_ns), (0, 0, 0), "virtual time");
    }
}

/// A target of every kind in turn, each with another value.
struct EveryKind;

impl Reference for EveryKind {
    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        let value = now.index as f64 / 8.0 - 1.0;
        let pressure = |of| Target::PressureBar { of, bar: value };
        let target = match now.index % 6 {
            0 => Target::VoltageV(value),
            1 => Target::FlowMlS(value),
            2 => pressure(ControlledPressure::Chamber1),
            3 => pressure(ControlledPressure::Chamber2),
            4 => pressure(ControlledPressure::Difference),
            _ => Target::AngleDeg { angle_deg: value, velocity_deg_s: 77.0 },
        };
        let (fixture, last) = (Fixture::Free, now.index >= 29);
        Step {
            target,
            brake_open: true,
            bypass_open: false,
            fixture,
            segment: 0,
            index: 0,
            last,
            waiting: None,
            hands_on: false,
        }
    }
}

struct Silent;

impl Controller for Silent {
    fn control(&mut self, _now: Tick, _measured: &Measurement, _step: &Step) -> f64 {
        0.0
    }
}

#[test]
fn a_sample_holds_what_the_profile_asks_for_also_where_the_command_is_the_safe_state() {
    let mut rig = Rig::new(30, 0.0);
    rig.people = Box::new(People(vec![(20, Demand::EmergencyStop)]));
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device: &mut rig.tank,
        operator: &mut *rig.people,
        supervisor: &mut rig.supervisor,
        reference: &mut EveryKind,
        controller: &mut Silent,
        publish: &mut rig.book,
        flight: &mut rig.flight,
    };
    let report = rt_core::run(stages, Run { number: 0, overrun: OverrunPolicy::Skip }).unwrap();
    assert_eq!((report.ended, report.trip.map(|trip| trip.tick)), (Ended::Tripped, Some(20)));
    for (k, sample) in rig.book.samples.iter().enumerate() {
        let (kind, _, _) = TargetKind::LIST[k % 6];
        assert_eq!(sample.target(), Some((kind, k as f64 / 8.0 - 1.0)), "tick {k}");
        assert_eq!((sample.target_of, sample.tripped()), (k as u32 % 6 + 1, k >= 20), "tick {k}");
    }
    assert!(rig.book.samples.len() > 21);
}

#[test]
fn a_sample_says_how_far_to_trust_its_values() {
    let mut rig = Rig::new(3, 0.0);
    let forge: Forge = |measured| {
        measured.age_ns = [1, 2, 3, 4, 5];
        measured.heartbeat_age_ns = 6;
        measured.faulty = Input::Pressure2.bit() | 1 << 31;
    };
    rig.tank.forge = Some((1, forge));
    rig.run_in_lockstep(0).unwrap();
    let sample = rig.sample(1);
    assert_eq!((sample.age_ns, sample.heartbeat_age_ns), ([1, 2, 3, 4, 5], 6));
    assert_eq!(sample.quality, Input::Angle.bit() | Input::Pressure1.bit() | Input::Pressure2.bit() << 8);
    assert_eq!(sample.pressure2_bar, 2.0, "what the device calls wrong is published as it came");
    let measured = sample.measurement();
    assert_eq!((measured.age_ns, measured.heartbeat_age_ns), ([1, 2, 3, 4, 5], 6));
    assert_eq!((measured.faulty, measured.valid()), (Input::Pressure2.bit(), sample.quality & 0xff));
}

#[test]
fn each_stage_is_timed_under_its_own_name() {
    let mut rig = Rig::new(10, 0.0);
    for (at, share) in [At::Wake, At::Read, At::Reference, At::Control, At::Write, At::Publish].into_iter().zip(1..) {
        rig.world.delay(at, 4, 0.01 * f64::from(share));
    }
    let report = rig.run(0).unwrap();
    let sample = rig.sample(4);
    assert_eq!((sample.lateness_ns, sample.behind_ns), (10_000, 0));
    assert_eq!(sample.woken_ns, ORIGIN_NS + 4 * PERIOD_NS + 10_000);
    assert_eq!((sample.read_ns, sample.check_ns, sample.reference_ns), (20_000, 0, 30_000));
    assert_eq!((sample.control_ns, sample.write_ns), (40_000, 50_000));
    assert_eq!((sample.publish_ns, rig.sample(5).publish_ns), (0, 60_000), "a hand-over is told by the next sample");
    let statistics = report.statistics;
    assert_eq!((statistics.lateness_max_ns, statistics.tick_max_ns, statistics.overruns), (10_000, 200_000, 0));
}

#[test]
fn two_runs_of_the_same_script_are_identical_bit_by_bit() {
    let record = || {
        let mut rig = Rig::with(Limits { pressure_max_bar: 9.0, missing_max_ticks: 9, ..limits() }, 400, 0.4);
        rig.tank.noisy = true;
        rig.run_in_lockstep(1).unwrap();
        // NaN is not equal to itself.
        rig.book.samples.iter().map(|s| format!("{s:?} {:x}", s.pressure1_bar.to_bits())).collect::<Vec<_>>()
    };
    assert_eq!(record(), record());
    assert_eq!(record().len(), 400);
}

#[test]
fn a_trip_is_safe_within_its_tick_latches_and_is_reported() {
    let mut rig = Rig::new(1000, 10.0);
    let report = rig.run_in_lockstep(0).unwrap();
    // 2.0 + 0.1 k exceeds 3.0 at tick 11 (at tick 10 it is 3.0 but for rounding).
    let trip = report.trip.unwrap();
    assert!(trip.tick == 10 || trip.tick == 11);
    let k = trip.tick as usize;
    assert_eq!((trip.channel, trip.breach), (Channel::Pressure1, Breach::Above(3.0)));
    assert_eq!(trip.value, rig.book.samples[k].pressure1_bar);
    assert!(trip.value > 3.0 && rig.book.samples[k - 1].pressure1_bar <= 3.0, "at the first tick above");
    assert_eq!(report.ended, Ended::Tripped);

    let (before, after) = rig.book.samples.split_at(k);
    assert!(before.iter().all(|s| !s.tripped() && s.trip == 0 && s.voltage_v == 10.0));
    assert!(after.iter().all(|s| s.tripped() && s.voltage_v == 0.0 && !s.brake_open() && s.bypass_open()));
    assert!(after.iter().all(|s| s.trip == trip.code()));
    assert_eq!(after.len(), 6, "the tick itself and 5 of aftermath");
    assert!(after.last().unwrap().last() && !after[0].last());
    assert_eq!(after[0].segment, 7 + k as u32 / 10, "the segment goes on");
    assert!(rig.tank.written[k..].iter().all(|(_, command)| command.voltage_v == 0.0 && command.bypass_open));
    assert!(!rig.world.calls().contains(&format!("control {k}")), "no controller integrates against a tripped rig");
    assert!(report.to_string().contains("pressure 1") && report.to_string().contains("above 3 bar"));
}

#[test]
fn what_holds_the_lever_goes_on_holding_it_whatever_the_profile_does_after_the_trip_or_at_the_stop() {
    let fixture = |tick| match tick {
        0..20 => Fixture::Driven { angle_deg: 12.0 },
        20..22 => Fixture::Clamped { angle_deg: -30.0 },
        _ => Fixture::Free,
    };
    // A breach at the very tick at which the profile would lead the lever elsewhere, and a stop there.
    for emergency in [true, false] {
        let mut rig = Rig::new(1000, 1.0);
        rig.script.fixture = fixture;
        rig.people = Box::new(People(vec![(20, if emergency { Demand::EmergencyStop } else { Demand::Stop })]));
        let report = rig.run_in_lockstep(0).unwrap();
        assert_eq!(report.ended, if emergency { Ended::Tripped } else { Ended::Stopped });
        assert_eq!(rig.tank.written[19].1.fixture, Fixture::Driven { angle_deg: 12.0 });
        for (tick, command) in &rig.tank.written[20..] {
            assert_eq!(command.fixture, Fixture::Clamped { angle_deg: 12.0 }, "tick {tick}: neither led nor let go");
        }
    }
}

#[test]
fn a_trip_is_cleared_by_the_operator_only() {
    let mut rig = Rig::new(50, 10.0);
    let trip = rig.run_in_lockstep(0).unwrap().trip.unwrap();
    let calls = rig.world.calls().len();
    for number in 1..4 {
        assert_eq!(rig.run_in_lockstep(number), Err(LoopError::StillTripped { run: number, trip }));
    }
    assert_eq!(rig.world.calls().len(), calls, "a refused run touches nothing");
    rig.supervisor.reset();
    rig.tank.pressure_bar = 0.0;
    rig.script.voltage_v = 0.0;
    assert_eq!(rig.run_in_lockstep(4).unwrap().ended, Ended::Completed);
}

#[test]
fn a_command_that_is_no_number_never_reaches_the_device() {
    let mut rig = Rig::new(100, 1.0);
    rig.follow.answer = Some((4, f64::NAN));
    let report = rig.run_in_lockstep(0).unwrap();
    let trip = report.trip.unwrap();
    assert_eq!((trip.tick, trip.channel, trip.breach), (4, Channel::Voltage, Breach::NotFinite));
    assert!(rig.tank.written.iter().all(|(_, command)| command.voltage_v.is_finite()));
    assert_eq!(rig.tank.written[4].1.voltage_v, 0.0);
    assert!(rig.book.samples[4].tripped());
}

#[test]
fn a_stop_zeroes_the_output_at_once_in_spite_of_the_slew_limit_and_closes_the_run() {
    let mut rig = Rig::with(Limits { slew_max_v_s: 1000.0, ..limits() }, u64::MAX, 5.0);
    rig.people = Box::new(People(vec![(7, Demand::Stop)]));
    let report = rig.run_in_lockstep(0).unwrap();
    assert_eq!((report.ended, report.trip), (Ended::Stopped, None));
    assert_eq!(rig.book.samples.len(), 8);
    assert_eq!(rig.sample(6).voltage_v, 5.0);
    let sample = rig.sample(7);
    assert!(sample.voltage_v == 0.0 && !sample.brake_open() && sample.bypass_open());
    assert_eq!(sample.flags & !flags::BYPASS_OPEN, flags::LAST | flags::STOPPED, "nothing latches");
    assert!(!rig.world.calls().contains(&"control 7".to_owned()));
}

#[test]
fn a_device_that_fails_is_made_safe_and_the_run_is_closed() {
    for (read, write) in [(Some(3), None), (None, Some(3))] {
        let mut rig = Rig::with(Limits { slew_max_v_s: 100.0, ..limits() }, 100, 1.0);
        (rig.tank.fail_read_at, rig.tank.fail_write_at) = (read, write);
        rig.script.fixture = |tick| if tick < 3 { Fixture::Clamped { angle_deg: 4.0 } } else { Fixture::Free };
        let error = rig.run_in_lockstep(0).unwrap_err();
        let LoopError::Device { source, safe_state, .. } = &error else { panic!("{error}") };
        assert_eq!(source.tick, 3);
        assert_eq!(safe_state.is_ok(), write.is_none(), "whether it could be written is said");
        assert_eq!(error.to_string().contains("NOT written"), write.is_some(), "{error}");
        let last = rig.book.samples.last().unwrap();
        assert_eq!((last.tick, last.fault(), last.last()), (3, true, true));
        assert!(last.pressure1_bar.is_nan() && last.voltage_v == 0.0);
        assert!(last.target().is_none() && last.target.is_nan(), "the profile was not asked, or not obeyed");
        assert_eq!(
            last.flags,
            flags::FAULT | flags::LAST | flags::BYPASS_OPEN,
            "no flag of a command that did not act"
        );
        let held: Command = SafeState::default().command(Fixture::Clamped { angle_deg: 4.0 }, 7);
        assert_eq!(
            rig.tank.written.last(),
            Some(&(if read.is_some() { (3, held) } else { (2, rig.tank.written[2].1) }))
        );
    }
}

#[test]
fn a_device_that_fails_at_once_opens_no_clamp() {
    let mut rig = Rig::new(100, 1.0);
    rig.tank.fail_read_at = Some(0);
    rig.script.fixture = |_| Fixture::Clamped { angle_deg: 9.0 };
    rig.run_in_lockstep(0).unwrap_err();
    let safe = SafeState::default().command(Fixture::Clamped { angle_deg: 9.0 }, 0);
    assert_eq!(rig.tank.written, [(0, safe)]);
}

#[test]
fn a_safe_state_that_can_not_be_written_at_the_end_is_an_error() {
    let mut rig = Rig::new(10, 1.0);
    rig.tank.fail_write_at = Some(10);
    let error = rig.run_in_lockstep(0).unwrap_err();
    assert!(error.to_string().contains("NOT written"), "{error}");
    assert!(rig.book.samples.last().unwrap().last(), "whoever follows the samples knows that the run is over");
}

#[test]
fn samples_that_nobody_takes_are_counted_and_do_not_stop_the_loop() {
    for patient in [false, true] {
        let mut rig = Rig::new(100, 0.0);
        (rig.book.room, rig.book.patient) = (60, patient);
        let report = rig.run_in_lockstep(0).unwrap();
        let lost = if patient { 39 } else { 40 };
        assert_eq!((report.statistics.ticks, report.statistics.not_taken), (100, lost));
        assert!(report.to_string().contains(&format!("{lost} samples")));
        assert_eq!(rig.book.samples.last().unwrap().last(), patient, "the last one is handed over again");
        let calls = rig.world.calls().join(", ");
        assert!(calls.ends_with("publish 99, write 100, publish patiently 99"), "not before the rig is safe");
    }
}
