//! What is lost on the wire costs a value, and never makes a wrong one.

use super::{Pair, state};
use drivers::amplifier::{Outbox, PROTOCOLS, Told};
use proptest::prelude::*;

fn untold_or(told: f32, meant: f32) -> bool {
    told.is_nan() || (told - meant).abs() < 0.1
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
                let meant = state().telemetry;
                pair.client.hear(&bytes, &mut |told| {
                    if let Told::Telemetry(told) = told {
                        tellings += 1;
                        assert!(
                            untold_or(told.supply_v, meant.supply_v)
                                && untold_or(told.motor_current_a, meant.motor_current_a)
                                && untold_or(told.speed_rpm, meant.speed_rpm)
                                && untold_or(told.duty, meant.duty)
                                && untold_or(told.temperature_c, meant.temperature_c)
                                && told.fault.is_none(),
                            "{}: {told:?}", kind.name
                        );
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
