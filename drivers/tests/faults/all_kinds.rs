//! What all kinds have in common: each acts, ends, is told, is repeatable, and leaves the others and the device alone.

use crate::counting::allocations;
use crate::played::{ANGLE, FREE, Played, Ramp, all_kinds, fault, play, rig};
use drivers::EmulatedRig;
use drivers::faults::Faulty;
use drivers::journal::{JournalReader, Severity, When};
use proptest::prelude::*;
use rt_core::fault::{Fault, FaultKind, Route, Valve};
use rt_core::{Command, Device, DeviceError, Fixture, Input, Measurement, SafeState, Tick};

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
