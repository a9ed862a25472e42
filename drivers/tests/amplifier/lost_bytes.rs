//! What is lost on the wire costs a value, and never makes a wrong one.

use super::{Pair, state};
use drivers::amplifier::{Outbox, PROTOCOLS, Telemetry, Told};
use proptest::prelude::*;

fn untold_or(told: f32, meant: f32) -> bool {
    told.is_nan() || (told - meant).abs() < 0.1
}

/// Each quantity is not told, or is the drive's.
fn right(told: &Telemetry, protocol: &str) {
    let meant = state().telemetry;
    assert!(
        untold_or(told.supply_v, meant.supply_v)
            && untold_or(told.motor_current_a, meant.motor_current_a)
            && untold_or(told.speed_rpm, meant.speed_rpm)
            && untold_or(told.duty, meant.duty)
            && untold_or(told.temperature_c, meant.temperature_c)
            && told.fault.is_none(),
        "{protocol}: {told:?}"
    );
}

proptest! {
    /// Replies of TMCL do not say which parameter they answer: the client keeps track by their order.
    #[test]
    fn a_lost_datagram_never_gives_a_value_to_another_quantity(
        calls in prop::collection::vec((0..4_u8, 0..10_u8), 50..200), late in 0..5_usize,
    ) {
        for kind in PROTOCOLS {
            let mut pair = Pair::of(kind);
            let mut out = Outbox::new();
            // Frames on their way back: they come `late` calls after they were sent.
            let mut wire = std::collections::VecDeque::new();
            let (mut tellings, mut asked) = (0, 0);
            for (call, lost) in calls.iter().copied().chain(std::iter::repeat_n((1, 9), 40)) {
                out.clear();
                match call {
                    0 => pair.client.command(1.0, &mut out),
                    1 | 2 => pair.client.request(&mut out),
                    _ => pair.client.keep_alive(&mut out),
                }
                asked += 1;
                // One of ten is lost there, one of ten on the way back.
                pair.back.clear();
                if lost != 0 {
                    pair.drive.hear(out.bytes(), 0, &pair.state, &mut pair.back);
                }
                wire.push_back(if lost == 1 { vec![] } else { pair.back.bytes().to_vec() });
                if wire.len() <= late {
                    continue;
                }
                let bytes = wire.pop_front().unwrap();
                pair.client.hear(&bytes, &mut |told| {
                    if let Told::Telemetry(told) = told {
                        tellings += 1;
                        right(&told, kind.name);
                    }
                });
            }
            // At the end nothing is lost any more: telemetry goes on.
            prop_assert!(tellings >= 5, "{}: {} of {}", kind.name, tellings, asked);
        }
    }
}

#[test]
fn a_drive_that_was_silent_for_long_is_understood_again() {
    for kind in PROTOCOLS {
        let mut pair = Pair::of(kind);
        let mut out = Outbox::new();
        for _ in 0..500 {
            out.clear();
            pair.client.command(1.0, &mut out);
            pair.client.request(&mut out);
        }
        let mut tellings = 0;
        for _ in 0..20 {
            let (_, told) = pair.exchange(0, |client, out| client.request(out));
            tellings += told.iter().filter(|told| matches!(told, Told::Telemetry(_))).count();
        }
        assert!(tellings >= 15, "{}: {tellings}", kind.name);
    }
}

#[test]
fn an_answer_that_comes_after_very_many_others_or_after_a_reset_is_no_other_ones() {
    for kind in PROTOCOLS {
        for reset in [false, true] {
            let mut pair = Pair::of(kind);
            let (mut wire, mut tellings) = (vec![], 0);
            let mut ask = |pair: &mut Pair, request: bool| {
                pair.out.clear();
                pair.back.clear();
                if request {
                    pair.client.request(&mut pair.out)
                } else {
                    pair.client.command(1.0, &mut pair.out)
                };
                pair.drive.hear(pair.out.bytes(), 0, &pair.state, &mut pair.back);
                wire.extend(pair.back.bytes());
            };
            ask(&mut pair, true);
            if reset {
                pair.client.reset();
            } else {
                (0..100).for_each(|_| ask(&mut pair, false));
            }
            ask(&mut pair, true);
            ask(&mut pair, true);
            pair.client.hear(&wire, &mut |told| {
                if let Told::Telemetry(told) = told {
                    right(&told, kind.name);
                }
            });
            for _ in 0..3 {
                let (_, told) = pair.exchange(0, |client, out| client.request(out));
                tellings += told.iter().filter(|told| matches!(told, Told::Telemetry(_))).count();
            }
            assert!(tellings >= 2, "{}: {tellings}", kind.name);
        }
    }
}
