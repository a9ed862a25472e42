//! The emulated rig's tick allocates nothing: it runs inside the 1 kHz loop.

mod counting;

use counting::allocations;
use drivers::EmulatedRig;
use drivers::emulated::Settings;
use model::Parameters;
use model::effects::{EffectSet, LIBRARY};
use model::rec::STATES;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rt_core::{Command, Device, Fixture, Tick};

const TICKS: u64 = 10_000;
const FREE: Command =
    Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };
/// Every kind of fixture and every combination of the two valves.
const WAYS: usize = 6 * 4;

/// A kind of fixture, by its number, here and there; and the number of a command's fixture and valves.
fn fixture(kind: usize, rng: &mut ChaCha8Rng) -> Fixture {
    let angle_deg = rng.random_range(-15.0..15.0);
    let mut bar = || rng.random_range(2.5..3.5);
    match kind {
        0 => Fixture::Free,
        1 => Fixture::Clamped { angle_deg },
        2 => Fixture::Driven { angle_deg },
        3 => Fixture::Filled { angle_deg, pressure1_bar: bar(), pressure2_bar: bar() },
        4 => Fixture::Released { angle_deg, flow_ml_s: if bar() > 3.0 { 0.5 } else { 0.0 } },
        _ => Fixture::PumpBench { pressure1_bar: bar(), pressure2_bar: bar() },
    }
}

fn way(command: &Command) -> usize {
    let kind = match command.fixture {
        Fixture::Free => 0,
        Fixture::Clamped { .. } => 1,
        Fixture::Driven { .. } => 2,
        Fixture::Filled { .. } => 3,
        Fixture::Released { .. } => 4,
        Fixture::PumpBench { .. } => 5,
    };
    kind * 4 + usize::from(command.brake_open) * 2 + usize::from(command.bypass_open)
}

/// Plays commands that change every few ticks, at times with a tick left out; says how often each way was taken.
fn play(rig: &mut EmulatedRig, name: &str) -> [u32; WAYS] {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut taken = [0; WAYS];
    let (mut command, mut until) = (FREE, 0);
    let mut tick = 0;
    while tick < TICKS {
        let before = allocations();
        rig.read(Tick::at(tick)).expect("the rig reads");
        rig.write(Tick::at(tick), &command).expect("the rig writes");
        assert_eq!(allocations() - before, 0, "{name}, tick {tick}: {command:?}");
        taken[way(&command)] += 1;
        if tick >= until {
            until = tick + rng.random_range(1..60);
            // Filled now and then, so that no chamber runs empty.
            let kind = if rng.random_bool(0.3) { 3 } else { rng.random_range(0..6) };
            command = Command {
                voltage_v: rng.random_range(-6.0..6.0),
                brake_open: rng.random(),
                bypass_open: rng.random(),
                fixture: fixture(kind, &mut rng),
                segment: tick as u32,
            };
            if kind == 4 {
                // Oil is released behind closed valves alone.
                (command.brake_open, command.bypass_open) = (false, false);
            }
        }
        tick += if rng.random_bool(0.01) { 4 } else { 1 };
    }
    taken
}

#[test]
fn no_tick_of_the_rig_allocates_whatever_is_commanded() {
    let none = ("no effect", EffectSet::none());
    let each = LIBRARY.iter().map(|effect| {
        let header = effect.header();
        let typical = header.parameters.iter().map(|p| p.typical).collect();
        (header.id, EffectSet::new(STATES, [(*effect, typical)]))
    });
    let mut rigs = 0;
    for (name, effects) in std::iter::once(none).chain(each) {
        let settings = Settings { start: FREE, vertical: rigs % 2 == 1, seed: rigs, ..Settings::default() };
        let mut rig = EmulatedRig::new(&Parameters::example(), effects, settings).expect("a rig");
        let taken = play(&mut rig, name);
        for (way, times) in taken.iter().enumerate() {
            let (kind, valves) = (way / 4, way % 4);
            assert!(*times > 50 || (kind == 4 && valves > 0), "{name}: fixture {kind}, valves {valves}: {times} ticks");
        }
        rigs += 1;
    }
    assert_eq!(rigs as usize, LIBRARY.len() + 1);
}

#[test]
fn the_counter_counts_an_error_of_the_rig_too() {
    let mut rig = EmulatedRig::new(&Parameters::example(), EffectSet::none(), Settings::default()).expect("a rig");
    rig.read(Tick::at(0)).expect("the rig reads");
    let before = allocations();
    let refused = rig.write(Tick::at(0), &Command { voltage_v: 99.0, ..FREE });
    assert!(refused.is_err() && allocations() > before, "its message is made on the heap");
    let before = allocations();
    std::hint::black_box(vec![1u8; 100]);
    assert_eq!(allocations() - before, 2, "one allocation, and its release");
}
