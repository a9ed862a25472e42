//! Nodes that hear nothing fresh: the safe state, and what goes on after it.

use super::plant::{Bench, at, read, same, sync};
use super::rig::{FREE, MS, NODE_TIMEOUT_NS, in_process, preparation};
use drivers::nodes::exchange::News;
use drivers::wired::Preparation;
use rt_core::{Command, Device, Fixture, SafeState, Tick};

#[test]
fn nodes_go_to_the_safe_state_by_themselves_and_the_plant_goes_on() {
    for frozen in [false, true] {
        let safe = SafeState::default();
        let preparation = preparation(4, FREE);
        let mut bench = Bench::prepared(preparation);
        let mut rig = in_process(&preparation);
        for tick in 0..30 {
            let answer = bench.tick(tick, at(7.0), 0);
            assert!(same(&answer.measurement, &read(&mut rig, &[(tick, at(7.0))])[0]));
        }
        // From here on nothing fresh comes; the last SYNC was at tick 29.
        let last_ns = bench.now_ns - MS;
        for after_ms in 1..=80 {
            bench.now_ns = last_ns + after_ms * MS;
            let answer = if frozen {
                bench.run(29, at(7.0))
            } else {
                bench.plant.poll(bench.now_ns);
                bench.plant.answer()
            };
            assert_eq!(answer.timed_out, after_ms >= 50, "{after_ms}");
            let open = (answer.brake_is_open, answer.bypass_is_open);
            assert_eq!(open, if after_ms >= 50 { (safe.brake_open, safe.bypass_open) } else { (true, false) });
            // The amplifier goes on as it was told, in its own time.
            if after_ms == 60 {
                bench.plant.amplifier(0.0, bench.now_ns);
            }
            let expected = match after_ms {
                0..50 => None,
                50 => {
                    rig.write(Tick::at(79), &Command { voltage_v: 7.0, ..safe.command(Fixture::Free, 0) }).unwrap();
                    Some(rig.read(Tick::at(79)).unwrap())
                }
                _ => Some(rig.read(Tick::at(29 + after_ms)).unwrap()),
            };
            if let Some(expected) = expected {
                assert!(same(&answer.measurement, &expected), "{after_ms} ms after the last");
            }
            if after_ms == 60 {
                rig.write(Tick::at(89), &safe.command(Fixture::Free, 0)).unwrap();
            }
        }
        assert_eq!(bench.news().last(), Some(&News::TimedOut(79)));
        assert_eq!(NODE_TIMEOUT_NS / MS, 50);

        // A bench that was held up goes on with the tick that it is by then.
        bench.now_ns = last_ns + 83 * MS;
        let answer = bench.tick(29 + 83, at(-5.0), 0);
        assert!(!answer.timed_out && answer.brake_is_open && !answer.bypass_is_open);
        assert_eq!(bench.plant.tick(), 112);
        let answer = bench.tick(113, at(-5.0), 0);
        let told = [(112, at(-5.0)), (113, at(-5.0))];
        assert!(same(&answer.measurement, &read(&mut rig, &told)[1]));
        assert_eq!(bench.news(), [News::Recovered(112)]);
        assert_eq!(bench.plant.counted().timeouts, 1);
    }
}

#[test]
fn after_a_time_out_a_counter_that_went_on_less_than_time_did_does_not_hold_the_plant_back() {
    let mut bench = Bench::prepared(preparation(4, FREE));
    for tick in 0..10 {
        bench.tick(tick, at(7.0), 0);
    }
    bench.now_ns += 199 * MS;
    bench.plant.poll(bench.now_ns);
    assert_eq!(bench.plant.tick(), 9 + 200);
    for (counter, tick) in [(10, 209), (11, 210), (12, 211)] {
        bench.tick(counter, at(7.0), 0);
        assert_eq!(bench.plant.tick(), tick);
    }
    // One that is nowhere near: another bench's, without a preparation.
    bench.now_ns += 100 * MS;
    bench.tick(40_000, at(7.0), 0);
    assert_eq!(bench.plant.tick(), 211 + 101);
    bench.tick(40_001, at(7.0), 0);
    assert_eq!(bench.plant.tick(), 211 + 102);
}

#[test]
fn a_stall_of_the_nodes_themselves_is_no_time_out() {
    let mut bench = Bench::prepared(preparation(4, FREE));
    bench.tick(0, at(1.0), 0);
    let last_ns = bench.now_ns - MS;
    // Frames that came in time are looked at 200 ms later.
    for tick in 1..=200 {
        let said = Preparation { start: at(1.0), ..bench.preparation };
        bench.plant.sync(&sync(tick, true, said), last_ns + tick * MS, last_ns + 200 * MS);
    }
    assert_eq!((bench.plant.tick(), bench.plant.counted().timeouts), (200, 0));
}
