//! Replay: what was recorded goes through the loop again, and comes out again, bit for bit; whatever differs is found at its tick.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use common::world::{At, Follow, People, Rig, Script, Thrower, limits};
use rt_core::flight::recorder;
use rt_core::replay::{Replay, Verdict};
use rt_core::{
    Demand, Ended, Fixture, Input, Limits, LoopError, OverrunPolicy, Run, RunReport, Sample, Stages, Supervisor,
    Switches, flags,
};

/// A noisy tank within its limits, under a controller that remembers and a slew limit that holds it back.
fn noisy_limits() -> Limits {
    Limits { pressure_max_bar: 6.0, missing_max_ticks: 8, slew_max_v_s: 1000.0, ..limits() }
}

fn noisy(ticks: u64, overrun: OverrunPolicy) -> Rig {
    let mut rig = Rig::with(noisy_limits(), ticks, 3.0);
    rig.tank.noisy = true;
    rig.follow.gain_v_bar = 2.5;
    rig.overrun = overrun;
    rig
}

/// A script that lasts for ever, as one of which the recorded run played a part.
fn replay_with(
    samples: &[Sample],
    ticks: u64,
    overrun: OverrunPolicy,
    limits: Limits,
    gain_v_bar: f64,
) -> (Verdict, Result<RunReport, LoopError>) {
    let world = common::world::World::default();
    let fixture = |_| Fixture::Free;
    let replay = Replay::new(samples.iter().copied());
    let report = {
        let stages = Stages {
            clock: &mut replay.clock(),
            device: &mut replay.device(),
            operator: &mut replay.operator(),
            supervisor: &mut Supervisor::new(limits).unwrap(),
            reference: &mut Script { world: world.clone(), ticks, voltage_v: 3.0, fixture },
            controller: &mut Follow { world, gain_v_bar, answer: None, remembered: 99.0 },
            publish: &mut replay.comparison(),
            flight: &mut recorder().0,
        };
        rt_core::run(stages, Run { number: 17, overrun })
    };
    (replay.verdict(), report)
}

fn replay_of(rig: &Rig) -> (Verdict, Result<RunReport, LoopError>) {
    let ticks = rig.script.ticks;
    replay_with(&rig.book.samples, ticks, rig.overrun, *rig.supervisor.limits(), rig.follow.gain_v_bar)
}

fn assert_agrees(rig: &Rig, what: &str) -> Result<RunReport, LoopError> {
    let (verdict, replayed) = replay_of(rig);
    if let Some(difference) = &verdict.difference {
        panic!("{what}: {difference}");
    }
    assert_eq!(verdict.agreed, rig.book.samples.len() as u64, "{what}");
    replayed
}

#[test]
fn a_noisy_run_with_values_that_come_and_go_is_replayed_bit_for_bit() {
    let mut rig = noisy(3000, OverrunPolicy::Skip);
    let report = rig.run_in_lockstep(0).unwrap();
    let samples = &rig.book.samples;
    let any = |what: fn(&Sample) -> bool| samples.iter().any(what);
    assert!(any(|s| s.angle_deg.is_nan()) && any(|s| s.torque_nm.is_nan()));
    // The tank says an infinite volume: the loop takes it for none that the device calls wrong.
    let volume_wrong = Input::Volume.bit() << 8;
    assert!(samples.iter().all(|s| s.volume_ml.is_nan() && s.quality & volume_wrong != 0));
    assert!(any(|s| s.torque_nm == 0.0 && s.torque_nm.is_sign_negative()), "a zero of either sign");
    assert!(any(|s| s.quality >> 8 != 0) && any(|s| s.age_ns[4] > 0) && any(|s| s.flags & flags::SLEW_LIMITED != 0));
    let replayed = assert_agrees(&rig, "completion").unwrap();
    assert_eq!((replayed.ended, replayed.statistics), (Ended::Completed, report.statistics));
}

/// Brings about a way to end.
type Ending = fn(&mut Rig);

#[test]
fn runs_are_replayed_to_whatever_end_they_came() {
    let endings: [(&str, Ended, Ending); 6] = [
        ("trip by pressure", Ended::Tripped, |rig| rig.tank.forge = Some((300, |m| m.pressure1_bar = 9.0))),
        ("trip by a missing angle", Ended::Tripped, |rig| rig.tank.forge = Some((300, |m| m.angle_deg = f64::NAN))),
        ("trip by silence", Ended::Tripped, |rig| rig.tank.forge = Some((300, |m| m.heartbeat_age_ns = u32::MAX))),
        ("operator's stop", Ended::Stopped, |rig| rig.people = Box::new(People(vec![(300, Demand::Stop)]))),
        ("emergency stop", Ended::Tripped, |rig| {
            rig.people = Box::new(Thrower { at: 300, switches: Switches::new() });
        }),
        ("emergency stop, then a stop within the aftermath", Ended::Tripped, |rig| {
            rig.people = Box::new(People(vec![(300, Demand::EmergencyStop), (303, Demand::Stop)]));
        }),
    ];
    for (what, ended, bring_about) in endings {
        let mut rig = noisy(1000, OverrunPolicy::Skip);
        bring_about(&mut rig);
        let report = rig.run_in_lockstep(0).unwrap();
        assert!(report.ended == ended && (301..315).contains(&report.statistics.ticks), "{what}: {report}");
        let replayed = assert_agrees(&rig, what).unwrap();
        assert_eq!((replayed.ended, replayed.statistics), (ended, report.statistics), "{what}");
        assert_eq!(replayed.trip.map(|t| t.to_string()), report.trip.map(|t| t.to_string()), "{what}");
    }
}

#[test]
fn a_failed_device_is_replayed_as_failed_whichever_call_failed_and_whatever_tripped_at_it() {
    for (read, write) in [(Some(300), None), (None, Some(300))] {
        for tripped in [None, Some(298), Some(300)] {
            let mut rig = noisy(1000, OverrunPolicy::Skip);
            (rig.tank.fail_read_at, rig.tank.fail_write_at) = (read, write);
            rig.people = Box::new(People(tripped.map(|at| (at, Demand::EmergencyStop)).into_iter().collect()));
            rig.run_in_lockstep(0).unwrap_err();
            let what = format!("read {read:?}, write {write:?}, tripped {tripped:?}");
            assert!(rig.book.samples.last().unwrap().fault() && rig.book.samples.len() == 301, "{what}");
            let error = assert_agrees(&rig, &what).unwrap_err();
            assert!(error.to_string().contains("failed in the recorded run"), "{what}: {error}");
        }
    }
}

#[test]
fn late_ticks_are_replayed_under_every_policy() {
    for policy in OverrunPolicy::ALL {
        for at in [At::Wake, At::Read, At::Publish] {
            let mut rig = noisy(600, policy);
            (0..600).for_each(|tick| rig.world.delay(At::Control, tick, 0.15));
            for (tick, delay_ms) in [(0, 2.2), (99, 1.0), (200, 3.3), (205, 3.3), (206, 9.0), (599, 4.0)] {
                rig.world.delay(at, tick, delay_ms);
            }
            let report = rig.run(0).unwrap();
            let ended = match policy {
                OverrunPolicy::Skip | OverrunPolicy::CatchUp => Ended::Completed,
                OverrunPolicy::SafeState => Ended::Tripped,
                OverrunPolicy::Abort => Ended::Aborted,
            };
            assert_eq!(report.ended, ended);
            let replayed = assert_agrees(&rig, &format!("{policy}, {at:?}")).unwrap();
            assert_eq!((replayed.ended, replayed.statistics.skipped), (ended, report.statistics.skipped));
        }
    }
}

#[test]
fn another_policy_than_the_recorded_one_is_found_at_the_first_late_tick() {
    let mut rig = noisy(100, OverrunPolicy::Skip);
    rig.world.delay(At::Read, 50, 3.5);
    rig.run(0).unwrap();
    let differs = |policy| {
        let (verdict, _) = replay_with(&rig.book.samples, 100, policy, noisy_limits(), 2.5);
        let difference = verdict.difference.unwrap();
        (verdict.agreed, difference.tick, difference.field)
    };
    assert_eq!(differs(OverrunPolicy::CatchUp), (51, 54, "tick"));
    assert_eq!(differs(OverrunPolicy::SafeState), (51, 54, "voltage_v"));
    assert_eq!(differs(OverrunPolicy::Abort), (51, 54, "voltage_v"));
}

#[test]
fn a_changed_limit_is_found_where_it_would_have_tripped() {
    let mut rig = noisy(1000, OverrunPolicy::Skip);
    rig.run_in_lockstep(0).unwrap();
    let samples = &rig.book.samples;
    let highest = |until: usize| samples[..until].iter().map(|s| s.pressure1_bar).fold(0.0, f64::max);
    // The limit lies between the highest pressure before and the pressure at this tick.
    let tick = (50..1000).find(|&k| samples[k].quality & 2 != 0 && samples[k].pressure1_bar > highest(k)).unwrap();
    let pressure_max_bar = 0.5 * (highest(tick) + samples[tick].pressure1_bar);
    let (verdict, _) =
        replay_with(samples, 1000, OverrunPolicy::Skip, Limits { pressure_max_bar, ..noisy_limits() }, 2.5);
    let difference = verdict.difference.unwrap();
    assert_eq!((verdict.agreed, difference.tick, difference.field), (tick as u64, tick as u64, "voltage_v"));
    assert_eq!(difference.recorded, format!("{:?}", samples[tick].voltage_v));
    assert_eq!(difference.replayed, "0.0");
    assert!(difference.to_string().starts_with(&format!("tick {tick}, voltage_v: recorded ")), "{difference}");
}

#[test]
fn a_changed_gain_is_found_at_the_first_tick_that_it_changes() {
    let mut rig = noisy(1000, OverrunPolicy::Skip);
    rig.run_in_lockstep(0).unwrap();
    // The slew limit hides the controller at first, and says so.
    let first = rig.book.samples.iter().position(|s| s.flags & flags::SLEW_LIMITED == 0).unwrap() as u64;
    let (verdict, _) = replay_with(&rig.book.samples, 1000, OverrunPolicy::Skip, noisy_limits(), 2.5 + 1e-9);
    let difference = verdict.difference.unwrap();
    assert_eq!((verdict.agreed, difference.tick, difference.field), (first, first, "voltage_v"));
}

/// Changes a sample.
type Forge = fn(&mut Sample);

#[test]
fn one_flipped_bit_is_found_at_its_tick_and_under_its_name() {
    let mut rig = noisy(1000, OverrunPolicy::Skip);
    rig.run_in_lockstep(0).unwrap();
    let bit = |value: f64, bit: u32| f64::from_bits(value.to_bits() ^ 1 << bit);
    for tick in [0_usize, 1, 500, 999] {
        for flipped in 0..64 {
            let mut samples = rig.book.samples.clone();
            samples[tick].voltage_v = bit(samples[tick].voltage_v, flipped);
            let (verdict, _) = replay_with(&samples, 1000, OverrunPolicy::Skip, noisy_limits(), 2.5);
            let difference = verdict.difference.unwrap_or_else(|| panic!("tick {tick}, bit {flipped}"));
            assert_eq!((verdict.agreed, difference.tick), (tick as u64, tick as u64));
            assert_eq!(difference.field, "voltage_v", "tick {tick}, bit {flipped}");
        }
    }
    let forgeries: [(&str, Forge); 8] = [
        ("segment", |s| s.segment += 1),
        ("step", |s| s.step ^= 1),
        ("flags", |s| s.flags ^= flags::BRAKE_OPEN),
        ("flags", |s| s.flags ^= flags::SLEW_LIMITED),
        ("trip", |s| s.trip = 0x0303),
        ("target", |s| s.target += 1e-12),
        ("target_of", |s| s.target_of += 1),
        ("tick", |s| s.tick += 1),
    ];
    for (field, forge) in forgeries {
        let mut samples = rig.book.samples.clone();
        forge(&mut samples[700]);
        let (verdict, _) = replay_with(&samples, 1000, OverrunPolicy::Skip, noisy_limits(), 2.5);
        let difference = verdict.difference.unwrap();
        assert_eq!((difference.tick - u64::from(field == "tick"), difference.field), (700, field));
    }
}

#[test]
fn a_recording_from_before_samples_held_targets_is_judged_by_the_rest() {
    let mut rig = noisy(300, OverrunPolicy::Skip);
    rig.run_in_lockstep(0).unwrap();
    rig.book.samples.iter_mut().for_each(|s| (s.target, s.target_of) = (f64::NAN, 0));
    assert_agrees(&rig, "without targets").unwrap();
    rig.book.samples[200].segment += 1;
    let difference = replay_of(&rig).0.difference.unwrap();
    assert_eq!((difference.tick, difference.field), (200, "segment"));
}

#[test]
fn a_changed_input_is_found_by_what_the_loop_makes_of_it() {
    let mut rig = noisy(1000, OverrunPolicy::Skip);
    rig.run_in_lockstep(0).unwrap();
    let mut samples = rig.book.samples.clone();
    samples[600].pressure1_bar += 1e-6;
    let (verdict, _) = replay_with(&samples, 1000, OverrunPolicy::Skip, noisy_limits(), 2.5);
    let difference = verdict.difference.unwrap();
    assert_eq!((difference.tick, difference.field), (600, "voltage_v"));
}

#[test]
fn a_recording_that_is_too_short_or_too_long_or_has_a_gap_does_not_agree() {
    let mut rig = noisy(100, OverrunPolicy::Skip);
    rig.run_in_lockstep(0).unwrap();
    let whole = rig.book.samples.clone();
    let judge = |samples: &[Sample]| {
        let (verdict, _) = replay_with(samples, 100, OverrunPolicy::Skip, noisy_limits(), 2.5);
        let Verdict { agreed, difference } = verdict;
        (agreed, difference.map(|d| (d.tick, d.field)))
    };
    assert_eq!(judge(&whole), (100, None));
    assert_eq!(judge(&whole[..60]), (60, Some((60, "tick"))), "cut off");
    assert_eq!(judge(&[]), (0, Some((0, "tick"))), "empty");
    let gap: Vec<Sample> = whole.iter().copied().filter(|s| s.tick != 40).collect();
    assert_eq!(judge(&gap), (40, Some((41, "tick"))), "a lost sample");
    for further in 1..3 {
        let mut longer = whole.clone();
        longer.extend((0..further).map(|k| Sample { tick: 100 + k, ..whole[99] }));
        assert_eq!(judge(&longer), (100, Some((100, "tick"))), "{further} beyond the end");
    }
}
