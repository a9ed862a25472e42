//! What trips and what does not.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use rt_core::{
    Breach, Channel, Command, Demand, Fixture, Input, Limits, Measurement, SafeState, Supervisor, Tick, Trip,
};

const GOOD: Measurement = Measurement { angle_deg: 1.0, pressure1_bar: 2.5, pressure2_bar: 2.5, ..Measurement::NONE };

/// Puts a value into the channel under test.
type Set = fn(&mut Measurement, f64);

/// The trip after these measurements, taken one a tick under one fixture.
fn judge(limits: Limits, fixture: Fixture, measurements: impl IntoIterator<Item = Measurement>) -> Option<Trip> {
    let mut supervisor = Supervisor::new(limits).unwrap();
    let command = Command { fixture, voltage_v: 1.0, brake_open: true, bypass_open: false, segment: 0 };
    for (index, measured) in measurements.into_iter().enumerate() {
        let now = Tick::at(index as u64);
        supervisor.check(now, Demand::None, &measured);
        let tripped = supervisor.trip().is_some();
        let released = supervisor.release(now, command);
        assert_eq!(released == command, !tripped, "a command passes unchanged exactly while there is no trip");
    }
    supervisor.trip().copied()
}

#[test]
fn each_limit_trips_on_its_own_side_and_exactly_beyond_it() {
    let limits = Limits::default();
    let (low, high) = (limits.pressure_min_bar, limits.pressure_max_bar);
    let (angle, torque) = (limits.angle_max_deg, limits.torque_max_nm);
    let cases: [(Channel, f64, Breach, Set); 8] = [
        (Channel::Pressure1, low, Breach::Below(low), |m, v| m.pressure1_bar = v),
        (Channel::Pressure1, high, Breach::Above(high), |m, v| m.pressure1_bar = v),
        (Channel::Pressure2, low, Breach::Below(low), |m, v| m.pressure2_bar = v),
        (Channel::Pressure2, high, Breach::Above(high), |m, v| m.pressure2_bar = v),
        (Channel::Angle, -angle, Breach::Below(-angle), |m, v| m.angle_deg = v),
        (Channel::Angle, angle, Breach::Above(angle), |m, v| m.angle_deg = v),
        (Channel::Torque, -torque, Breach::Below(-torque), |m, v| m.torque_nm = v),
        (Channel::Torque, torque, Breach::Above(torque), |m, v| m.torque_nm = v),
    ];
    for (channel, limit, breach, set) in cases {
        let outwards = if matches!(breach, Breach::Above(_)) { 1e-9 } else { -1e-9 };
        let (mut at, mut beyond, mut far) = (GOOD, GOOD, GOOD);
        set(&mut at, limit);
        set(&mut beyond, limit + outwards);
        set(&mut far, f64::INFINITY * outwards);
        let clamped = Fixture::Clamped { angle_deg: 0.0 };
        assert_eq!(judge(limits, clamped, [GOOD, at]), None, "{channel:?} at its limit");
        let trip = judge(limits, clamped, [GOOD, beyond]).expect("beyond the limit");
        assert_eq!((trip.tick, trip.channel, trip.value, trip.breach), (1, channel, limit + outwards, breach));
        assert_eq!(judge(limits, clamped, [far]).map(|t| t.channel), Some(channel), "infinite at the first tick");
    }
}

#[test]
fn velocity_is_judged_over_its_window_and_only_while_the_lever_is_free() {
    let limits = Limits { velocity_max_deg_s: 100.0, velocity_window_ticks: 10, ..Limits::default() };
    let moving = |deg_s: f64| (0..100).map(move |k| Measurement { angle_deg: -5.0 + deg_s * 1e-3 * k as f64, ..GOOD });
    assert_eq!(judge(limits, Fixture::Free, moving(99.0)), None);
    for sign in [1.0, -1.0] {
        let trip = judge(limits, Fixture::Free, moving(sign * 101.0)).unwrap();
        assert_eq!((trip.channel, trip.breach == Breach::Above(100.0)), (Channel::Velocity, sign > 0.0));
        assert!((trip.value - sign * 101.0).abs() < 1e-6);
        assert_eq!(trip.tick, 11, "the fixture is known from tick 1 on, the window is full 10 ticks later");
    }
    assert_eq!(judge(limits, Fixture::Driven { angle_deg: 0.0 }, moving(500.0)), None);
}

#[test]
fn encoder_noise_is_no_velocity() {
    let limits = Limits { velocity_max_deg_s: 100.0, velocity_window_ticks: 10, ..Limits::default() };
    // Alternating by 0.2 deg: 200 deg/s from tick to tick.
    let noisy = (0..200).map(|k| Measurement { angle_deg: if k % 3 == 0 { 0.1 } else { -0.1 }, ..GOOD });
    assert_eq!(judge(limits, Fixture::Free, noisy), None);
}

#[test]
fn what_must_be_measured_depends_on_the_fixture() {
    let limits = Limits { missing_max_ticks: 5, ..Limits::default() };
    let without_angle = || (0..50).map(|_| Measurement { angle_deg: f64::NAN, ..GOOD });
    let without_pressure = || (0..50).map(|_| Measurement { pressure2_bar: f64::NAN, ..GOOD });
    let bench = Fixture::PumpBench { pressure1_bar: 2.0, pressure2_bar: 2.0 };
    assert_eq!(judge(limits, bench, without_angle()), None);
    let trip = judge(limits, bench, without_pressure()).unwrap();
    // Nothing is required before the first command says what the rig is.
    assert_eq!((trip.tick, trip.channel, trip.breach), (6, Channel::Pressure2, Breach::Missing(5)));
    for fixture in [Fixture::Free, Fixture::Clamped { angle_deg: 0.0 }, Fixture::Driven { angle_deg: 0.0 }] {
        assert_eq!(judge(limits, fixture, without_angle()).map(|t| t.channel), Some(Channel::Angle));
    }
}

#[test]
fn a_slow_sensor_that_answers_in_time_is_not_missing() {
    let limits = Limits { missing_max_ticks: 9, ..Limits::default() };
    let every =
        |n: u32| (0..500).map(move |k| Measurement { pressure1_bar: if k % n == 0 { 2.0 } else { f64::NAN }, ..GOOD });
    assert_eq!(judge(limits, Fixture::Free, every(10)), None);
    assert_eq!(judge(limits, Fixture::Free, every(11)).map(|t| t.channel), Some(Channel::Pressure1));
}

#[test]
fn the_first_breach_counts() {
    let limits = Limits::default();
    let trip = judge(
        limits,
        Fixture::Free,
        [GOOD, Measurement { pressure1_bar: 9.0, ..GOOD }, Measurement { angle_deg: 90.0, ..GOOD }, GOOD],
    );
    assert_eq!(trip.map(|t| (t.tick, t.channel)), Some((1, Channel::Pressure1)));
    assert_eq!(trip.unwrap().to_string(), "pressure 1 9.0000 bar above 8 bar at tick 1");
}

#[test]
fn limits_that_can_t_be_enforced_are_refused() {
    let good = Limits::default();
    let bad = [
        (Limits { pressure_max_bar: f64::NAN, ..good }, "pressure_max_bar"),
        (Limits { pressure_min_bar: 9.0, ..good }, "pressure_max_bar"),
        (Limits { pressure_min_bar: f64::NEG_INFINITY, ..good }, "pressure_min_bar"),
        (Limits { angle_max_deg: 0.0, ..good }, "angle_max_deg"),
        (Limits { velocity_max_deg_s: f64::INFINITY, ..good }, "velocity_max_deg_s"),
        (Limits { torque_max_nm: -1.0, ..good }, "torque_max_nm"),
        (Limits { velocity_window_ticks: 0, ..good }, "velocity_window_ticks"),
        (Limits { velocity_window_ticks: 65, ..good }, "velocity_window_ticks"),
        (Limits { age_max_ms: 0.9, ..good }, "age_max_ms"),
        (Limits { age_max_ms: u32::MAX as f64 * 1e-6, ..good }, "age_max_ms"),
        (Limits { age_max_ms: f64::INFINITY, ..good }, "age_max_ms"),
        (Limits { heartbeat_max_ms: f64::NAN, ..good }, "heartbeat_max_ms"),
        (Limits { heartbeat_max_ms: u32::MAX as f64 * 1e-6, ..good }, "heartbeat_max_ms"),
        (Limits { heartbeat_max_ms: 60_000.0, ..good }, "heartbeat_max_ms"),
        (Limits { voltage_max_v: f64::INFINITY, ..good }, "voltage_max_v"),
        (Limits { slew_max_v_s: 0.0, ..good }, "slew_max_v_s"),
        (Limits { slew_max_v_s: f64::NAN, ..good }, "slew_max_v_s"),
    ];
    for (limits, field) in bad {
        assert_eq!(Supervisor::new(limits).unwrap_err().field, field);
    }
}

#[test]
fn the_largest_limits_of_an_age_still_trip() {
    let most_ms = (u32::MAX - 1) as f64 * 1e-6;
    let limits = Limits { age_max_ms: most_ms, heartbeat_max_ms: most_ms, ..Limits::default() };
    let old = |age_ns: u32| {
        let mut measured = GOOD;
        measured.age_ns[Input::Angle as usize] = age_ns;
        (0..20).map(move |_| measured)
    };
    let silent = |heartbeat_age_ns: u32| (0..20).map(move |_| Measurement { heartbeat_age_ns, ..GOOD });
    assert_eq!(judge(limits, Fixture::Free, old(u32::MAX - 1)), None);
    assert_eq!(judge(limits, Fixture::Free, old(u32::MAX)).map(|trip| trip.channel), Some(Channel::Angle));
    assert_eq!(judge(limits, Fixture::Free, silent(u32::MAX - 1)), None);
    assert_eq!(judge(limits, Fixture::Free, silent(u32::MAX)).map(|trip| trip.channel), Some(Channel::Heartbeat));
}

#[test]
fn age_is_judged_where_a_value_is_required_and_exactly_beyond_its_limit() {
    let limits = Limits { age_max_ms: 20.0, missing_max_ticks: 5, ..Limits::default() };
    let aged = |input: Input, age_ns: u32| {
        let mut measured = GOOD;
        measured.age_ns[input as usize] = age_ns;
        (0..20).map(move |_| measured)
    };
    for (input, channel) in
        [(Input::Pressure1, Channel::Pressure1), (Input::Pressure2, Channel::Pressure2), (Input::Angle, Channel::Angle)]
    {
        assert_eq!(judge(limits, Fixture::Free, aged(input, 20_000_000)), None);
        let trip = judge(limits, Fixture::Free, aged(input, 20_000_001)).unwrap();
        assert_eq!((trip.tick, trip.channel, trip.breach), (1, channel, Breach::Stale(20.0)));
        assert!((trip.value - 20.000001).abs() < 1e-9, "the age is told, ms");
        assert_eq!(judge(limits, Fixture::Free, aged(input, u32::MAX)).map(|t| t.channel), Some(channel));
    }
    assert_eq!(judge(limits, Fixture::Free, aged(Input::Torque, u32::MAX)), None, "nobody needs one");
    let torque = |age_ns| aged(Input::Torque, age_ns).map(|measured| Measurement { torque_nm: 1.0, ..measured });
    assert_eq!(judge(limits, Fixture::Free, torque(20_000_000)), None);
    let trip = judge(limits, Fixture::Free, torque(20_000_001)).expect("one that is there is held against its limit");
    assert_eq!((trip.channel, trip.breach), (Channel::Torque, Breach::Stale(20.0)));
    let bench = Fixture::PumpBench { pressure1_bar: 2.0, pressure2_bar: 2.0 };
    assert_eq!(judge(limits, bench, aged(Input::Angle, u32::MAX)), None, "there is no lever");
}

#[test]
fn what_the_device_calls_wrong_is_missing_and_its_size_is_not_judged() {
    let limits = Limits { missing_max_ticks: 5, ..Limits::default() };
    let wrong = |ticks| {
        (0..50).map(move |k| Measurement {
            pressure1_bar: if k % 10 < ticks { 99.0 } else { 2.5 },
            faulty: if k % 10 < ticks { Input::Pressure1.bit() } else { 0 },
            ..GOOD
        })
    };
    assert_eq!(judge(limits, Fixture::Free, wrong(5)), None);
    let trip = judge(limits, Fixture::Free, wrong(6)).unwrap();
    assert_eq!((trip.tick, trip.channel, trip.breach), (15, Channel::Pressure1, Breach::Missing(5)));
}

/// The voltages released for these wanted ones, at these ticks.
fn released(supervisor: &mut Supervisor, wanted: &[(u64, f64)]) -> Vec<(f64, bool)> {
    wanted
        .iter()
        .map(|&(index, voltage_v)| {
            let command =
                Command { fixture: Fixture::Free, voltage_v, brake_open: true, bypass_open: false, segment: 0 };
            let released = supervisor.release(Tick::at(index), command);
            assert_eq!(Command { voltage_v, ..released }, command, "nothing but the voltage is held back");
            (released.voltage_v, supervisor.slew_limited())
        })
        .collect()
}

#[test]
fn the_voltage_follows_no_faster_than_its_slew_limit_and_it_is_said() {
    let mut supervisor = Supervisor::new(Limits { slew_max_v_s: 2000.0, ..Limits::default() }).unwrap();
    let up = released(&mut supervisor, &[(0, 5.0), (1, 5.0), (2, 5.0), (3, 5.0)]);
    assert_eq!(up, [(2.0, true), (4.0, true), (5.0, false), (5.0, false)], "a run begins at 0 V");
    let down = released(&mut supervisor, &[(4, -1.0), (5, -1.0), (6, -1.0), (7, -1.5)]);
    assert_eq!(down, [(3.0, true), (1.0, true), (-1.0, false), (-1.5, false)]);
    // Where ticks were passed over, so much more time has passed.
    assert_eq!(released(&mut supervisor, &[(10, 9.0), (11, 9.0)]), [(4.5, true), (6.5, true)]);
    supervisor.begin_run();
    assert_eq!(released(&mut supervisor, &[(0, 9.0)]), [(2.0, true)], "another run, from 0 V again");
    assert_eq!(supervisor.trip(), None);
}

#[test]
fn the_slew_limit_hides_no_command_that_is_too_large_and_does_not_delay_the_safe_state() {
    let limits = Limits { slew_max_v_s: 100.0, voltage_max_v: 24.0, ..Limits::default() };
    let mut supervisor = Supervisor::new(limits).unwrap();
    released(&mut supervisor, &[(0, 10.0), (1, 10.0), (2, 10.0)]);
    let fixture = Fixture::Free;
    let command = Command { fixture, voltage_v: 24.1, brake_open: true, bypass_open: false, segment: 3 };
    let at = Tick::at(3);
    assert_eq!(supervisor.release(at, command), SafeState::default().command(fixture, 3));
    let trip = supervisor.trip().unwrap();
    assert_eq!((trip.channel, trip.value, trip.breach), (Channel::Voltage, 24.1, Breach::Above(24.0)));
    assert!(!supervisor.slew_limited());
}
