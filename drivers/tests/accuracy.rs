//! What the emulated rig's inner steps cost in accuracy, against steps of 50 us, as a share of each channel's range.

use drivers::EmulatedRig;
use drivers::emulated::{Noise, Settings};
use model::Parameters;
use model::effects::{Effect, EffectSet, LIBRARY};
use model::rec::STATES;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rt_core::{Command, Device, Fixture, Tick};

const FINE_STEP_S: f64 = 50e-6;
const FREE: Command =
    Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };

/// To and fro every 2.5 s, as in the paper's square waves.
fn square(ticks: u64) -> Vec<Command> {
    (0..ticks).map(|k| Command { voltage_v: if (k + 1250) / 2500 % 2 == 0 { 20.0 } else { -20.0 }, ..FREE }).collect()
}

/// Voltage steps of random size and length, with the brake closed or the bypass open at times. Signs alternate: the lever
/// stays where it may be.
fn random(ticks: u64) -> Vec<Command> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut commands = Vec::new();
    let mut sign = 1.0;
    while (commands.len() as u64) < ticks {
        let (length, valves) = (rng.random_range(200..1200), rng.random_range(0.0..1.0));
        let size = if rng.random_bool(0.1) { 0.0 } else { rng.random_range(1.0..20.0) };
        let command = Command { voltage_v: sign * size, brake_open: valves > 0.12, bypass_open: valves > 0.88, ..FREE };
        commands.extend(std::iter::repeat_n(command, length));
        sign = -sign;
    }
    commands
}

/// Angle and pressures at every tick.
fn play(commands: &[Command], effect: Option<(&'static dyn Effect, &[f64])>, settings: Settings) -> Vec<[f64; 3]> {
    let effects = EffectSet::new(STATES, effect.map(|(effect, k)| (effect, k.to_vec())));
    let settings = Settings { noise: Noise::NONE, ..settings };
    let mut rig = EmulatedRig::new(&Parameters::example(), effects, settings).expect("a rig");
    (0..)
        .zip(commands)
        .map(|(k, command)| {
            let m = rig.read(Tick::at(k)).expect("the rig reads");
            rig.write(Tick::at(k), command).expect("the rig writes");
            [m.angle_deg, m.pressure1_bar, m.pressure2_bar]
        })
        .collect()
}

/// Largest error of angle and pressures, as a share of their ranges.
fn error(commands: &[Command], effect: Option<(&'static dyn Effect, &[f64])>, vertical: bool) -> f64 {
    let settings = Settings { vertical, ..Settings::default() };
    let rows = play(commands, effect, settings);
    let fine = play(commands, effect, Settings { step_s: FINE_STEP_S, ..settings });
    let of = |channel: usize| {
        let values = || fine.iter().map(|row| row[channel]);
        let range = values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min);
        rows.iter().zip(&fine).map(|(a, b)| (a[channel] - b[channel]).abs()).fold(0.0, f64::max) / range
    };
    of(0).max(of(1)).max(of(2))
}

#[test]
fn the_reference_plant_is_within_a_millionth() {
    for vertical in [false, true] {
        for (name, commands) in [("square", square(30_000)), ("random", random(30_000))] {
            let error = error(&commands, None, vertical);
            println!("{name}, vertical {vertical}: {error:.1e}");
            assert!(error < 1e-6, "{name}, vertical {vertical}: {error:.1e}");
        }
    }
}

/// Far below any sensor's noise, which is a thousandth of the range: an effect may have corners of its own, at which no step is
/// split, and backlash closes its gap within 2 ms.
#[test]
fn a_plant_with_an_effect_is_within_a_tenth_of_the_noise() {
    let commands = random(6_000);
    for effect in LIBRARY {
        let header = effect.header();
        let typical: Vec<f64> = header.parameters.iter().map(|p| p.typical).collect();
        let most = if header.id == "backlash" { 1e-4 } else { 3e-6 };
        for k in std::iter::once(typical.as_slice()).chain(header.starts.iter().copied()) {
            let error = error(&commands, Some((*effect, k)), false);
            println!("{} {k:?}: {error:.1e}", header.id);
            assert!(error < most, "{} {k:?}: {error:.1e}", header.id);
        }
    }
}
