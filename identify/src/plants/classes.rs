//! What of a diagnosis on a table is claimed: what beats the surrogates of everything it was chosen from, and the class of names that explain the data as well.

use model::effects::Effect;
use model::integrate::SimulationError;

use crate::diagnose::{Added, Diagnosis, Verdict};
use crate::equivalence::{best, relatives, without};
use crate::fit::{Effort, Fit};
use crate::misfit;
use crate::problem::Problem;
use crate::refit::{Bases, advantage, refit};
use crate::score::{Direction, Scene};
use crate::simplify::uncertainty_of_simplified;
use crate::surrogate::p_of_selected;

/// Level at which an added effect must beat the surrogates of everything that it was chosen from.
const LEVEL: f64 = 0.01;

/// Standard errors (by clusters) by which a model that carries more of a class must be better.
const BETTER: f64 = 3.0;

/// Carries beside a found effect those that look like it and that the data ask for as well. The class is what is claimed, so a
/// further member claims nothing new; a prediction beyond the amplitudes of the fit needs it all the same.
pub(super) fn complete_classes(
    problem: &Problem,
    diagnosis: &mut Diagnosis,
    library: &[&'static dyn Effect],
) -> Result<(), SimulationError> {
    let effort = Effort { iterations: 15, tolerance: 1e-6, ..Effort::default() };
    let (clusters, count) = crate::score::clusters(problem);
    for n in 0..diagnosis.effects.len() {
        let id = diagnosis.effects[n].effect.header().id;
        let Some(at) = diagnosis.after.layout.effects.iter().position(|e| e.header().id == id) else { continue };
        let alike = relatives(problem, &diagnosis.after, at, library)?;
        for other in alike.into_iter().filter(|r| r.is_equivalent()).map(|r| r.effect) {
            let current = &diagnosis.after;
            if current.layout.effects.iter().any(|e| e.header().id == other.header().id) {
                continue;
            }
            let scene = Scene::new(problem, current)?;
            let directions = best(&scene, other);
            let component = current.point.theta[..current.layout.base.len()].to_vec();
            let bases = Bases {
                scene: &scene,
                component: &component,
                short: problem,
                guided: None,
                beside: f64::INFINITY,
                gross: false,
            };
            let Some(both) = refit(problem, &bases, &[(other, directions.iter().collect())], effort) else { continue };
            let before = problem.residuals(&current.layout, &current.point)?;
            let after = problem.residuals(&both.fit.layout, &both.fit.point)?;
            let (_, better) = advantage(&before, &after, &clusters, count);
            tracing::info!(of = id, with = other.header().id, better, "class");
            if better >= BETTER {
                diagnosis.after = both.fit;
                let equivalent = Vec::new();
                diagnosis.effects.push(Added {
                    effect: other,
                    probability: diagnosis.effects[n].probability,
                    equivalent,
                    values: Vec::new(),
                    known: Vec::new(),
                });
            }
        }
    }
    Ok(())
}

/// Takes out what explains no more than surrogates of the library do, the last that was added first, and completes what follows.
pub(super) fn keep_what_beats_surrogates(
    problem: &Problem,
    diagnosis: &mut Diagnosis,
    library: &[&'static dyn Effect],
) -> Result<(), SimulationError> {
    let effort = Effort { iterations: 15, tolerance: 1e-6, ..Effort::default() };
    for n in (0..diagnosis.after.layout.effects.len()).rev() {
        let single = without(problem, &diagnosis.after, &[n], effort)?;
        let scene = Scene::new(problem, &single)?;
        let own = diagnosis.after.layout.effects[n];
        let open = library.iter().filter(|e| !single.layout.effects.iter().any(|c| c.header().id == e.header().id));
        let all: Vec<Direction> = open.filter_map(|e| best(&scene, *e).into_iter().next()).collect();
        let tested = all.iter().find(|d| d.effect.header().id == own.header().id);
        let p = tested.map_or(1.0, |d| p_of_selected(&scene, d, &all.iter().collect::<Vec<_>>(), n as u64));
        tracing::info!(id = own.header().id, p, "against surrogates");
        if p > LEVEL {
            diagnosis.after = single;
            diagnosis.effects.retain(|a| a.effect.header().id != own.header().id);
        }
    }
    let residual = problem.residuals(&diagnosis.after.layout, &diagnosis.after.point)?;
    diagnosis.parts_after = misfit::parts(problem, &residual, &crate::colour::colours(problem, &residual));
    let total = misfit::total(&diagnosis.parts_before);
    if !diagnosis.effects.is_empty() && total > 0.0 {
        diagnosis.explained = 1.0 - misfit::total(&diagnosis.parts_after) / total;
    }
    let uncertainty = uncertainty_of_simplified(problem, &diagnosis.after)?;
    let layout = &diagnosis.after.layout;
    for a in &mut diagnosis.effects {
        let id = a.effect.header().id;
        if let Some(n) = layout.effects.iter().position(|e| e.header().id == id) {
            let own = layout.first_of(n)..layout.first_of(n) + a.effect.header().parameters.len();
            a.values = diagnosis.after.point.theta[own.clone()].to_vec();
            a.known = own.map(|i| uncertainty.known(i)).collect();
        }
    }
    Ok(())
}

/// Ids of the library that explain the data as well in the place of an added effect.
pub(super) fn equivalents(
    problem: &Problem,
    after: &Fit,
    added: &Added,
    library: &[&'static dyn Effect],
) -> Result<Vec<String>, SimulationError> {
    let id = added.effect.header().id;
    let Some(n) = after.layout.effects.iter().position(|e| e.header().id == id) else { return Ok(Vec::new()) };
    let others = relatives(problem, after, n, library)?;
    for r in &others {
        tracing::info!(of = id, by = r.effect.header().id, cosine = r.cosine, share = r.share, "relative");
    }
    Ok(others.iter().filter(|r| r.is_equivalent()).map(|r| r.effect.header().id.to_string()).collect())
}

/// Ambiguous where no effect of what was added is known for itself; a class beside a known effect is said with that effect.
pub(super) fn verdict(diagnosis: &Diagnosis) -> Verdict {
    match (&diagnosis.effects[..], diagnosis.effects.iter().any(|a| a.equivalent.is_empty())) {
        ([], _) => Verdict::None,
        (_, true) => Verdict::Attributed,
        (_, false) => Verdict::Ambiguous,
    }
}
