//! The flight recorder: what it keeps, whom it blames, and that it allocates nothing.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use common::world::{At, People, Rig, Thrower, limits, ms};
use rt_core::flight::{Culprit, DEPTH, FlightTick, Reason, recorder};
use rt_core::{Demand, Ended, Incident, Limits, OverrunPolicy, PERIOD_NS, Sample, Switches, flags};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is passed on to the system's allocator as it came; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A tick that was in time, or took 5 ms to read.
fn flown(tick: u64, late: bool) -> FlightTick {
    let sample = Sample { tick, scheduled_ns: tick * PERIOD_NS, ..Sample::BLANK };
    let read_ns = if late { 5_000_000 } else { 2_000 };
    FlightTick { sample: Sample { read_ns, ..sample }, publish_ns: 500, ended_ns: u64::from(read_ns) + 500 }
}

fn ticks(incident: &Incident) -> (u64, u64, usize) {
    let tick = |t: Option<&FlightTick>| t.unwrap().sample.tick;
    (tick(incident.ticks.first()), tick(incident.ticks.last()), incident.ticks.len())
}

#[test]
fn the_last_2000_ticks_are_kept_and_handed_over_when_the_aftermath_is_in() {
    let (mut recorder, mut log) = recorder();
    recorder.begin_run();
    for tick in 0..10_000 {
        recorder.record(flown(tick, tick == 7000));
        assert_eq!(log.take().is_some(), tick == 7200, "tick {tick}");
    }
    // The same again, looked at this time.
    recorder.begin_run();
    (0..10_000).for_each(|tick| recorder.record(flown(tick, tick == 7000)));
    let incident = log.take().unwrap();
    assert_eq!((incident.reason, incident.tick, incident.further), (Reason::Overrun, 7000, 0));
    assert_eq!(ticks(&incident), (5201, 7200, DEPTH));
    assert!(incident.ticks.windows(2).all(|pair| pair[0].sample.tick + 1 == pair[1].sample.tick));
    assert_eq!(incident.at().map(|at| at.sample.read_ns), Some(5_000_000));
    assert_eq!(incident.usual_ns(Culprit::Device), 2_000);
    let text = incident.to_string();
    assert!(text.contains("tick 7000: slow device, 5.000 ms (usually 0.0020 ms)"), "{text}");
    assert_eq!((log.take(), recorder.end_run()), (None, 0), "handed over once");
}

#[test]
fn a_run_that_ends_within_the_aftermath_hands_over_what_there_is_and_the_next_begins_afresh() {
    let (mut recorder, mut log) = recorder();
    for _run in 0..10 {
        recorder.begin_run();
        (0..50).for_each(|tick| recorder.record(flown(tick, tick == 30)));
        assert_eq!(log.take(), None);
        assert_eq!(recorder.end_run(), 0);
        let incident = log.take().unwrap();
        assert_eq!((ticks(&incident), incident.tick), ((0, 49, 50), 30));
    }
    recorder.begin_run();
    (0..5000).for_each(|tick| recorder.record(flown(tick, false)));
    assert_eq!((recorder.end_run(), log.take()), (0, None), "nothing happened");
}

#[test]
fn incidents_in_one_aftermath_share_a_record_and_what_ends_the_run_is_told_first() {
    let (mut recorder, mut log) = recorder();
    recorder.begin_run();
    for tick in 0..1000 {
        let mut flown = flown(tick, [300, 310, 320].contains(&tick));
        if tick >= 330 {
            flown.sample.flags = flags::TRIPPED;
        }
        recorder.record(flown);
    }
    let incident = log.take().unwrap();
    assert_eq!((incident.reason, incident.tick, incident.further), (Reason::Trip, 330, 3));
    assert_eq!(ticks(&incident), (0, 530, 531), "its own aftermath");
    assert_eq!((recorder.end_run(), log.take()), (0, None), "the latch is no second trip");
}

#[test]
fn what_nobody_takes_is_kept_as_long_as_there_are_spares_and_then_counted() {
    let (mut recorder, mut log) = recorder();
    recorder.begin_run();
    // Ten incidents; the last one still waits for its aftermath.
    (0..2800).for_each(|tick| recorder.record(flown(tick, tick % 300 == 0)));
    assert_eq!(recorder.end_run(), 7);
    let kept: Vec<Incident> = std::iter::from_fn(|| log.take()).collect();
    assert_eq!(kept.iter().map(|incident| incident.tick).collect::<Vec<_>>(), [0, 300, 600], "the oldest");
    // The spares are back: the recorder works as before.
    recorder.begin_run();
    (0..2800).for_each(|tick| {
        recorder.record(flown(tick, tick % 300 == 0));
        if let Some(incident) = log.take() {
            assert_eq!(incident.tick + 200, tick);
        }
    });
    assert_eq!(recorder.end_run(), 0);
    assert_eq!(log.take().map(|incident| incident.tick), Some(2700));
}

#[test]
fn the_loop_reports_what_could_not_be_kept() {
    let mut rig = Rig::new(3000, 0.0);
    (0..3000).step_by(300).for_each(|tick| rig.world.delay(At::Read, tick, 1.5));
    assert_eq!(rig.run(0).unwrap().statistics.incidents_dropped, 7);
}

/// The culprit of the only incident of a run in which these things took so long, and its line.
fn blamed(policy: OverrunPolicy, delays: &[(At, u64, f64)], tick: u64) -> (Culprit, String) {
    let mut rig = Rig::new(400, 0.0);
    rig.overrun = policy;
    (0..400).for_each(|tick| rig.world.delay(At::Control, tick, 0.01));
    delays.iter().for_each(|&(at, tick, delay_ms)| rig.world.delay(at, tick, delay_ms));
    rig.run(0).unwrap();
    let incident = rig.log.take().unwrap();
    assert_eq!((incident.reason, incident.tick), (Reason::Overrun, tick), "{delays:?}");
    assert_eq!(rig.log.take(), None);
    (incident.at().unwrap().culprit(), incident.to_string())
}

#[test]
fn the_culprit_is_who_took_the_time() {
    let cases = [
        (At::Wake, Culprit::Kernel, "late wake-up by the kernel"),
        (At::Read, Culprit::Device, "slow device"),
        (At::Write, Culprit::Device, "slow device"),
        (At::Reference, Culprit::Controller, "slow controller"),
        (At::Control, Culprit::Controller, "slow controller"),
        (At::Publish, Culprit::Publication, "slow publication"),
    ];
    for policy in OverrunPolicy::ALL {
        for (at, culprit, words) in cases {
            // Everybody took some of it.
            let all = [At::Wake, At::Read, At::Reference, At::Write, At::Publish].map(|at| (at, 150, 0.2));
            let (blamed, text) = blamed(policy, &[&all[..], &[(at, 150, 2.3)]].concat(), 150);
            assert_eq!(blamed, culprit, "{policy}, {at:?}");
            assert!(text.contains(words) && text.contains("at tick 150"), "{policy}, {at:?}: {text}");
        }
    }
}

#[test]
fn who_was_late_only_because_of_those_before_is_not_blamed_for_it() {
    let mut rig = Rig::new(400, 0.0);
    rig.overrun = OverrunPolicy::CatchUp;
    rig.world.delay(At::Write, 150, 3.5);
    rig.run(0).unwrap();
    let incident = rig.log.take().unwrap();
    assert_eq!((incident.tick, incident.further), (150, 2), "it, and ticks 151 and 152, which ended late as well");
    let culprit = |tick: u64| incident.ticks[tick as usize].culprit();
    assert_eq!(culprit(150), Culprit::Device);
    assert_eq!((culprit(151), culprit(152)), (Culprit::EarlierTicks, Culprit::EarlierTicks));
    let shares: u64 = incident.ticks[151].shares().iter().map(|(_, ns)| ns).sum();
    assert_eq!((shares, incident.ticks[151].ended_ns), (ms(2.5), ms(2.5)), "the parts are the whole");

    // Half a millisecond of its own would have been in time.
    let mut rig = Rig::new(400, 0.0);
    rig.overrun = OverrunPolicy::CatchUp;
    rig.world.delay(At::Write, 150, 1.6);
    rig.world.delay(At::Control, 151, 0.5);
    rig.run(0).unwrap();
    let incident = rig.log.take().unwrap();
    assert_eq!(incident.further, 1);
    assert_eq!(incident.ticks[151].culprit(), Culprit::EarlierTicks);
}

#[test]
fn a_deadline_that_trips_or_aborts_names_the_tick_that_missed_it() {
    for (policy, ended) in [(OverrunPolicy::SafeState, Ended::Tripped), (OverrunPolicy::Abort, Ended::Aborted)] {
        let mut rig = Rig::new(400, 0.0);
        rig.overrun = policy;
        rig.world.delay(At::Read, 150, 3.3);
        assert_eq!(rig.run(0).unwrap().ended, ended);
        let incident = rig.log.take().unwrap();
        assert_eq!((incident.reason, incident.tick, incident.further), (Reason::Overrun, 150, 0));
        assert_eq!(incident.at().map(FlightTick::culprit), Some(Culprit::Device));
        assert_eq!(incident.ticks.last().unwrap().sample.tick, if ended == Ended::Tripped { 159 } else { 154 });
        assert_eq!(rig.log.take(), None, "one incident, not two");
    }
}

#[test]
fn trips_and_faults_of_the_loop_are_incidents() {
    let mut rig = Rig::with(Limits { aftermath_ticks: 500, ..limits() }, 5000, 0.0);
    rig.people = Box::new(Thrower { at: 2500, switches: Switches::new() });
    rig.run(0).unwrap();
    let incident = rig.log.take().unwrap();
    assert_eq!((incident.reason, incident.tick, ticks(&incident)), (Reason::Trip, 2500, (701, 2700, DEPTH)));
    assert_eq!(incident.to_string(), "trip at tick 2500");

    for (read, write) in [(Some(70), None), (None, Some(70))] {
        let mut rig = Rig::new(5000, 0.0);
        (rig.tank.fail_read_at, rig.tank.fail_write_at) = (read, write);
        // It gives up after a while only.
        rig.world.delay(if read.is_some() { At::Read } else { At::Write }, 70, 20.0);
        rig.run(0).unwrap_err();
        let incident = rig.log.take().unwrap();
        assert_eq!((incident.reason, incident.tick, incident.further), (Reason::Fault, 70, 0));
        assert!(incident.at().unwrap().ended_ns >= ms(20.0));
    }

    let mut rig = Rig::new(5000, 0.0);
    rig.people = Box::new(People(vec![(100, Demand::Stop)]));
    rig.run(0).unwrap();
    assert_eq!(rig.log.take(), None, "a stop is no incident");
}

#[test]
fn recording_and_handing_over_allocate_nothing() {
    let (mut recorder, mut log) = recorder();
    recorder.begin_run();
    let before = ALLOCATIONS.get();
    // Nobody takes them: spares run out, and that is no reason to allocate or to free either.
    for tick in 0..20_000 {
        recorder.record(flown(tick, tick % 700 == 0));
    }
    let dropped = recorder.end_run();
    assert_eq!(ALLOCATIONS.get() - before, 0);
    assert!(dropped > 10);
    assert!(log.take().is_some());
    assert!(ALLOCATIONS.get() > before, "the counter counts");
}
