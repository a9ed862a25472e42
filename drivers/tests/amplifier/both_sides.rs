//! Over the list of protocols: the bench's side and the drive's side understand each other.

use super::{Pair, heard, settings, state};
use drivers::amplifier::{AmplifierError, DriveState, Firmware, Garbled, Outbox, PROTOCOLS, Telemetry, Told, protocol};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MS: u64 = 1_000_000;

/// Requests after which every quantity was told.
const ROUND: usize = 8;

fn close(told: f32, meant: f32, step: f32, what: &str, protocol: &str) {
    // Half a step of the wire, and the rounding of f32.
    let tolerance = 0.501 * step + 1e-6 * meant.abs();
    assert!((told - meant).abs() <= tolerance, "{protocol}: {what} {meant} came as {told}");
}

proptest! {
    #[test]
    fn a_voltage_arrives_within_the_resolution(voltage_v in -30.0..30.0_f64, reversed: bool, drive_reversed: bool) {
        for kind in PROTOCOLS {
            let (mut here, mut there) = (settings(kind), settings(kind));
            (here.reversed, there.reversed) = (reversed, drive_reversed);
            let mut pair = Pair::with(kind, &here, &there);
            let step_v = pair.client.resolution_v();
            let (commanded, _) = pair.exchange(0, |client, out| client.command(voltage_v, out));
            // Where the two disagree on the wiring the motor turns the other way.
            let meant = if reversed == drive_reversed { voltage_v } else { -voltage_v }.clamp(-12.0, 12.0);
            let error_v = (commanded.unwrap() - meant).abs();
            prop_assert!(error_v <= 0.5001 * step_v, "{}: {meant} V came as {commanded:?}", kind.name);
            prop_assert_eq!(Some(pair.drive.voltage_v(0)), commanded);
            prop_assert!(step_v < 1e-3);
        }
    }

    #[test]
    fn telemetry_arrives(
        supply_v in 5.0..60.0_f32, current_a in -80.0..80.0_f32, rpm in -6000.0..6000.0_f32, duty in -1.0..1.0_f32,
        celsius in -20.0..120.0_f32, faulty: bool, reversed: bool,
    ) {
        for kind in PROTOCOLS {
            let mut settings = settings(kind);
            settings.reversed = reversed;
            let mut pair = Pair::with(kind, &settings, &settings);
            let fault = faulty.then_some(kind.example_fault);
            pair.state = DriveState { telemetry: Telemetry {
                supply_v, motor_current_a: current_a, speed_rpm: rpm, duty, temperature_c: celsius, fault,
            } };
            let mut last = None;
            for _ in 0..ROUND {
                let (_, told) = pair.exchange(0, |client, out| client.request(out));
                let [Told::Telemetry(telemetry)] = told[..] else { panic!("{}: {told:?}", kind.name) };
                last = Some(telemetry);
            }
            let told = last.unwrap();
            close(told.supply_v, supply_v, 0.1, "supply", kind.name);
            close(told.motor_current_a, current_a, 0.01, "current", kind.name);
            close(told.speed_rpm, rpm, 1.0, "speed", kind.name);
            close(told.duty, duty, 1e-3, "duty", kind.name);
            if !told.temperature_c.is_nan() {
                close(told.temperature_c, celsius, 0.1, "temperature", kind.name);
            }
            prop_assert_eq!(told.fault, fault);
        }
    }

    #[test]
    fn any_pieces_say_the_same(cuts in prop::collection::vec(1..40_usize, 1..200), voltage_v in -12.0..12.0_f64) {
        for kind in PROTOCOLS {
            // What the client says goes to the drive in pieces, and its answers go back in pieces.
            let (mut whole, mut pieces) = (Pair::of(kind), Pair::of(kind));
            let mut out = Outbox::new();
            for pair in [&mut whole, &mut pieces] {
                out.clear();
                pair.client.hello(&mut out);
                out.push(&[2, 3, 1, 100]);
                for _ in 0..3 {
                    pair.client.command(voltage_v, &mut out);
                    pair.client.request(&mut out);
                    pair.client.keep_alive(&mut out);
                }
            }
            let (mut back, mut back_again) = (Outbox::new(), Outbox::new());
            let commanded = whole.drive.hear(out.bytes(), 0, &whole.state, &mut back);
            let mut commanded_again = None;
            for piece in cut(out.bytes(), &cuts) {
                let heard = pieces.drive.hear(piece, 0, &pieces.state, &mut back_again);
                commanded_again = heard.or(commanded_again);
            }
            prop_assert_eq!(commanded, commanded_again);
            prop_assert!(commanded.is_some());
            prop_assert_eq!(back.bytes(), back_again.bytes());
            prop_assert_eq!(whole.drive.garbled(), pieces.drive.garbled());
            let told = heard(&mut *whole.client, back.bytes());
            let told_again: Vec<Told> =
                cut(back.bytes(), &cuts).flat_map(|piece| heard(&mut *pieces.client, piece)).collect();
            // Not by value: telemetry that was not told is NaN.
            prop_assert_eq!(format!("{told:?}"), format!("{told_again:?}"));
            prop_assert!(told.iter().any(|told| matches!(told, Told::Hello(_))), "{}: {:?}", kind.name, told);
            prop_assert_eq!(whole.client.garbled(), pieces.client.garbled());
        }
    }
}

#[test]
fn garbage_before_between_and_after_is_survived() {
    // Always the same garbage: one of a million pieces of it is a datagram of TMCL, with its checksum of one byte.
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for case in 0..500 {
        let garbage: Vec<u8> = (0..case % 60).map(|_| rng.random()).collect();
        for kind in PROTOCOLS {
            let mut pair = Pair::of(kind);
            let mut wire = garbage.clone();
            for voltage_v in [3.0, -6.0] {
                pair.out.clear();
                pair.client.command(voltage_v, &mut pair.out);
                wire.extend(pair.out.bytes());
                wire.extend(&garbage);
            }
            let mut newest = None;
            for &byte in &wire {
                newest = pair.drive.hear(&[byte], 0, &pair.state, &mut pair.back).or(newest);
            }
            assert!((newest.unwrap() + 6.0).abs() < 1e-3, "{}: {:?}", kind.name, newest);
            let counts = pair.drive.garbled();
            assert_eq!(counts.sound, 2);
            // What trails may still be half a frame.
            assert!(counts.skipped_bytes <= 3 * garbage.len() as u64);
            assert!(counts.skipped_bytes + garbage.len() as u64 >= 2 * garbage.len() as u64);
            let mut answer = garbage.clone();
            pair.out.clear();
            pair.back.clear();
            pair.client.hello(&mut pair.out);
            pair.drive.hear(pair.out.bytes(), 0, &pair.state, &mut pair.back);
            answer.extend(pair.back.bytes());
            let told = heard(&mut *pair.client, &answer);
            assert!(matches!(told[..], [Told::Hello(_)]), "{}: {:?}", kind.name, told);
        }
    }
}

/// `bytes` cut into pieces of these lengths, again and again.
fn cut<'a>(bytes: &'a [u8], lengths: &'a [usize]) -> impl Iterator<Item = &'a [u8]> {
    let (mut rest, mut lengths) = (bytes, lengths.iter().cycle());
    std::iter::from_fn(move || {
        let length = rest.len().min(*lengths.next()?);
        let (piece, after) = rest.split_at(length);
        rest = after;
        (!piece.is_empty()).then_some(piece)
    })
}

#[test]
fn what_is_no_voltage_is_0_and_what_is_too_much_is_full_scale() {
    for kind in PROTOCOLS {
        let mut pair = Pair::of(kind);
        for (given_v, meant_v) in [
            (f64::NAN, 0.0),
            (f64::INFINITY, 12.0),
            (f64::NEG_INFINITY, -12.0),
            (1e300, 12.0),
            (-1e300, -12.0),
            (-0.0, 0.0),
            (12.0, 12.0),
            (-12.0, -12.0),
        ] {
            // Before it something else, so that an answer that stays away shows.
            pair.exchange(0, |client, out| client.command(5.0, out));
            let (commanded, _) = pair.exchange(0, |client, out| client.command(given_v, out));
            assert_eq!(commanded, Some(meant_v), "{}: {given_v}", kind.name);
        }
    }
}

#[test]
fn who_is_asked_says_who_it_is() {
    for kind in PROTOCOLS {
        let mut pair = Pair::of(kind);
        let (commanded, told) = pair.exchange(0, |client, out| client.hello(out));
        let [Told::Hello(Firmware { hardware, major, minor })] = told[..] else { panic!("{}: {told:?}", kind.name) };
        assert!(hardware.len() > 5 && major > 0 && minor > 0, "{}: {hardware} {major} {minor}", kind.name);
        assert_eq!(commanded, None);
        let sound = Garbled { sound: 1, ..Garbled::default() };
        assert_eq!((pair.client.garbled(), pair.drive.garbled()), (sound, sound));
        pair.client.reset();
        assert_eq!(pair.client.garbled(), Garbled::default());
        let (_, told) = pair.exchange(0, |client, out| client.hello(out));
        assert!(matches!(told[..], [Told::Hello(_)]), "{}: after a reset {told:?}", kind.name);
    }
}

#[test]
fn every_fault_has_a_name_and_is_told_until_it_is_gone() {
    for kind in PROTOCOLS {
        let mut pair = Pair::of(kind);
        for fault in [Some(kind.example_fault), None] {
            pair.state.telemetry.fault = fault;
            let mut told = vec![];
            for _ in 0..ROUND {
                told = pair.exchange(0, |client, out| client.request(out)).1;
            }
            let [Told::Telemetry(telemetry)] = told[..] else { panic!("{told:?}") };
            assert_eq!(telemetry.fault, fault, "{}", kind.name);
        }
        assert!(kind.example_fault.code > 0 && !kind.example_fault.name.is_empty());
    }
    let names: std::collections::HashSet<_> = drivers::amplifier::vesc::FAULTS.iter().collect();
    assert_eq!(names.len(), 34, "mc_fault_code has 34 entries");
    assert_eq!(drivers::amplifier::vesc::fault(0), None);
    assert_eq!(drivers::amplifier::vesc::fault(33).unwrap().name, "absolute overspeed");
    assert_eq!(drivers::amplifier::vesc::fault(200).unwrap().code, 200);
}

#[test]
fn a_drive_times_out_and_a_sign_of_life_prolongs() {
    for kind in PROTOCOLS {
        let mut pair = Pair::of(kind);
        pair.drive.set_timeout(Some(100 * MS));
        assert_eq!((pair.drive.voltage_v(5_000 * MS), pair.drive.timed_out(5_000 * MS)), (0.0, false), "{}", kind.name);
        pair.exchange(0, |client, out| client.command(6.0, out));
        pair.exchange(90 * MS, |client, out| client.keep_alive(out));
        assert!(pair.drive.voltage_v(190 * MS) > 5.9 && !pair.drive.timed_out(190 * MS), "{}", kind.name);
        assert_eq!((pair.drive.voltage_v(191 * MS), pair.drive.timed_out(191 * MS)), (0.0, true), "{}", kind.name);
        // A sign of life does not bring back a command that is in force no more.
        pair.exchange(200 * MS, |client, out| client.keep_alive(out));
        assert_eq!((pair.drive.voltage_v(201 * MS), pair.drive.timed_out(201 * MS)), (0.0, false), "{}", kind.name);
        pair.exchange(210 * MS, |client, out| client.command(-6.0, out));
        assert!(pair.drive.voltage_v(211 * MS) < -5.9, "{}", kind.name);
        pair.drive.set_timeout(None);
        assert!(pair.drive.voltage_v(u64::MAX) < -5.9, "{}", kind.name);
    }
}

#[test]
fn traffic_is_what_goes_over_the_wire() {
    for kind in PROTOCOLS {
        let mut pair = Pair::of(kind);
        let traffic = pair.client.traffic();
        pair.exchange(0, |client, out| client.command(1.0, out));
        assert_eq!((pair.out.bytes().len(), pair.back.bytes().len()), (traffic.command.out, traffic.command.back));
        for _ in 0..ROUND {
            pair.exchange(0, |client, out| client.request(out));
            assert_eq!((pair.out.bytes().len(), pair.back.bytes().len()), (traffic.request.out, traffic.request.back));
        }
        pair.exchange(0, |client, out| client.keep_alive(out));
        assert_eq!(
            (pair.out.bytes().len(), pair.back.bytes().len()),
            (traffic.keep_alive.out, traffic.keep_alive.back)
        );
    }
}

#[test]
fn another_protocol_is_garbage() {
    for kind in PROTOCOLS {
        for other in PROTOCOLS.iter().filter(|other| other.name != kind.name) {
            let (mut pair, mut stranger) = (Pair::of(kind), Pair::of(other));
            for _ in 0..20 {
                // The stranger's drive answers its own client; ours listens.
                stranger.exchange(0, |client, out| client.hello(out));
                stranger.exchange(0, |client, out| client.request(out));
                assert_eq!(heard(&mut *pair.client, stranger.back.bytes()), [], "{} hears {}", kind.name, other.name);
                // And a drive does not obey what is not for it.
                stranger.out.clear();
                stranger.client.command(6.0, &mut stranger.out);
                let commanded = pair.drive.hear(stranger.out.bytes(), 0, &state(), &mut pair.back);
                assert_eq!(commanded, None, "{} obeys {}", kind.name, other.name);
            }
            let counts = pair.client.garbled();
            assert!(counts.sound == 0 && counts.skipped_bytes > 0, "{} hears {}: {counts:?}", kind.name, other.name);
        }
    }
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let text = protocol("modbus").err().unwrap().to_string();
    assert!(PROTOCOLS.iter().all(|kind| text.contains(kind.name)) && text.contains("modbus"), "{text}");
    for kind in PROTOCOLS {
        assert_eq!(protocol(kind.name).unwrap().name, kind.name);
        let plain = settings(kind);
        for full_scale_v in [0.0, -12.0, f64::NAN, f64::INFINITY] {
            let wrong = drivers::amplifier::AmplifierSettings { full_scale_v, ..plain.clone() };
            for error in [(kind.client)(&wrong).err(), (kind.drive)(&wrong).err()] {
                assert!(matches!(error, Some(AmplifierError::OutOfRange { key: "full_scale_v", .. })), "{error:?}");
            }
        }
    }
    let mut wrong = settings(&PROTOCOLS[0]);
    wrong.vesc.pole_pairs = 0;
    assert!((protocol("vesc").unwrap().client)(&wrong).is_err());
    wrong.tmcl.full_scale_units = Some(0);
    let refused = (protocol("tmcl").unwrap().client)(&wrong).err().unwrap().to_string();
    assert!(refused.contains("full_scale_units = 0"), "{refused}");
    wrong.tmcl.full_scale_units = None;
    wrong.tmcl.module = "TMCM-1640".into();
    let refused = (protocol("tmcl").unwrap().drive)(&wrong).err().unwrap().to_string();
    assert!(refused.contains("TMCM-1640") && refused.contains("TMC6140-EVAL"), "{refused}");
}

#[test]
fn every_module_of_the_list_is_spoken_to() {
    let kind = protocol("tmcl").unwrap();
    for module in drivers::amplifier::tmcl::MODULES {
        let mut settings = settings(kind);
        settings.tmcl.module = module.name.into();
        settings.tmcl.axis = 1;
        let mut pair = Pair::with(kind, &settings, &settings);
        assert_eq!(pair.exchange(0, |client, out| client.command(6.0, out)).1, [Told::Acknowledged]);
        assert!((pair.drive.voltage_v(0) - 6.0).abs() < 1e-3);
        for _ in module.readings {
            let (_, told) = pair.exchange(0, |client, out| client.request(out));
            assert!(matches!(told[..], [Told::Telemetry(_)]), "{}: {told:?}", module.name);
        }
        // A module of another axis, or another address, does not obey.
        settings.tmcl.axis = 0;
        let mut other = (kind.client)(&settings).unwrap();
        pair.out.clear();
        other.command(3.0, &mut pair.out);
        assert_eq!(pair.drive.hear(pair.out.bytes(), 0, &pair.state, &mut pair.back), None);
        pair.back.clear();
        pair.drive.hear(pair.out.bytes(), 0, &pair.state, &mut pair.back);
        let told = heard(&mut *other, pair.back.bytes());
        assert!(
            matches!(told[..], [Told::Refused(refusal)] if refusal.status == 3 && refusal.command == 5),
            "{told:?}"
        );
        settings.tmcl.module_address = 9;
        let mut other = (kind.client)(&settings).unwrap();
        pair.out.clear();
        pair.back.clear();
        other.command(3.0, &mut pair.out);
        assert_eq!(pair.drive.hear(pair.out.bytes(), 0, &pair.state, &mut pair.back), None);
        assert!(pair.back.is_empty());
    }
}
