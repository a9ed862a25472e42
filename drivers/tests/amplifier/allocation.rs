//! Neither side allocates after it was made.

use super::counting::allocations;
use super::{settings, state};
use drivers::amplifier::{Outbox, PROTOCOLS};
use std::hint::black_box;

#[test]
fn neither_side_allocates() {
    for kind in PROTOCOLS {
        let mut client = (kind.client)(&settings(kind)).unwrap();
        let mut drive = (kind.drive)(&settings(kind)).unwrap();
        let (mut out, mut back, mut told_count) = (Outbox::new(), Outbox::new(), 0);
        let mut state = state();
        let before = allocations();
        for tick in 0..10_000_u64 {
            client.command((tick as f64 / 100.0).sin() * 15.0, &mut out);
            match tick % 4 {
                0 => client.hello(&mut out),
                1 => client.keep_alive(&mut out),
                _ => client.request(&mut out),
            }
            state.telemetry.fault = (tick % 100 == 0).then_some(kind.example_fault);
            if tick % 7 == 0 {
                out.push(&[2, 1, 100, 3, 5, 2, 40, 3, 3]);
            }
            drive.hear(out.bytes(), tick * 1_000_000, &state, &mut back);
            black_box((drive.voltage_v(tick), drive.garbled()));
            // A drive that is not heard for a while.
            if tick % 1000 < 900 {
                client.hear(back.bytes(), &mut |told| {
                    black_box(told);
                    told_count += 1;
                });
            }
            black_box((client.garbled(), client.traffic()));
            if tick % 3000 == 0 {
                client.reset();
            }
            out.clear();
            back.clear();
        }
        assert_eq!(allocations() - before, 0, "{}", kind.name);
        assert!(told_count > 3000, "{}: {told_count}", kind.name);
    }
    let before = allocations();
    black_box(vec![1_u8]);
    assert_eq!(allocations() - before, 2, "the counter counts");
}
