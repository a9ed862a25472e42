//! The identified model as a file that simulates the same.

use model::ModelFile;
use model::effects::LIBRARY;
use model::parameters::AddedEffect;
use recordings::Role;

use crate::diagnose::{Diagnosis, Verdict};
use crate::fit::Fit;
use crate::identification::{Identified, Loaded};
use crate::uncertainty::Uncertainty;

/// The fit that `model.toml` holds: with the effects of an attributed diagnosis, else the reference model's own. Terms without
/// a name and effects that could as well be others have no place in a model file, and without them the base values that were
/// fitted beside them would simulate nothing well.
pub fn declared_fit<'a>(identified: &'a Identified, diagnosis: Option<&'a Diagnosis>) -> &'a Fit {
    match diagnosis {
        Some(d) if d.verdict == Verdict::Attributed => &d.after,
        _ => &identified.fit,
    }
}

/// `model.toml` of a fit.
pub fn model_file(
    loaded: &Loaded,
    identified: &Identified,
    verdict: Option<Verdict>,
    fit: &Fit,
    uncertainty: &Uncertainty,
) -> ModelFile {
    let mut file = ModelFile::plain(fit.layout.parameters(&fit.point.theta));
    file.std = uncertainty.determined().into_iter().map(|(_, name, std)| (name.to_string(), std)).collect();
    for (n, effect) in fit.layout.effects.iter().enumerate() {
        let header = effect.header();
        if !LIBRARY.iter().any(|e| e.header().id == header.id) {
            continue;
        }
        let first = fit.layout.first_of(n);
        let values =
            header.parameters.iter().enumerate().map(|(i, p)| (p.name.to_string(), fit.point.theta[first + i]));
        file.effect.push(AddedEffect { id: header.id.to_string(), parameters: values.collect() });
    }
    let files = |role: Role| {
        let named: Vec<&str> =
            loaded.runs.iter().filter(|r| r.entry.role == role).map(|r| r.entry.file.as_str()).collect();
        named.join(", ")
    };
    let source = &mut file.source;
    source.insert("campaign".into(), loaded.campaign.name.clone());
    source.insert("fitted_runs".into(), files(Role::Identify));
    source.insert("validated_runs".into(), files(Role::Validate));
    source.insert("given".into(), "J, G, u_max (campaign.toml); a2 = 0 (fixed: not separable from h1, h3)".into());
    if let Some(verdict) = verdict {
        source.insert("verdict".into(), verdict.as_str().into());
    }
    if !identified.undetermined.is_empty() {
        let reasons: Vec<String> =
            identified.undetermined.iter().map(|(name, why)| format!("{name} (not identified: {why})")).collect();
        source.insert("not_determined".into(), reasons.join("; "));
    }
    file
}
