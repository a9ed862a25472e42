//! Which effects the data can't tell from one that was added: by the angle between their sensitivities, and by a refit of the one in
//! the place of the other.

use model::effects::Effect;
use model::integrate::SimulationError;

use crate::fit::{Effort, Fit, fit};
use crate::problem::{Point, Problem};
use crate::refit::{Bases, refit};
use crate::score::{Direction, Scene, dot};

/// A stand-in explains at least this share of what the effect itself does. Of sensitivities, that is the squared cosine.
const AS_MUCH: f64 = 0.95;
/// Below this squared cosine a refit could not make it up.
const RELATED: f64 = 0.5;

/// Another effect beside one that was added.
#[derive(Clone, Debug)]
pub struct Relative {
    /// The other effect.
    pub effect: &'static dyn Effect,
    /// Cosine between what both do to the predictions, orthogonal to everything else that is fitted, in a model with neither.
    pub cosine: f64,
    /// Share of what the added effect explains that this one explains in its place, all refitted; `None` where the model carries it
    /// as well, or where the angle rules it out.
    pub share: Option<f64>,
}

impl Relative {
    /// The data can't tell it from the effect that was added, or hardly: the sensitivities are as good as parallel, or a refit
    /// in its place explains as much.
    pub fn is_equivalent(&self) -> bool {
        self.cosine * self.cosine >= AS_MUCH || self.share.is_some_and(|s| s >= AS_MUCH)
    }
}

/// Compares every effect of `library` with the model's `n`-th. Those that can't be simulated or do nothing are left out.
///
/// # Errors
/// The model without the effect can't be simulated.
pub fn relatives(
    problem: &Problem,
    full: &Fit,
    n: usize,
    library: &[&'static dyn Effect],
) -> Result<Vec<Relative>, SimulationError> {
    let effort = Effort { iterations: 15, tolerance: 1e-6, ..Effort::default() };
    let own = full.layout.effects[n];
    let single = without(problem, full, &[n], effort)?;
    let mut out = Vec::new();
    for effect in library.iter().copied().filter(|e| e.header().id != own.header().id) {
        let carried = full.layout.effects.iter().position(|c| c.header().id == effect.header().id);
        let neither;
        let base = match carried {
            Some(other) => {
                neither = without(problem, full, &[n, other], effort)?;
                &neither
            }
            None => &single,
        };
        let scene = Scene::new(problem, base)?;
        let (first, others) = (best(&scene, own), best(&scene, effect));
        let (Some(first), Some(second)) = (first.first(), others.first()) else { continue };
        let cosine = dot(&first.secant, &second.secant) / (first.square * second.square).sqrt();
        let share = if carried.is_none() && cosine * cosine >= RELATED {
            let component = full.point.theta[..full.layout.base.len()].to_vec();
            let bases = Bases {
                scene: &scene,
                component: &component,
                short: problem,
                guided: None,
                beside: f64::INFINITY,
                gross: false,
            };
            refit(problem, &bases, &[(effect, others.iter().collect())], effort)
                .map(|r| (single.cost - r.fit.cost) / (single.cost - full.cost).max(f64::MIN_POSITIVE))
        } else {
            None
        };
        out.push(Relative { effect, cosine, share });
    }
    Ok(out)
}

/// Directions of an effect that would reduce the cost, the best first.
pub(crate) fn best(scene: &Scene, effect: &'static dyn Effect) -> Vec<Direction> {
    let mut out: Vec<Direction> = scene.directions(effect).into_iter().filter(|d| d.gain() > 0.0).collect();
    out.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    out
}

/// The model without these of its effects, refitted.
pub(crate) fn without(problem: &Problem, full: &Fit, gone: &[usize], effort: Effort) -> Result<Fit, SimulationError> {
    let entries = |n: usize| {
        let first = full.layout.first_of(n);
        first..first + full.layout.effects[n].header().parameters.len()
    };
    let left: Vec<usize> = (0..full.layout.len()).filter(|i| !gone.iter().any(|&n| entries(n).contains(i))).collect();
    let mut layout = full.layout.clone();
    layout.effects =
        (0..full.layout.effects.len()).filter(|n| !gone.contains(n)).map(|n| full.layout.effects[n]).collect();
    layout.held = left.iter().enumerate().filter(|(_, i)| full.layout.held.contains(i)).map(|(at, _)| at).collect();
    let theta = left.iter().map(|&i| full.point.theta[i]).collect();
    fit(problem, &layout, Point { theta, initial: full.point.initial.clone() }, effort)
}
