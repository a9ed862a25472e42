//! The emulated rig of the demo: drawn from a seed with one effect that the reference model lacks, and run through all
//! built-in scripts. What was drawn is a [`ModelFile`], so that truth and identified model are compared field by field.

use crate::campaign::known::Known;
use crate::campaign::{Session, Settings};
use crate::controller::Settings as LoopSettings;
use crate::devices::Devices;
use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::progress::Progress;
use crate::recorder::OnFull;
use crate::rig_file::RigRecord;
use crate::runner::Mode;
use crate::setup::Knowledge;
use crate::simulation::added_effects;
use crate::strength::strength;
use drivers::EmulatedRig;
use drivers::emulated::Settings as RigSettings;
use drivers::nodes::PlantFactory;
use drivers::wired::Preparation;
use model::effects::{Effect, LIBRARY};
use model::parameters::{AddedEffect, close_losses, index};
use model::{ModelFile, Parameters};
use profiles::{BUILTIN, Plane, Script};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use recordings::{Campaign, RigFacts};
use rt_core::Limits;
use std::path::Path;

/// Parameters of a drawn rig lie within this fraction of the example's.
const SPREAD: f64 = 0.10;

/// Strength of a drawn effect, noise floors: it matters, and it is no wreck.
const STRENGTH: std::ops::Range<f64> = 4.0..25.0;

/// A rig with one effect out of `library`. The same seed and library give the same rig.
pub fn draw(seed: u64, library: &[&'static dyn Effect]) -> ModelFile {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let base = draw_plain(&mut rng);
    let effect = library[rng.random_range(0..library.len())];
    let values = sized(&mut rng, &base, effect);
    let parameters = effect.header().parameters.iter().zip(values).map(|(p, v)| (p.name.to_owned(), v));
    let effect = AddedEffect { id: effect.header().id.to_owned(), parameters: parameters.collect() };

    let mut truth = ModelFile::plain(base);
    truth.source.insert("drawn_from_seed".to_owned(), seed.to_string());
    truth.effect.push(effect);
    truth
}

/// A rig without any effect.
pub fn draw_plain(rng: &mut impl Rng) -> Parameters {
    let example = Parameters::example();
    let mut k = example.to_vector();
    for (i, value) in k.iter_mut().enumerate() {
        let factor = rng.random_range(1.0 - SPREAD..1.0 + SPREAD);
        // a2 is no parameter of its own; inertia and gravity are known of a rig, and stay the example's.
        if ![index::A2, index::J, index::G].contains(&i) {
            *value *= factor;
        }
    }
    close_losses(&mut k);
    Parameters::from_vector(&k, example.pump.u_max)
}

/// Values of an effect's parameters: one of the library's shapes and signs, at a size that shows [`STRENGTH`] noise floors.
fn sized(rng: &mut ChaCha8Rng, base: &Parameters, effect: &'static dyn Effect) -> Vec<f64> {
    let header = effect.header();
    let wanted = rng.random_range(STRENGTH.start.ln()..STRENGTH.end.ln()).exp();
    let first = rng.random_range(0..header.starts.len());
    let mut best = (f64::INFINITY, header.starts[first].to_vec());
    for turn in 0..header.starts.len() {
        let mut values = header.starts[(first + turn) % header.starts.len()].to_vec();
        for (p, v) in header.parameters.iter().zip(&mut values).filter(|(p, _)| !p.size) {
            *v = (*v * rng.random_range(0.75..1.35)).clamp(p.lower, p.upper);
        }
        for _ in 0..8 {
            let shown = strength(base, effect, &values).unwrap_or(f64::INFINITY);
            let off = (shown.max(1e-9) / wanted).ln().abs();
            if off < best.0 {
                best = (off, values.clone());
            }
            let factor = (wanted / shown.max(1e-9)).clamp(0.1, 10.0);
            // a size that one could meet on a rig
            for (p, v) in header.parameters.iter().zip(&mut values).filter(|(p, _)| p.size) {
                let most = 5.0 * p.typical;
                *v = (*v * factor).clamp(p.lower.max(-most), p.upper.min(most));
            }
        }
        if best.0 < 0.3 {
            break;
        }
    }
    best.1
}

/// The effects that the demo draws from: some of every balance.
pub fn drawn_effects() -> &'static [&'static dyn Effect] {
    static DRAWN: std::sync::LazyLock<Vec<&'static dyn Effect>> =
        std::sync::LazyLock::new(|| LIBRARY.iter().copied().filter(|e| DRAWN_IDS.contains(&e.header().id)).collect());
    &DRAWN
}

/// See [`drawn_effects`].
const DRAWN_IDS: [&str; 8] = [
    "tilt",
    "pressure_friction",
    "cross_leakage",
    "chamber_asymmetry",
    "wall_creep",
    "pump_lag",
    "line_inertance",
    "pressure_drift",
];

/// Runs every built-in script on the emulated rig `truth` and leaves a campaign folder in `dir`. Nothing of `truth` but
/// inertia, gravity and the largest voltage reaches the folder.
pub fn record(dir: &Path, truth: &ModelFile, seed: u64, progress: &Progress) -> Result<Campaign, Failure> {
    let load = truth.parameters.load;
    let u_max_v = truth.parameters.pump.u_max;
    // The emulated chambers neither burst nor cavitate at the edge of what the scripts reach on a drawn rig.
    let settings = Settings {
        dir: dir.to_owned(),
        name: format!("emulated rig, seed {seed}"),
        rig: RigFacts { inertia_kg_m2: load.J, gravity_nm: load.G, u_max_v },
        limits: Limits { pressure_min_bar: 0.3, pressure_max_bar: 9.0, ..Limits::default() },
        seed,
        notes: [("device".to_owned(), "emulated rig".to_owned())].into(),
        mode: Mode::Lockstep,
        // In virtual time the run is over in a moment, and lost samples end the campaign then.
        on_full: OnFull::GoOn,
    };
    let described = RigRecord::of_emulated(&settings.name, &settings.rig, &settings.limits);
    let mut session = Session::create(settings, progress)?;
    session.describe(described);
    let (switches, _driving) = interrupt::driving()?;
    let mut devices = Devices::Emulated { plant: Box::new(truth.clone()) };
    let (scripts, known) = (builtin_scripts()?, Known::at_first(Knowledge::Nothing, LoopSettings::default()));
    session.run_all(&scripts, &vec![false; scripts.len()], &mut devices, known, switches, progress)?;
    session.finish()
}

/// The built-in experiments, in the order in which each needs the results of the one before.
pub fn builtin_scripts() -> Result<Vec<Script>, Failure> {
    let parse = |(file, text): &(&str, &str)| Script::parse(text, file).map_err(|e| Failure::of(Kind::Internal, &e));
    BUILTIN.iter().map(parse).collect()
}

/// The rig at the start of a run, prepared as the script asks; its noise is the run's own.
pub fn rig_for(truth: &ModelFile, script: &Script, seed: u64, run: usize) -> Result<EmulatedRig, Failure> {
    let effects = added_effects(truth).map_err(|e| Failure::of(Kind::Internal, &e))?;
    let settings = RigSettings { seed: seed_of_run(seed, run as u64), ..prepared(script) };
    EmulatedRig::new(&truth.parameters, effects, settings).map_err(|e| Failure::of(Kind::Device, &e))
}

/// The emulated rig's settings as the script wants it prepared.
pub(crate) fn prepared(script: &Script) -> RigSettings {
    let defaults = RigSettings::default();
    RigSettings {
        start: script.start(),
        fill_bar: script.fill_bar.unwrap_or(defaults.fill_bar),
        vertical: script.plane == Plane::Vertical,
        ..defaults
    }
}

/// Makes the rigs of a session over wires, each as [`rig_for`] makes it for the run of that number.
///
/// # Errors
/// An effect that the library does not know (2).
pub fn plant_factory(truth: ModelFile, seed: u64) -> Result<PlantFactory, Failure> {
    added_effects(&truth).map_err(|e| Failure::of(Kind::Input, &e))?;
    Ok(Box::new(move |preparation: &Preparation| {
        let Preparation { run, vertical, fill_bar, start } = *preparation;
        let effects = added_effects(&truth).expect("the same effects were there above");
        let seed = seed_of_run(seed, u64::from(run));
        EmulatedRig::new(
            &truth.parameters,
            effects,
            RigSettings { start, fill_bar, vertical, seed, ..RigSettings::default() },
        )
    }))
}

/// Seed of a run's noise. The golden ratio's multiples keep the seeds of neighbouring campaigns' runs apart.
fn seed_of_run(seed: u64, run: u64) -> u64 {
    seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(run)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_seed_draws_one_rig_and_many_seeds_draw_every_effect() {
        assert_eq!(draw(3, LIBRARY), draw(3, LIBRARY));
        let drawn: BTreeSet<String> = (0..400).map(|seed| draw(seed, LIBRARY).effect[0].id.clone()).collect();
        assert_eq!(drawn.len(), LIBRARY.len(), "{drawn:?}");
    }

    #[test]
    fn a_drawn_rig_is_a_model_that_its_file_gives_back() {
        for seed in 0..50 {
            let truth = draw(seed, LIBRARY);
            let read = ModelFile::parse(&truth.to_toml(), "truth.toml").expect("a valid model");
            assert_eq!(read, truth);
            added_effects(&truth).expect("the effect and all its parameters");
            let p = truth.parameters;
            let (l, a) = (p.losses, p.losses.a);
            assert!((l.l4 * a - (l.l1 * a * a + l.l2 * a + l.l3)).abs() < 1e-12, "losses are continuous");
            assert_eq!((p.load, p.capacity.a2), (Parameters::example().load, 0.0));
            assert_ne!(p.torque.m3, Parameters::example().torque.m3, "the rig is not the example");
        }
    }

    #[test]
    fn a_drawn_effect_is_within_its_bounds_and_not_nothing() {
        for seed in 0..400 {
            let drawn = &draw(seed, LIBRARY).effect[0];
            let header = model::effects::find(&drawn.id).expect("out of the library").header();
            for p in header.parameters {
                let value = drawn.parameters[p.name];
                assert!((p.lower..=p.upper).contains(&value), "{}: {} = {value}", drawn.id, p.name);
            }
            let size = header.parameters.iter().filter(|p| p.size).any(|p| drawn.parameters[p.name] != 0.0);
            assert!(size, "{} of seed {seed} does nothing", drawn.id);
        }
    }
}
