//! Fault injection: what each kind does at the boundary, that it ends and is told, and what the loop makes of it.
#![allow(clippy::unwrap_used, reason = "a test")]

mod counting;

use counting::allocations;
use drivers::EmulatedRig;
use drivers::emulated::Settings;
use drivers::faults::Faulty;
use drivers::journal::{JournalReader, Occurrence, Severity, When};
use model::Parameters;
use model::effects::EffectSet;
use proptest::prelude::*;
use rt_core::fault::{Fault, FaultKind, Route, Valve, full_scale};
use rt_core::replay::Replay;
use rt_core::{
    Breach, Channel, Command, Device, DeviceError, Ended, Fixture, Input, Limits, Lockstep, LoopError, Measurement,
    OpenLoop, OverrunPolicy, Reference, Run, RunReport, SafeState, Sample, Stages, Step, Supervisor, Target, Tick,
    flight,
};
use std::cell::RefCell;
use std::rc::Rc;

const FREE: Command =
    Command { voltage_v: 5.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };

/// Shows the tick's number as angle, and fractions of it elsewhere, so that each value tells when it was measured.
#[derive(Clone, Default)]
struct Ramp {
    told: Rc<RefCell<Vec<(u64, Command)>>>,
    allocated: bool,
}

impl Device for Ramp {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let k = now.index as f64;
        let (pressure1_bar, pressure2_bar, torque_nm, volume_ml) = (2.0 + k * 1e-4, 3.0 - k * 1e-4, k * 1e-2, k * 0.1);
        Ok(Measurement { angle_deg: k, pressure1_bar, pressure2_bar, torque_nm, volume_ml, ..Measurement::NONE })
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        if !self.allocated {
            self.told.borrow_mut().push((now.index, *command));
        }
        Ok(())
    }
}

fn fault(kind: FaultKind, from_tick: u64, ticks: u64) -> Fault {
    Fault { kind, from_tick, ticks: Some(ticks), probability: 1.0 }
}

/// What came of a run: what the loop read, what the device was told, what the journal says.
struct Played {
    read: Vec<Result<Measurement, DeviceError>>,
    told: Vec<(u64, Command)>,
    journal: Vec<Occurrence>,
}

impl Played {
    fn at(&self, tick: usize) -> Measurement {
        self.read[tick].clone().unwrap()
    }

    /// Value and age in ticks.
    fn angle(&self, tick: usize) -> (f64, u32) {
        let measured = self.at(tick);
        assert_eq!(measured.age_ns[0] % 1_000_000, 0);
        (measured.angle_deg, measured.age_ns[0] / 1_000_000)
    }

    fn volts(&self) -> Vec<f64> {
        self.told.iter().map(|(_, command)| command.voltage_v).collect()
    }

    fn texts(&self) -> Vec<&str> {
        self.journal.iter().map(|entry| &*entry.text).collect()
    }
}

/// Plays so many ticks; each command is the tick's number in mV.
fn play(faults: &[Fault], seed: u64, ticks: u64) -> Played {
    let mut journals = JournalReader::default();
    let ramp = Ramp::default();
    let told = ramp.told.clone();
    let mut device = Faulty::new(ramp, faults, seed, journals.journal("faults")).unwrap();
    device.begin_run(0);
    let mut read = vec![];
    for tick in 0..ticks {
        read.push(device.read(Tick::at(tick)));
        let bypass_open = tick % 2 == 1;
        device.write(Tick::at(tick), &Command { voltage_v: tick as f64 * 1e-3, bypass_open, ..FREE }).unwrap();
    }
    drop(device);
    let told = told.take();
    Played { read, told, journal: journals.read() }
}

const ANGLE: Input = Input::Angle;

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

/// One of each kind, on everything that it can hit, with a share where it can have one.
fn all_kinds() -> Vec<Fault> {
    let mut kinds = vec![
        FaultKind::PortGone { timeout_ticks: 20 },
        FaultKind::BusOff { timeout_ticks: 20 },
        FaultKind::AmplifierFault { code: 9 },
        FaultKind::ValveStuck { valve: Valve::Brake, open: Some(false) },
        FaultKind::ValveStuck { valve: Valve::Bypass, open: None },
    ];
    let mut routes = vec![Route::Voltage { timeout_ticks: 50 }, Route::Valves { timeout_ticks: 50 }];
    for input in Input::ALL {
        let (low, high) = full_scale(input);
        routes.push(Route::Input(input));
        kinds.extend([
            FaultKind::Repeated { input, unnoticed: false },
            FaultKind::Repeated { input, unnoticed: true },
            FaultKind::Swapped { input, unnoticed: false },
            FaultKind::Swapped { input, unnoticed: true },
            FaultKind::BitFlip { input, bit: None, low, high },
            FaultKind::BitFlip { input, bit: Some(5), low, high },
            FaultKind::CrcError { input },
            FaultKind::Stuck { input },
            FaultKind::Drift { input, per_s: -0.5 },
            FaultKind::Nan { input },
        ]);
    }
    for route in routes {
        kinds.push(FaultKind::Lost { route });
        kinds.push(FaultKind::Late { route, ticks: 7, unnoticed: false });
        if matches!(route, Route::Input(_)) {
            kinds.push(FaultKind::Late { route, ticks: 7, unnoticed: true });
        }
    }
    let share = |kind: &FaultKind| if kind.hits_frames() { 0.5 } else { 1.0 };
    kinds.iter().map(|kind| Fault { probability: share(kind), ..fault(*kind, 100, 200) }).collect()
}

/// Bit for bit.
fn bits(played: &Played) -> Vec<Vec<u64>> {
    let of = |read: &Result<Measurement, DeviceError>| match read {
        Ok(m) => Input::ALL
            .iter()
            .flat_map(|&input| [m.value(input).to_bits(), u64::from(m.age_ns[input as usize])])
            .chain([u64::from(m.faulty), u64::from(m.heartbeat_age_ns)])
            .collect(),
        Err(error) => vec![error.tick],
    };
    let told = |(tick, c): &(u64, Command)| {
        vec![*tick, c.voltage_v.to_bits(), u64::from(c.brake_open), u64::from(c.bypass_open), u64::from(c.segment)]
    };
    played.read.iter().map(of).chain(played.told.iter().map(told)).collect()
}

#[test]
fn every_kind_does_something_ends_is_repeatable_and_told() {
    let without = bits(&play(&[], 3, 400));
    let names: std::collections::BTreeSet<&str> = all_kinds().iter().map(|fault| fault.kind.name()).collect();
    assert_eq!(names.len(), 13, "{names:?}");
    for fault in all_kinds() {
        let kind = fault.kind;
        let played = play(&[fault], 3, 400);
        let seen = bits(&played);
        assert_eq!(seen, bits(&play(&[fault], 3, 400)), "{kind}: not repeatable");
        if fault.probability < 1.0 {
            assert_ne!(seen, bits(&play(&[fault], 4, 400)), "{kind}: the seed decides nothing");
        }
        let differs: Vec<usize> = (0..800).filter(|&k| seen[k] != without[k]).map(|k| k % 400).collect();
        assert!(differs.len() >= 50, "{kind}: {} ticks", differs.len());
        assert!(differs.iter().all(|&k| k >= 100), "{kind}: before its time");
        // The amplifier stays at 0 V until the operator's word; a late frame is there when its delay has passed.
        let disarms = matches!(kind, FaultKind::PortGone { .. } | FaultKind::AmplifierFault { .. });
        let over = if disarms { 400 } else { 307 };
        assert!(differs.iter().all(|&k| k < over), "{kind}: it does not end");
        let texts = played.texts();
        assert_eq!(played.journal.len(), 2, "{texts:?}");
        let when: Vec<_> = played.journal.iter().map(|entry| (entry.when, entry.severity)).collect();
        assert_eq!(when, [(When::Tick(100), Severity::Warning), (When::Tick(300), Severity::Info)]);
        let what = kind.to_string();
        assert!(texts.iter().all(|text| text.contains(&what)) && what.starts_with(kind.name()), "{texts:?}");
        let count = texts[1].split("struck ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
        let count: u32 = count.parse().unwrap();
        let most = match kind {
            FaultKind::Swapped { .. } => 50..=100,
            _ if fault.probability < 1.0 => 70..=130,
            FaultKind::ValveStuck { valve: Valve::Bypass, .. } => 100..=100,
            _ => 200..=200,
        };
        assert!(most.contains(&count), "{texts:?}");
    }
}

#[test]
fn faults_act_together_and_none_shifts_the_chance_of_another() {
    let share = |kind| Fault { probability: 0.3, ..fault(kind, 20, 300) };
    let lost = share(FaultKind::Lost { route: Route::Input(ANGLE) });
    let nan = share(FaultKind::Nan { input: Input::Torque });
    let (alone, both) = (play(&[lost], 5, 400), play(&[lost, nan], 5, 400));
    for k in 0..400 {
        assert_eq!(alone.angle(k), both.angle(k));
    }
    let hit = (0..400).filter(|&k| both.at(k).torque_nm.is_nan()).count();
    assert!((60..120).contains(&hit), "{hit}");
    // Passed over by the loop, a fault is still told.
    let mut journals = JournalReader::default();
    let mut device = Faulty::new(Ramp::default(), &[lost], 0, journals.journal("faults")).unwrap();
    device.read(Tick::at(1)).unwrap();
    device.read(Tick::at(1000)).unwrap();
    assert_eq!(journals.read().len(), 2);
}

#[test]
fn what_ends_with_the_run_is_told_and_the_device_gets_what_was_withheld() {
    let forever = |kind| Fault { ticks: None, ..fault(kind, 10, 1) };
    for kind in [
        FaultKind::Lost { route: Route::Voltage { timeout_ticks: 100 } },
        FaultKind::Lost { route: Route::Valves { timeout_ticks: 100 } },
        FaultKind::ValveStuck { valve: Valve::Brake, open: Some(false) },
        FaultKind::PortGone { timeout_ticks: 1000 },
    ] {
        let mut journals = JournalReader::default();
        let ramp = Ramp::default();
        let told = ramp.told.clone();
        let mut device = Faulty::new(ramp, &[forever(kind)], 0, journals.journal("faults")).unwrap();
        for tick in 0..20 {
            device.read(Tick::at(tick)).unwrap();
            device.write(Tick::at(tick), &FREE).unwrap();
        }
        let safe = SafeState { brake_open: true, bypass_open: true }.command(Fixture::Free, 0);
        device.write(Tick::at(20), &safe).unwrap();
        assert_ne!(told.borrow().last().unwrap().1, safe, "{kind}");
        device.end_run().unwrap();
        assert_eq!(told.borrow().last().unwrap().1, safe, "{kind}");
        let texts: Vec<_> = journals.read().iter().map(|entry| entry.text.to_string()).collect();
        assert!(texts.len() == 2 && texts[1].contains("over with the run"), "{texts:?}");
        let before = told.borrow().len();
        drop(device);
        assert_eq!(told.borrow().len(), before, "once is enough");
    }
}

#[test]
fn lists_that_make_no_sense_are_refused() {
    let mut journals = JournalReader::default();
    let good = fault(FaultKind::Stuck { input: ANGLE }, 0, 1);
    let bad = Fault { probability: 0.5, ..good };
    let mut refused = |faults: &[Fault]| Faulty::new(Ramp::default(), faults, 0, journals.journal("f")).err().unwrap();
    assert!(refused(&[good, bad]).to_string().contains("fault 2 (stuck): probability"));
    assert!(refused(&[good; 101]).to_string().contains("at most 100, got 101"));
}

fn rig(seed: u64) -> EmulatedRig {
    let settings = Settings { start: Command { voltage_v: 0.0, ..FREE }, seed, ..Settings::default() };
    EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings).unwrap()
}

fn any_command() -> impl Strategy<Value = Command> {
    let fixture = prop_oneof![
        4 => Just(Fixture::Free),
        1 => (-20.0..20.0).prop_map(|angle_deg| Fixture::Clamped { angle_deg }),
        1 => (-20.0..20.0, 1.5..3.5).prop_map(|(angle_deg, bar)| Fixture::Filled { angle_deg, pressure1_bar: bar, pressure2_bar: 2.0 }),
        1 => (1.5..3.5).prop_map(|bar| Fixture::PumpBench { pressure1_bar: bar, pressure2_bar: 2.0 }),
    ];
    // Some are beyond what the rig takes, and refused.
    (-30.0..30.0, any::<bool>(), any::<bool>(), fixture, 0u32..3).prop_map(
        |(voltage_v, brake_open, bypass_open, fixture, segment)| Command {
            voltage_v,
            brake_open,
            bypass_open,
            fixture,
            segment,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Without faults, and with those whose time is not yet there or over, it is the device itself.
    #[test]
    fn without_a_fault_that_acts_it_is_the_device_itself(
        commands in prop::collection::vec((any_command(), 1u64..30, 1u64..3), 1..10),
        which in 0usize..3,
        seed in any::<u64>(),
    ) {
        let faults: Vec<Fault> = match which {
            0 => vec![],
            1 => all_kinds().into_iter().map(|fault| Fault { from_tick: 1_000_000, ..fault }).collect(),
            _ => all_kinds().into_iter().filter(|fault| !matches!(fault.kind, FaultKind::PortGone { .. } | FaultKind::AmplifierFault { .. }))
                .map(|fault| Fault { from_tick: 0, ticks: Some(1), ..fault }).collect(),
        };
        let begin = if which == 2 { 20 } else { 0 };
        let mut journals = JournalReader::default();
        let (mut bare, mut wrapped) =
            (rig(seed), Faulty::new(rig(seed), &faults, seed, journals.journal("faults")).unwrap());
        if which == 2 {
            // Its faults come and go before anything is compared.
            wrapped.begin_run(0);
        }
        let mut tick = begin;
        for (command, times, step) in commands {
            for _ in 0..times {
                let now = Tick::at(tick);
                let (a, b) = (bare.read(now), wrapped.read(now));
                prop_assert_eq!(format!("{a:?}"), format!("{b:?}"));
                if let (Ok(a), Ok(b)) = (a, b) {
                    for input in Input::ALL {
                        prop_assert_eq!(a.value(input).to_bits(), b.value(input).to_bits());
                    }
                }
                prop_assert_eq!(bare.write(now, &command), wrapped.write(now, &command));
                tick += step;
            }
        }
        let state = |rig: &EmulatedRig| rig.state().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(state(&bare), state(wrapped.device()));
    }
}

#[test]
fn a_tick_with_faults_allocates_nothing() {
    let mut journals = JournalReader::default();
    let faults: Vec<Fault> =
        all_kinds().into_iter().filter(|fault| !matches!(fault.kind, FaultKind::AmplifierFault { .. })).collect();
    let ramp = Ramp { allocated: true, ..Ramp::default() };
    let mut device = Faulty::new(ramp, &faults, 1, journals.journal("faults")).unwrap();
    let before = allocations();
    device.begin_run(0);
    for tick in (0..500).filter(|tick| tick % 97 != 5) {
        device.read(Tick::at(tick)).unwrap();
        device.write(Tick::at(tick), &FREE).unwrap();
        device.write(Tick::at(tick), &FREE).unwrap();
    }
    device.end_run().unwrap();
    assert_eq!(allocations() - before, 0);
    assert_eq!(journals.read().len(), 2 * faults.len(), "all of them have acted");
}

// ---------------------------------------------------------------------------------------------------------------------
// With the loop.

/// A free lever that is driven to and fro.
struct ToAndFro {
    ticks: u64,
}

impl Reference for ToAndFro {
    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        let voltage_v = if (now.index / 250).is_multiple_of(2) { 6.0 } else { -6.0 };
        Step {
            target: Target::VoltageV(voltage_v),
            brake_open: now.index % 100 >= 5,
            bypass_open: now.index % 100 < 10,
            fixture: Fixture::Free,
            segment: (now.index / 250) as u32,
            index: 0,
            last: now.index + 1 >= self.ticks,
            waiting: None,
        }
    }
}

fn limits() -> Limits {
    Limits { aftermath_ticks: 50, ..Limits::default() }
}

const TICKS: u64 = 1500;
const AT: u64 = 600;

/// The loop on the emulated rig with these faults: its end, its samples, what the rig has in force at last, what was told.
fn run(faults: &[Fault]) -> (Result<RunReport, LoopError>, Vec<Sample>, Command, Vec<Occurrence>) {
    let mut journals = JournalReader::default();
    let mut device = Faulty::new(rig(2), faults, 8, journals.journal("faults")).unwrap();
    let mut samples = Vec::new();
    let (mut flight, _log) = flight::recorder();
    let outcome = rt_core::run(
        Stages {
            clock: &mut Lockstep::default(),
            device: &mut device,
            operator: &mut (),
            supervisor: &mut Supervisor::new(limits()).unwrap(),
            reference: &mut ToAndFro { ticks: TICKS },
            controller: &mut OpenLoop,
            publish: &mut samples,
            flight: &mut flight,
        },
        Run { number: 0, overrun: OverrunPolicy::Skip },
    );
    device.end_run().unwrap();
    let in_force = device.device().command();
    (outcome, samples, in_force, journals.read())
}

/// What a replay of these samples finds.
fn replay(samples: Vec<Sample>) -> rt_core::replay::Verdict {
    let replay = Replay::new(samples.into_iter());
    let (mut flight, _log) = flight::recorder();
    let _ = rt_core::run(
        Stages {
            clock: &mut replay.clock(),
            device: &mut replay.device(),
            operator: &mut replay.operator(),
            supervisor: &mut Supervisor::new(limits()).unwrap(),
            reference: &mut ToAndFro { ticks: TICKS },
            controller: &mut OpenLoop,
            publish: &mut replay.comparison(),
            flight: &mut flight,
        },
        Run { number: 0, overrun: OverrunPolicy::Skip },
    );
    replay.verdict()
}

#[test]
fn dangerous_faults_end_in_the_safe_state_in_time_and_a_replay_agrees() {
    let (required, all) = ([Input::Angle, Input::Pressure1, Input::Pressure2], Route::Input);
    let channel = |input| [Channel::Angle, Channel::Pressure1, Channel::Pressure2][input as usize];
    let Limits { age_max_ms, missing_max_ticks, heartbeat_max_ms, .. } = limits();
    let (age, missing, heartbeat) = (age_max_ms as u64, u64::from(missing_max_ticks), heartbeat_max_ms as u64);
    // The fault, who trips, how, and after how many ticks at the latest; no one: the read fails.
    let mut cases = vec![];
    for input in required {
        let who = Some(channel(input));
        cases.push((FaultKind::Lost { route: all(input) }, who, age + 1));
        cases.push((FaultKind::Repeated { input, unnoticed: false }, who, age + 1));
        cases.push((FaultKind::Late { route: all(input), ticks: 40, unnoticed: false }, who, age + 1));
        cases.push((FaultKind::Nan { input }, who, missing + 1));
        cases.push((FaultKind::CrcError { input }, who, missing + 1));
    }
    cases.push((FaultKind::PortGone { timeout_ticks: 100 }, Some(Channel::Heartbeat), heartbeat + 1));
    cases.push((FaultKind::BusOff { timeout_ticks: 50 }, Some(Channel::Pressure1), age + 1));
    cases.push((FaultKind::AmplifierFault { code: 3 }, None, 0));
    for (kind, who, within) in cases {
        let forever = Fault { ticks: None, ..fault(kind, AT, 1) };
        let (outcome, samples, in_force, told) = run(&[forever]);
        let last = samples.last().unwrap();
        match (who, outcome) {
            (Some(who), Ok(report)) => {
                let trip = report.trip.unwrap_or_else(|| panic!("{kind}: no trip"));
                assert_eq!((report.ended, trip.channel), (Ended::Tripped, who), "{kind}: {trip}");
                assert!((AT..=AT + within).contains(&trip.tick), "{kind}: {trip}");
                assert!(matches!(trip.breach, Breach::Stale(_) | Breach::Missing(_)), "{kind}: {trip}");
                assert_eq!(last.tick, trip.tick + 50);
            }
            (None, Err(LoopError::Device { source, safe_state, .. })) => {
                assert!(source.tick == AT && source.what.contains("fault code 3"), "{source}");
                assert_eq!(safe_state, Ok(()));
            }
            (_, outcome) => panic!("{kind}: {outcome:?}"),
        }
        let safe = SafeState::default();
        assert_eq!(last.voltage_v, 0.0);
        assert_eq!(
            (in_force.voltage_v, in_force.brake_open, in_force.bypass_open),
            (0.0, safe.brake_open, safe.bypass_open),
            "{kind}: what the rig has in force"
        );
        assert_eq!(told.len(), 2, "{kind}: begin and end");
        let count = samples.len() as u64;
        let verdict = replay(samples);
        assert_eq!((verdict.difference, verdict.agreed), (None, count), "{kind}");
    }
}

#[test]
fn harmless_faults_end_no_run_and_a_replay_agrees() {
    let (low, high) = full_scale(Input::Angle);
    let share = |kind| Fault { probability: 0.2, ..fault(kind, AT, 500) };
    let short = |kind, ticks| fault(kind, AT, ticks);
    let mut cases = vec![
        fault(FaultKind::BitFlip { input: Input::Angle, bit: Some(2), low, high }, AT, 500),
        fault(FaultKind::ValveStuck { valve: Valve::Brake, open: Some(true) }, AT, 500),
        fault(FaultKind::ValveStuck { valve: Valve::Bypass, open: None }, AT, 500),
        share(FaultKind::Lost { route: Route::Voltage { timeout_ticks: 100 } }),
        share(FaultKind::Lost { route: Route::Valves { timeout_ticks: 50 } }),
        fault(FaultKind::Late { route: Route::Voltage { timeout_ticks: 100 }, ticks: 5, unnoticed: false }, AT, 500),
        short(FaultKind::PortGone { timeout_ticks: 100 }, 50),
        short(FaultKind::BusOff { timeout_ticks: 50 }, 15),
    ];
    for input in Input::ALL {
        cases.extend([
            share(FaultKind::Lost { route: Route::Input(input) }),
            fault(FaultKind::Late { route: Route::Input(input), ticks: 5, unnoticed: false }, AT, 500),
            share(FaultKind::Repeated { input, unnoticed: true }),
            share(FaultKind::Swapped { input, unnoticed: false }),
            share(FaultKind::CrcError { input }),
            share(FaultKind::Nan { input }),
            short(FaultKind::Stuck { input }, 100),
            fault(FaultKind::Drift { input, per_s: 0.05 }, AT, 500),
        ]);
    }
    let (_, untouched, ..) = run(&[]);
    for fault in cases {
        let (outcome, samples, _, told) = run(&[fault]);
        let report = outcome.unwrap_or_else(|error| panic!("{}: {error}", fault.kind));
        assert_eq!((report.ended, report.trip), (Ended::Completed, None), "{}", fault.kind);
        assert_eq!((samples.len() as u64, told.len()), (TICKS, 2), "{}", fault.kind);
        let free_lever = matches!(fault.kind.input(), Some(Input::Torque | Input::Volume));
        let read = |samples: &[Sample]| format!("{:?}", samples.iter().map(Sample::measurement).collect::<Vec<_>>());
        let same = read(&samples) == read(&untouched);
        assert!(!same || free_lever, "{}: nothing happened", fault.kind);
        let verdict = replay(samples);
        assert_eq!((verdict.difference, verdict.agreed), (None, TICKS), "{}", fault.kind);
    }
}
