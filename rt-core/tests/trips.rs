//! Every cause of a trip, through the loop: safe within the tick, told by the sample, latched over runs.

mod common;

use std::collections::BTreeSet;

use common::world::{At, Forge, Rig, Thrower, limits};
use rt_core::{
    Breach, Channel, Command, Ended, Fixture, Input, Limits, LoopError, OverrunPolicy, SafeState, Switches, Trip, flags,
};

/// Brake and bypass the other way round than by default.
const SAFE: SafeState = SafeState { brake_open: true, bypass_open: false };

/// The rig at tick 20 and what must come of it.
struct Cause {
    name: &'static str,
    bring_about: fn(&mut Rig),
    /// Of the trip.
    tick: u64,
    channel: Channel,
    breach: Breach,
}

const FROM: u64 = 20;

fn forge(rig: &mut Rig, forge: Forge) {
    rig.tank.forge = Some((FROM, forge));
}

fn causes() -> Vec<Cause> {
    use Breach::{Above, Below, Demanded, Missing, NotFinite, Stale};
    use Channel::*;
    let cause = |name, channel, breach, bring_about| Cause { name, bring_about, tick: FROM, channel, breach };
    let after_three = |cause| Cause { tick: FROM + 3, ..cause };
    vec![
        cause("p1 low", Pressure1, Below(0.5), |rig| forge(rig, |m| m.pressure1_bar = 0.4)),
        cause("p1 high", Pressure1, Above(3.0), |rig| forge(rig, |m| m.pressure1_bar = 3.1)),
        cause("p2 low", Pressure2, Below(0.5), |rig| forge(rig, |m| m.pressure2_bar = f64::MIN)),
        cause("p2 high", Pressure2, Above(3.0), |rig| forge(rig, |m| m.pressure2_bar = f64::MAX)),
        cause("angle left", Angle, Below(-60.0), |rig| forge(rig, |m| m.angle_deg = -60.1)),
        cause("angle right", Angle, Above(60.0), |rig| forge(rig, |m| m.angle_deg = 60.1)),
        cause("velocity", Velocity, Below(-1000.0), |rig| forge(rig, |m| m.angle_deg = -10.1)),
        cause("torque", Torque, Above(80.0), |rig| forge(rig, |m| m.torque_nm = 81.0)),
        after_three(cause("p1 missing", Pressure1, Missing(3), |rig| forge(rig, |m| m.pressure1_bar = f64::NAN))),
        after_three(cause("angle missing", Angle, Missing(3), |rig| forge(rig, |m| m.angle_deg = f64::NAN))),
        after_three(cause("p2 faulty", Pressure2, Missing(3), |rig| forge(rig, |m| m.faulty = Input::Pressure2.bit()))),
        after_three(cause("p2 infinite", Pressure2, Missing(3), |rig| forge(rig, |m| m.pressure2_bar = f64::INFINITY))),
        cause("p2 stale", Pressure2, Stale(20.0), |rig| forge(rig, |m| m.age_ns[2] = 20_000_001)),
        cause("heartbeat", Heartbeat, Stale(100.0), |rig| forge(rig, |m| m.heartbeat_age_ns = 100_000_001)),
        cause("voltage above", Voltage, Above(48.0), |rig| rig.follow.answer = Some((FROM, 48.1))),
        cause("voltage below", Voltage, Below(-48.0), |rig| rig.follow.answer = Some((FROM, -48.1))),
        cause("voltage infinite", Voltage, NotFinite, |rig| rig.follow.answer = Some((FROM, f64::INFINITY))),
        cause("voltage NaN", Voltage, NotFinite, |rig| rig.follow.answer = Some((FROM, f64::NAN))),
        cause("emergency stop", EmergencyStop, Demanded, |rig| {
            rig.people = Box::new(Thrower { at: FROM, switches: Switches::new() });
        }),
        cause("deadline", Deadline, Above(1.0), |rig| {
            rig.overrun = OverrunPolicy::SafeState;
            rig.world.delay(At::Control, FROM - 1, 1.0);
        }),
    ]
}

fn rig(cause: &Cause) -> Rig {
    let mut rig = Rig::with(Limits { safe_state: SAFE, ..limits() }, 1000, 0.1);
    (cause.bring_about)(&mut rig);
    rig
}

#[test]
fn every_cause_is_safe_within_its_tick_latches_over_runs_and_is_told_by_the_sample() {
    for cause in causes() {
        let (name, at) = (cause.name, cause.tick);
        let mut rig = rig(&cause);
        let report = rig.run(0).unwrap();
        let trip: Trip = report.trip.unwrap_or_else(|| panic!("{name}: no trip"));
        assert_eq!((trip.tick, trip.channel, trip.breach), (at, cause.channel, cause.breach), "{name}");
        assert_eq!(report.ended, Ended::Tripped, "{name}");

        // The device, tick by tick: the profile's command before, the safe state from the trip's own tick on.
        for (tick, command) in &rig.tank.written {
            let safe: Command = SAFE.command(Fixture::Free, command.segment);
            assert_eq!(*command == safe, *tick >= at, "{name}, tick {tick}: {command:?}");
            assert!(*tick >= at || command.voltage_v == 0.1, "{name}, tick {tick}");
        }
        let written: BTreeSet<u64> = rig.tank.written.iter().map(|(tick, _)| *tick).collect();
        assert!(written.iter().copied().eq(0..=at + 6), "{name}: every tick, and once more after the last");

        let (before, after) = rig.book.samples.split_at(at as usize);
        assert!(before.iter().all(|s| (s.trip, s.tripped()) == (0, false)), "{name}");
        assert!(after.iter().all(|s| (s.trip, s.tripped()) == (trip.code(), true)), "{name}");
        assert!(after.iter().all(|s| s.voltage_v == 0.0 && s.brake_open() && !s.bypass_open()), "{name}");
        assert_eq!(after.len(), 6, "{name}: its own tick and 5 of aftermath");
        assert_eq!(trip.code() & 0xff, cause.channel as u32, "{name}");
        assert_eq!(Channel::of_code(trip.code()), Some(cause.channel), "{name}");
        assert!(!rig.world.calls().contains(&format!("control {}", at + 1)), "{name}");

        // The cause is gone, the trip is not.
        rig.tank.forge = None;
        rig.follow.answer = None;
        rig.people = Box::new(());
        for number in 1..4 {
            let Err(LoopError::StillTripped { run, trip: latched }) = rig.run(number) else {
                panic!("{name}: {number}")
            };
            // The value may be NaN, which is not equal to itself.
            assert_eq!((run, latched.to_string()), (number, trip.to_string()), "{name}");
        }
        rig.supervisor.reset();
        rig.script.ticks = 5;
        assert_eq!(rig.run(4).map(|report| report.ended), Ok(Ended::Completed), "{name}: after the reset");
    }
}

#[test]
fn each_kind_of_cause_has_a_number_of_its_own() {
    let codes = |cause: &Cause| Trip { tick: 0, channel: cause.channel, value: 0.0, breach: cause.breach }.code();
    let all = causes();
    let kinds: BTreeSet<(u32, &str)> = all
        .iter()
        .map(|cause| {
            let breach = match cause.breach {
                Breach::Below(_) => "below",
                Breach::Above(_) => "above",
                Breach::NotFinite => "not finite",
                Breach::Missing(_) => "missing",
                Breach::Stale(_) => "stale",
                Breach::Demanded => "demanded",
            };
            (cause.channel as u32, breach)
        })
        .collect();
    assert_eq!(all.iter().map(codes).collect::<BTreeSet<_>>().len(), kinds.len());
    // As documented, and as other languages read it.
    assert_eq!(all.iter().map(codes).next(), Some(1 | 1 << 8));
    assert_eq!(all.last().map(codes), Some(8 | 2 << 8));
    assert_eq!(Channel::of_code(0), None);
    for channel in Channel::ALL {
        assert_eq!(Channel::of_code(channel as u32 | 4 << 8), Some(channel));
    }
}

/// What holds the lever, tick by tick.
type Profile = fn(u64) -> Fixture;

#[test]
fn no_clamp_opens_and_nothing_is_led_filled_or_drained_in_the_safe_state() {
    let clamped = Fixture::Clamped { angle_deg: 8.0 };
    let bench = Fixture::PumpBench { pressure1_bar: 2.0, pressure2_bar: 3.0 };
    let cases: [(Profile, Fixture); 6] = [
        (|_| Fixture::Free, Fixture::Free),
        (|_| Fixture::Clamped { angle_deg: 8.0 }, clamped),
        (|_| Fixture::Driven { angle_deg: 8.0 }, clamped),
        (|_| Fixture::Filled { angle_deg: 8.0, pressure1_bar: 2.0, pressure2_bar: 3.0 }, clamped),
        (|_| Fixture::Released { angle_deg: 8.0, flow_ml_s: 1.0 }, clamped),
        (|_| Fixture::PumpBench { pressure1_bar: 2.0, pressure2_bar: 3.0 }, bench),
    ];
    for (fixture, at_rest) in cases {
        let mut rig = Rig::new(1000, 0.1);
        rig.script.fixture = fixture;
        forge(&mut rig, |m| m.pressure1_bar = 99.0);
        rig.run_in_lockstep(0).unwrap();
        assert_eq!(rig.tank.written[19].1.fixture, fixture(0));
        assert!(rig.tank.written[20..].iter().all(|(_, command)| command.fixture == at_rest), "{at_rest:?}");
    }
}

#[test]
fn the_first_cause_counts_and_a_stop_after_it_ends_a_tripped_run() {
    let mut rig = Rig::new(1000, 0.1);
    forge(&mut rig, |m| m.pressure1_bar = 99.0);
    rig.people =
        Box::new(common::world::People(vec![(22, rt_core::Demand::EmergencyStop), (24, rt_core::Demand::Stop)]));
    let report = rig.run_in_lockstep(0).unwrap();
    assert_eq!(report.ended, Ended::Tripped);
    assert_eq!(report.trip.map(|trip| (trip.tick, trip.channel)), Some((20, Channel::Pressure1)));
    let last = rig.book.samples.last().unwrap();
    assert_eq!((last.tick, last.flags & (flags::LAST | flags::STOPPED | flags::TRIPPED)), (24, 4 | 8 | 64));
}
