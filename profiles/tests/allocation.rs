//! Playing a script allocates nothing: it runs inside the 1 kHz loop.

use profiles::{Context, builtin};
use rt_core::{Measurement, Reference, Tick};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

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
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn no_tick_of_a_built_in_script_allocates() {
    for script in builtin().expect("built-in scripts parse") {
        let mut playback = script.compile(&Context { u_max_v: 24.0, seed: 1 }).expect("compiles");
        let before = ALLOCATIONS.get();
        let mut ticks = 0u64;
        loop {
            // Swings through every limit that the scripts wait for.
            let swing = (ticks as f64 * 2e-4).sin();
            let (pressure1_bar, pressure2_bar) = (3.0 + 2.5 * swing, 3.0 - 2.5 * swing);
            let angle_deg = 45.0 * swing;
            let measured = Measurement { angle_deg, pressure1_bar, pressure2_bar, ..Measurement::NONE };
            if playback.step(Tick::at(ticks), &measured).last {
                break;
            }
            ticks += 1;
        }
        assert_eq!(ALLOCATIONS.get() - before, 0, "{} in {ticks} ticks", script.name);
        assert!(ticks > 1000, "{}", script.name);
    }
    let before = ALLOCATIONS.get();
    std::hint::black_box(vec![1u8; 100]);
    assert_eq!(ALLOCATIONS.get() - before, 1, "the counter counts");
}
