//! What follows a missed deadline, by policy: with injected overruns on a scripted clock, and once each in real time.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod common;

use common::world::{At, Rig, ms};
use rt_core::{Breach, Channel, Ended, OverrunPolicy, PERIOD_NS, RealTime, RunReport, Sample, flags};

fn rig(policy: OverrunPolicy, ticks: u64) -> Rig {
    let mut rig = Rig::new(ticks, 0.5);
    rig.overrun = policy;
    rig
}

/// Every sample's number is one more than the one before it, whatever was passed over.
fn assert_counted(samples: &[Sample]) {
    assert!(samples.iter().enumerate().all(|(number, s)| s.sequence() == number as u64));
}

fn count(report: &RunReport) -> (u64, u64, u64) {
    let statistics = report.statistics;
    (statistics.ticks, statistics.skipped, statistics.overruns)
}

#[test]
fn skip_passes_over_what_is_past_and_is_on_time_again() {
    for at in [At::Wake, At::Read, At::Reference, At::Control, At::Write, At::Publish] {
        let mut rig = rig(OverrunPolicy::Skip, 40);
        rig.world.delay(at, 10, 3.4);
        let report = rig.run(0).unwrap();
        assert_eq!(rig.ticks(), (0..=10).chain(14..40).collect::<Vec<_>>(), "{at:?}");
        assert_eq!((report.ended, count(&report)), (Ended::Completed, (37, 3, 1)), "{at:?}");
        let next = rig.sample(14);
        assert_eq!((next.skipped, next.overrun(), next.lateness_ns, next.behind_ns), (3, true, 0, 0), "{at:?}");
        assert_eq!(next.scheduled_ns, 14 * PERIOD_NS, "{at:?}");
        for sample in rig.book.samples.iter().filter(|s| s.tick != 14) {
            assert_eq!((sample.skipped, sample.overrun()), (if sample.tick < 14 { 0 } else { 3 }, false), "{at:?}");
        }
        assert_counted(&rig.book.samples);
        // The device hears nothing of the ticks that were passed over, and goes on with the one after.
        assert!(!rig.tank.written.iter().any(|(tick, _)| (11..14).contains(tick)), "{at:?}");
        assert!(report.to_string().contains("1 deadlines missed, 3 ticks skipped"), "{report}");
    }
}

#[test]
fn a_tick_that_ends_as_the_next_begins_is_late_but_costs_none() {
    for (delay_ms, overruns, next, skipped) in
        [(0.999_999, 0, 11, 0), (1.0, 1, 11, 0), (1.000_001, 1, 12, 1), (2.0, 1, 12, 1), (4.0, 1, 14, 3)]
    {
        let mut rig = rig(OverrunPolicy::Skip, 20);
        rig.world.delay(At::Write, 10, delay_ms);
        let report = rig.run(0).unwrap();
        assert_eq!(count(&report), (20 - skipped, skipped, overruns), "{delay_ms} ms");
        let after = rig.book.samples[11];
        assert_eq!((after.tick, after.skipped, after.lateness_ns), (next, skipped, 0), "{delay_ms} ms");
        assert_eq!(after.overrun(), overruns == 1, "statistics and flags agree, {delay_ms} ms");
    }
}

#[test]
fn skips_add_up_over_a_run_that_is_late_again_and_again() {
    let mut rig = rig(OverrunPolicy::Skip, 100);
    for tick in (0..100).step_by(10) {
        rig.world.delay(At::Read, tick, 2.5);
    }
    let report = rig.run(0).unwrap();
    assert_eq!(count(&report), (80, 20, 10));
    assert_eq!(rig.book.samples.last().unwrap().skipped, 20);
    assert_counted(&rig.book.samples);
}

#[test]
fn catch_up_runs_every_tick_and_the_backlog_shrinks() {
    let mut rig = rig(OverrunPolicy::CatchUp, 40);
    (0..40).for_each(|tick| rig.world.delay(At::Control, tick, 0.15));
    rig.world.delay(At::Read, 10, 3.3);
    let report = rig.run(0).unwrap();
    assert_eq!(rig.ticks(), (0..40).collect::<Vec<_>>());
    assert_eq!((report.ended, count(&report)), (Ended::Completed, (40, 0, 3)));
    // Done at 13.45 ms; each tick then takes 0.15 of its 1 ms.
    for (tick, behind_ms) in [(10, 0.0), (11, 2.45), (12, 1.6), (13, 0.75), (14, 0.0), (15, 0.0)] {
        let sample = rig.sample(tick);
        assert_eq!(u64::from(sample.behind_ns), ms(behind_ms), "tick {tick}");
        assert_eq!(sample.lateness_ns, ms(behind_ms), "tick {tick}: the wake-up itself was not late");
        assert_eq!(sample.overrun(), (11..14).contains(&tick), "tick {tick}");
        assert_eq!(sample.scheduled_ns, tick * PERIOD_NS, "no tick is shifted");
    }
    assert!(rig.book.samples.iter().all(|s| s.skipped == 0));
    let written: Vec<u64> = rig.tank.written.iter().map(|(tick, _)| *tick).collect();
    assert_eq!(written, (0..=40).collect::<Vec<_>>());
}

#[test]
fn safe_state_trips_at_the_next_tick_and_ends_after_its_aftermath() {
    let mut rig = rig(OverrunPolicy::SafeState, 1000);
    rig.world.delay(At::Read, 10, 3.4);
    let report = rig.run(0).unwrap();
    let trip = report.trip.unwrap();
    assert_eq!((report.ended, count(&report)), (Ended::Tripped, (17, 3, 1)));
    assert_eq!((trip.tick, trip.channel, trip.breach), (14, Channel::Deadline, Breach::Above(1.0)));
    assert!((trip.value - 3.4).abs() < 1e-9, "how late, ms");
    assert!(report.to_string().contains("deadline missed: 3.40 ms"), "{report}");
    assert_eq!(rig.ticks(), (0..=10).chain(14..=19).collect::<Vec<_>>());
    for sample in &rig.book.samples {
        let safe = sample.tick >= 14;
        assert_eq!((sample.tripped(), sample.trip), (safe, if safe { trip.code() } else { 0 }));
        assert_eq!(sample.voltage_v, if safe { 0.0 } else { 0.5 }, "tick {}", sample.tick);
    }
    assert!(rig.book.samples.last().unwrap().last());
    assert!(rig.tank.written.iter().all(|(tick, command)| (command.voltage_v == 0.0) == (*tick >= 14)));
}

#[test]
fn abort_writes_the_safe_state_at_once_and_ends_with_the_next_tick() {
    let mut rig = rig(OverrunPolicy::Abort, 1000);
    rig.world.delay(At::Publish, 10, 3.4);
    let report = rig.run(0).unwrap();
    assert_eq!((report.ended, report.trip, count(&report)), (Ended::Aborted, None, (12, 3, 1)));
    assert!(report.to_string().contains("aborted"), "{report}");
    let calls = rig.world.calls().join(", ");
    let end = "write 10, publish 10, write 10, read 14, reference 14, write 14, publish 14, write 15";
    assert!(calls.ends_with(end), "{calls}");
    let safe: Vec<bool> = rig.tank.written[10..].iter().map(|(_, c)| c.voltage_v == 0.0 && c.bypass_open).collect();
    assert_eq!(safe, [false, true, true, true], "at once, at the closing tick, and after it");
    let last = rig.book.samples.last().unwrap();
    assert_eq!((last.tick, last.voltage_v, last.trip), (14, 0.0, 0));
    assert_eq!(last.flags, flags::LAST | flags::OVERRUN | flags::BYPASS_OPEN);
    assert_eq!(rig.run(1).unwrap().run, 1, "nothing latches");
}

#[test]
fn a_run_whose_last_tick_is_late_is_complete_under_every_policy() {
    for policy in OverrunPolicy::ALL {
        let mut rig = rig(policy, 10);
        rig.world.delay(At::Control, 9, 5.0);
        let report = rig.run(0).unwrap();
        assert_eq!((report.ended, count(&report)), (Ended::Completed, (10, 0, 1)), "{policy}");
        assert_eq!(rig.tank.written.last().map(|(tick, c)| (*tick, c.voltage_v)), Some((10, 0.0)), "{policy}");
    }
}

#[test]
fn a_late_tick_of_the_run_before_has_no_bearing_on_the_next() {
    let mut rig = rig(OverrunPolicy::Abort, 10);
    rig.world.delay(At::Control, 9, 5.0);
    rig.run(0).unwrap();
    rig.world.delay(At::Control, 9, 0.0);
    rig.book.samples.clear();
    assert_eq!(rig.run(1).unwrap().ended, Ended::Completed);
    assert!(rig.book.samples.iter().all(|s| !s.overrun() && s.skipped == 0));
}

/// A run on the real clock, whose device blocks the loop for 5 ms or more at tick 0. Whatever the machine does besides, tick 5
/// is the first that can be on time.
fn run_in_real_time(policy: OverrunPolicy, ticks: u64) -> (Rig, RunReport) {
    let mut rig = rig(policy, ticks);
    rig.tank.block_at = Some(0);
    let report = rig.run_by(&mut RealTime::default(), 0).unwrap();
    assert!(report.statistics.overruns >= 1 && report.statistics.tick_max_ns >= ms(5.0));
    assert!(rig.sample(0).read_ns >= 5_000_000);
    assert!(rig.book.samples[1].overrun());
    assert_counted(&rig.book.samples);
    (rig, report)
}

#[test]
fn real_time_skip() {
    let (rig, report) = run_in_real_time(OverrunPolicy::Skip, 30);
    let next = rig.book.samples[1];
    assert!(next.tick >= 5 && next.skipped == next.tick - 1 && next.skipped >= 4, "{next:?}");
    assert_eq!(report.ended, Ended::Completed);
    assert!(report.statistics.skipped >= 4);
}

#[test]
fn real_time_catch_up() {
    let (rig, report) = run_in_real_time(OverrunPolicy::CatchUp, 30);
    assert_eq!(rig.ticks(), (0..30).collect::<Vec<_>>());
    assert!(rig.sample(1).behind_ns >= 4_000_000 && rig.sample(4).behind_ns >= 1_000_000);
    assert_eq!((report.ended, report.statistics.skipped), (Ended::Completed, 0));
    assert!(report.statistics.overruns >= 4, "ticks 0..=3 at least ended late");
}

#[test]
fn real_time_safe_state() {
    let (rig, report) = run_in_real_time(OverrunPolicy::SafeState, 1000);
    let next = rig.book.samples[1];
    let trip = report.trip.unwrap();
    assert_eq!((report.ended, trip.channel, trip.tick), (Ended::Tripped, Channel::Deadline, next.tick));
    assert!(next.tick >= 5 && next.tripped() && next.voltage_v == 0.0 && trip.value >= 5.0);
}

#[test]
fn real_time_abort() {
    let (rig, report) = run_in_real_time(OverrunPolicy::Abort, 1000);
    assert_eq!((report.ended, rig.book.samples.len()), (Ended::Aborted, 2));
    let last = rig.book.samples[1];
    assert!(last.tick >= 5 && last.last() && !last.tripped() && last.voltage_v == 0.0);
    let written: Vec<_> = rig.tank.written.iter().map(|(tick, c)| (*tick, c.voltage_v)).collect();
    assert_eq!(written, [(0, 0.5), (0, 0.0), (last.tick, 0.0), (last.tick + 1, 0.0)]);
}
