//! What a run would record, if a fitted model were the rig.

use crate::dry_run::{Prediction, predict_samples};
use crate::failure::Failure;
use crate::rig_file::Rig;
use identify::design::Rival;
use model::ModelFile;
use model::parameters::AddedEffect;
use profiles::Script;
use recordings::Recording;
use rt_core::Sample;

/// Time between two rows that are kept, ms; rows where an input changes are kept too. The lever swings at some 10 Hz.
const EVERY_MS: u64 = 4;

/// The rival as a plant.
pub fn as_plant(rival: &Rival) -> ModelFile {
    let fit = &rival.fit;
    let mut file = ModelFile::plain(fit.layout.parameters(&fit.point.theta));
    for (n, effect) in fit.layout.effects.iter().enumerate() {
        let header = effect.header();
        let first = fit.layout.first_of(n);
        let values = header.parameters.iter().enumerate().map(|(i, p)| (p.name.to_owned(), fit.point.theta[first + i]));
        file.effect.push(AddedEffect { id: header.id.to_owned(), parameters: values.collect() });
    }
    file
}

/// The dry run of a script on a rival, and what it would record, without noise.
///
/// # Errors
/// Those of a dry run.
pub fn play(script: &Script, rig: &Rig, plant: &ModelFile, seed: u64) -> Result<(Prediction, Recording), Failure> {
    let (prediction, samples) = predict_samples(script, rig, plant, seed)?;
    Ok((prediction, thinned(&samples)))
}

/// A row each so many milliseconds, and wherever an input changes or the cylinder is read.
fn thinned(samples: &[Sample]) -> Recording {
    let mut before: Option<&Sample> = None;
    let kept = samples.iter().filter(|s| {
        let changed = before.is_none_or(|b| {
            b.voltage_v != s.voltage_v
                || b.segment != s.segment
                || b.brake_open() != s.brake_open()
                || b.bypass_open() != s.bypass_open()
        });
        before = Some(s);
        changed || s.tick % EVERY_MS == 0 || s.volume_ml.is_finite()
    });
    Recording::of_samples(kept)
}
