//! Playing a script allocates nothing: it runs inside the 1 kHz loop.

use profiles::{Context, EXAMPLES, Playback, Script, builtin};
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

/// Ticks played up to the last, and allocations meanwhile.
fn play(playback: &mut Playback, gap: impl Fn(u64) -> u64) -> (u64, u64) {
    let before = ALLOCATIONS.get();
    let mut tick = 0;
    loop {
        // Swings through every limit that the scripts wait for.
        let swing = (tick as f64 * 2e-4).sin();
        let (pressure1_bar, pressure2_bar) = (3.0 + 2.5 * swing, 3.0 - 2.5 * swing);
        let angle_deg = 45.0 * swing;
        let measured = Measurement { angle_deg, pressure1_bar, pressure2_bar, ..Measurement::NONE };
        if playback.step(Tick::at(tick), &measured).last {
            return (tick, ALLOCATIONS.get() - before);
        }
        tick += gap(tick);
    }
}

/// Each wave with a pass of its own, quantities in turn.
const WAVES: &str = r#"name = "waves"
protocol = "random-steps"
role = "identify"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
[files]
"a.csv" = "time_s,value\n0,0\n0.02,0.7\n0.05,0.2\n"
[[step]]
repeat = 20
[[step.step]]
target = { quantity = "angle_deg", wave = "step", value = 0.5 }
for_s = 0.1
[[step.step]]
target = { quantity = "angle_deg", wave = "ramp", to = 0.9 }
for_s = 0.1
[[step.step]]
target = { quantity = "pressure_difference_bar", wave = "ramp", to = 0.9, rate_per_s = 3 }
for_s = 0.1
[[step.step]]
target = { quantity = "flow_ml_s", wave = "sine", amplitude = 0.9, frequency_hz = 7 }
for_s = 0.1
[[step.step]]
target = { quantity = "angle_deg", wave = "chirp", amplitude = 0.9, from_hz = 7, to_hz = 70 }
for_s = 0.1
[[step.step]]
target = { quantity = "angle_deg", wave = "chirp", amplitude = 0.9, from_hz = 7, to_hz = 70, sweep = "logarithmic" }
for_s = 0.1
[[step.step]]
target = { quantity = "voltage_u_max", wave = "multisine", amplitude = 0.9, band_hz = [10, 90], period_s = 0.1 }
for_s = 0.1
[[step.step]]
target = { quantity = "voltage_v", wave = "random-steps", range = [-0.9, 0.9], length_s = [0.01, 0.02] }
for_s = 0.1
[[step.step]]
target = { quantity = "angle_deg", wave = "file", file = "a.csv" }
for_s = 0.1
[[step.step]]
target = { quantity = "angle_deg", wave = "file", file = "a.csv", interpolation = "hold" }
until = [{ channel = "angle_deg", rate_below = 100, window_s = 0.01 }]
timeout_s = 0.1
"#;

#[test]
fn no_tick_of_a_wave_allocates_nor_do_ticks_left_out() {
    let script = Script::parse(WAVES, "waves.toml").expect("parses");
    let playback = script.compile(&Context { u_max_v: 24.0, seed: 1, hands: profiles::Hands::Rig }).expect("compiles");
    for (gap, least) in [(1, 10_000), (7, 10_000), (250, 5_000)] {
        let mut playback = playback.clone();
        let (ticks, allocations) = play(&mut playback, |tick| gap + tick % 2);
        assert_eq!(allocations, 0, "a gap of {gap}");
        assert!(ticks >= least, "{ticks}");
    }
}

#[test]
fn no_tick_of_a_built_in_script_allocates() {
    let examples = EXAMPLES.iter().map(|(file, text)| Script::parse(text, file).expect("examples parse"));
    for script in builtin().expect("built-in scripts parse").into_iter().chain(examples) {
        let mut playback =
            script.compile(&Context { u_max_v: 24.0, seed: 1, hands: profiles::Hands::Rig }).expect("compiles");
        let (ticks, allocations) = play(&mut playback, |_| 1);
        assert_eq!(allocations, 0, "{} in {ticks} ticks", script.name);
        assert!(ticks > 1000, "{}", script.name);
    }
    let before = ALLOCATIONS.get();
    std::hint::black_box(vec![1u8; 100]);
    assert_eq!(ALLOCATIONS.get() - before, 1, "the counter counts");
}
