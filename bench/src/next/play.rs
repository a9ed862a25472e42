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

fn thinned(samples: &[Sample]) -> Recording {
    let mut r = Recording::default();
    let mut before: Option<&Sample> = None;
    for s in samples {
        let changed = before.is_none_or(|b| {
            b.voltage_v != s.voltage_v
                || b.segment != s.segment
                || b.brake_open() != s.brake_open()
                || b.bypass_open() != s.bypass_open()
        });
        before = Some(s);
        if !(changed || s.tick % EVERY_MS == 0 || s.volume_ml.is_finite()) {
            continue;
        }
        r.time_s.push(s.time_s());
        r.voltage_v.push(s.voltage_v);
        r.angle_deg.push(s.angle_deg);
        r.pressure1_bar.push(s.pressure1_bar);
        r.pressure2_bar.push(s.pressure2_bar);
        r.torque_nm.push(s.torque_nm);
        r.volume_ml.push(s.volume_ml);
        r.brake_open.push(s.brake_open());
        r.bypass_open.push(s.bypass_open());
        r.segment.push(i64::from(s.segment));
    }
    r
}
