//! What each kind does at the boundary, value by value.

use crate::played::{ANGLE, FREE, Played, Ramp, fault, play};
use drivers::faults::Faulty;
use drivers::journal::JournalReader;
use rt_core::fault::{FaultKind, Route, Valve};
use rt_core::{Device, Input, Tick};

#[test]
fn a_lost_frame_leaves_the_value_before_to_grow_old() {
    let played = play(&[fault(FaultKind::Lost { route: Route::Input(ANGLE) }, 10, 3)], 0, 20);
    let seen: Vec<_> = (9..14).map(|k| played.angle(k)).collect();
    assert_eq!(seen, [(9.0, 0), (9.0, 1), (9.0, 2), (9.0, 3), (13.0, 0)]);
    assert_eq!(played.at(12).pressure1_bar, 2.0 + 12.0 * 1e-4, "another sensor was hit");
    assert_eq!(played.at(12).faulty, 0);
    // From the first tick on nothing was ever heard.
    let never = play(&[fault(FaultKind::Lost { route: Route::Input(ANGLE) }, 0, 3)], 0, 5);
    assert!(never.at(2).angle_deg.is_nan() && never.at(2).age_ns[0] == 2_000_000 && never.angle(3) == (3.0, 0));
}

#[test]
fn a_late_frame_comes_with_its_age_and_never_after_a_newer_one() {
    let late = |unnoticed| FaultKind::Late { route: Route::Input(ANGLE), ticks: 3, unnoticed };
    let played = play(&[fault(late(false), 10, 6)], 0, 30);
    let seen: Vec<_> = (9..20).map(|k| played.angle(k)).collect();
    let expected = [(9, 0), (9, 1), (9, 2), (9, 3), (10, 3), (11, 3), (12, 3), (16, 0), (17, 0), (18, 0), (19, 0)];
    assert_eq!(seen, expected.map(|(value, age)| (f64::from(value), age)));
    let unnoticed = play(&[fault(late(true), 10, 6)], 0, 30);
    let seen: Vec<_> = (12..18).map(|k| unnoticed.angle(k)).collect();
    assert_eq!(seen, [(9.0, 3), (10.0, 0), (11.0, 0), (12.0, 0), (16.0, 0), (17.0, 0)]);
}

#[test]
fn a_repeated_frame_is_old_whether_the_driver_knows_or_not() {
    let repeated = |unnoticed| play(&[fault(FaultKind::Repeated { input: ANGLE, unnoticed }, 10, 2)], 0, 20);
    let seen = |played: &Played| (9..13).map(|k| played.angle(k)).collect::<Vec<_>>();
    assert_eq!(seen(&repeated(false)), [(9.0, 0), (9.0, 1), (9.0, 2), (12.0, 0)]);
    assert_eq!(seen(&repeated(true)), [(9.0, 0), (9.0, 0), (9.0, 0), (12.0, 0)]);
}

#[test]
fn swapped_frames_come_in_pairs_and_the_older_is_passed_over() {
    let swapped = |unnoticed| play(&[fault(FaultKind::Swapped { input: ANGLE, unnoticed }, 10, 4)], 0, 20);
    let seen = |played: &Played| (9..15).map(|k| played.angle(k)).collect::<Vec<_>>();
    assert_eq!(seen(&swapped(false)), [(9.0, 0), (9.0, 1), (11.0, 0), (11.0, 1), (13.0, 0), (14.0, 0)]);
    // Who can't tell takes frame 10 after 11 for the newer one.
    assert_eq!(seen(&swapped(true)), [(9.0, 0), (9.0, 1), (10.0, 0), (10.0, 1), (12.0, 0), (14.0, 0)]);
}

#[test]
fn a_flipped_bit_has_its_weight() {
    let flip = |bit| FaultKind::BitFlip { input: ANGLE, bit, low: 0.0, high: 65_535.0 };
    let played = play(&[fault(flip(Some(3)), 10, 10)], 0, 30);
    for k in 10..20 {
        assert_eq!(played.angle(k), (f64::from(k as u32 ^ 8), 0));
    }
    assert_eq!(played.angle(20), (20.0, 0));
    let any = play(&[fault(flip(None), 10, 400)], 7, 500);
    let mut bits = [0; 16];
    for k in 10..410 {
        let flipped = any.angle(k).0 as u32 ^ k as u32;
        assert!(flipped.is_power_of_two() && flipped < 1 << 16, "tick {k}: {flipped:b}");
        bits[flipped.trailing_zeros() as usize] += 1;
    }
    assert!(bits.iter().all(|&count| count > 5), "{bits:?}");
}

#[test]
fn a_refused_frame_is_lost_and_called_wrong_at_its_tick() {
    let played = play(&[fault(FaultKind::CrcError { input: Input::Pressure2 }, 10, 1)], 0, 20);
    let refused = played.at(10);
    assert_eq!((refused.pressure2_bar, refused.age_ns[2]), (3.0 - 9.0 * 1e-4, 1_000_000));
    assert_eq!((refused.faulty, played.at(9).faulty, played.at(11).faulty), (Input::Pressure2.bit(), 0, 0));
}

#[test]
fn sensors_stick_drift_and_say_no_number() {
    let faults = [
        fault(FaultKind::Stuck { input: ANGLE }, 10, 5),
        fault(FaultKind::Drift { input: Input::Pressure1, per_s: 2.0 }, 10, 5),
        fault(FaultKind::Nan { input: Input::Torque }, 10, 5),
    ];
    let (with, without) = (play(&faults, 0, 30), play(&[], 0, 30));
    for k in 0..30 {
        let (seen, true_) = (with.at(k), without.at(k));
        let acts = (10..15).contains(&k);
        assert_eq!(seen.angle_deg, if acts { 10.0 } else { k as f64 });
        let offset_bar = if acts { 2e-3 * (k - 10) as f64 } else { 0.0 };
        assert!((seen.pressure1_bar - true_.pressure1_bar - offset_bar).abs() < 1e-12, "tick {k}");
        assert_eq!(seen.torque_nm.is_nan(), acts);
        assert_eq!((seen.age_ns, seen.faulty), ([0; 5], 0), "a sensor's own fault looks fresh");
    }
}

#[test]
fn a_port_that_is_gone_is_0_v_after_the_time_out_and_until_it_is_armed() {
    let faults = [fault(FaultKind::PortGone { timeout_ticks: 4 }, 10, 10)];
    let played = play(&faults, 0, 40);
    let volts = played.volts();
    assert_eq!(volts[..14], [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 9, 0].map(|mv| f64::from(mv) * 1e-3));
    assert!(volts[13..40].iter().all(|&v| v == 0.0), "{volts:?}");
    let ages: Vec<u32> = (8..22).map(|k| played.at(k).heartbeat_age_ns / 1_000_000).collect();
    assert_eq!(ages, [0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 0, 0]);
    assert_eq!(played.at(15).age_ns, [0; 5], "sensors are on another wire");
    assert!(played.told.iter().take(40).all(|(k, told)| told.bypass_open == (k % 2 == 1)), "and so are valves");

    let mut journals = JournalReader::default();
    let ramp = Ramp::default();
    let told = ramp.told.clone();
    let mut device = Faulty::new(ramp, &faults, 0, journals.journal("faults")).unwrap();
    for tick in 0..40 {
        device.read(Tick::at(tick)).unwrap();
        if tick == 15 || tick == 30 {
            device.arm();
        }
        device.write(Tick::at(tick), &FREE).unwrap();
    }
    let volts: Vec<f64> = told.borrow().iter().map(|(_, command)| command.voltage_v).collect();
    assert_eq!((volts[29], volts[30], volts[39]), (0.0, 5.0, 5.0), "the word counts once the port is back");
}

#[test]
fn on_a_bus_that_is_off_everything_grows_old_and_the_nodes_go_safe() {
    let played = play(&[fault(FaultKind::BusOff { timeout_ticks: 4 }, 11, 10)], 0, 40);
    for k in 11..21 {
        let measured = played.at(k);
        let age_ns = (k as u32 - 10) * 1_000_000;
        assert_eq!((measured.angle_deg, measured.pressure2_bar), (10.0, 3.0 - 10.0 * 1e-4));
        assert_eq!((measured.age_ns, measured.heartbeat_age_ns), ([age_ns; 5], age_ns));
        let told = played.told[k].1;
        assert_eq!(told.voltage_v, k as f64 * 1e-3, "the amplifier is on another wire");
        // Tick 10 closed the bypass and opened the brake.
        let expected = if k < 14 { (true, false) } else { (false, true) };
        assert_eq!((told.brake_open, told.bypass_open), expected, "tick {k}");
    }
    assert_eq!((played.angle(21), played.at(21).heartbeat_age_ns), ((21.0, 0), 0));
    assert!(played.told[21].1.brake_open && played.told[21].1.bypass_open, "back, and obeyed at once");
}

#[test]
fn an_amplifier_fault_fails_the_read_by_its_code_and_takes_the_voltage() {
    let played = play(&[fault(FaultKind::AmplifierFault { code: 4 }, 10, 5)], 0, 30);
    for k in 10..15 {
        let error = played.read[k].clone().unwrap_err();
        assert!(error.tick == k as u64 && error.to_string().contains("fault code 4"), "{error}");
    }
    assert!(played.volts()[10..30].iter().all(|&v| v == 0.0) && played.volts()[9] > 0.0);
    assert!(played.read[15..].iter().all(Result::is_ok));
}

#[test]
fn a_valve_stands_as_it_stood_or_as_is_said() {
    let stuck = |valve, open| play(&[fault(FaultKind::ValveStuck { valve, open }, 10, 6)], 0, 30);
    let bypass = |played: &Played| played.told[..30].iter().map(|(_, told)| told.bypass_open).collect::<Vec<_>>();
    let as_said: Vec<bool> = (0..30).map(|k| k % 2 == 1).collect();
    for (open, stands) in [(None, true), (Some(true), true), (Some(false), false)] {
        let seen = bypass(&stuck(Valve::Bypass, open));
        let expected: Vec<bool> = (0..30).map(|k| if (10..16).contains(&k) { stands } else { as_said[k] }).collect();
        assert_eq!(seen, expected, "{open:?}");
    }
    let brake = stuck(Valve::Brake, Some(false));
    assert_eq!(bypass(&brake), as_said);
    let closed: Vec<u64> = brake.told[..30].iter().filter(|(_, told)| !told.brake_open).map(|(k, _)| *k).collect();
    assert_eq!(closed, [10, 11, 12, 13, 14, 15]);
}

#[test]
fn commands_are_lost_and_late() {
    let lost = FaultKind::Lost { route: Route::Voltage { timeout_ticks: 3 } };
    let mv = |played: &Played| played.volts()[8..20].iter().map(|v| (v * 1e3).round() as u32).collect::<Vec<_>>();
    assert_eq!(mv(&play(&[fault(lost, 10, 5)], 0, 30)), [8, 9, 9, 9, 0, 0, 0, 15, 16, 17, 18, 19]);
    let late = FaultKind::Late { route: Route::Voltage { timeout_ticks: 100 }, ticks: 3, unnoticed: false };
    assert_eq!(mv(&play(&[fault(late, 10, 5)], 0, 30)), [8, 9, 9, 9, 9, 10, 11, 15, 16, 17, 18, 19]);
    let valves = FaultKind::Lost { route: Route::Valves { timeout_ticks: 3 } };
    let played = play(&[fault(valves, 10, 5)], 0, 30);
    let seen: Vec<_> = played.told[9..16].iter().map(|(_, told)| (told.brake_open, told.bypass_open)).collect();
    let (commanded, safe) = ((true, true), (false, true));
    assert_eq!(seen, [commanded, commanded, commanded, safe, safe, safe, commanded]);
    assert!(played.volts()[10..15].iter().all(|&v| v > 0.0));
}
