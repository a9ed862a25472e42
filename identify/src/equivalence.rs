//! Which effects could stand in for one that was added: refitted in its place, beside everything else that the model carries.

use model::effects::Effect;
use model::integrate::SimulationError;

use crate::fit::{Effort, Fit, fit};
use crate::problem::{Point, Problem};
use crate::refit::{Bases, refit};
use crate::score::{Direction, Scene};

/// A stand-in explains at least this share of what the effect itself does.
const AS_MUCH: f64 = 0.95;

/// Another effect in the place of one that was added.
#[derive(Clone, Debug)]
pub struct Substitute {
    /// The other effect.
    pub effect: &'static dyn Effect,
    /// Share of what the added effect explains that this one explains in its place.
    pub share: f64,
    /// The fit with it.
    pub fit: Fit,
}

impl Substitute {
    /// The data can't tell it from the effect that was added.
    pub fn is_equivalent(&self) -> bool {
        self.share >= AS_MUCH
    }
}

/// Refits every effect of `library` that the model does not carry in the place of its `n`-th; the best first. Those that can't be
/// simulated or do nothing are left out.
///
/// # Errors
/// The model without the effect can't be simulated.
pub fn substitutes(
    problem: &Problem,
    full: &Fit,
    n: usize,
    library: &[&'static dyn Effect],
) -> Result<Vec<Substitute>, SimulationError> {
    let effort = Effort { iterations: 15, tolerance: 1e-6, ..Effort::default() };
    let without = without(problem, full, n, effort)?;
    let explained = without.cost - full.cost;
    let scene = Scene::new(problem, &without)?;
    let component = full.layout.base.iter().zip(&full.point.theta).map(|(_, v)| *v).collect::<Vec<f64>>();
    let bases = Bases { current: &without, component: &component, short: problem, gross: false };
    let carried = |e: &dyn Effect| full.layout.effects.iter().any(|c| c.header().id == e.header().id);
    let mut out = Vec::new();
    for effect in library.iter().copied().filter(|e| !carried(*e)) {
        let mut directions = scene.directions(effect);
        directions.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        let usable: Vec<&Direction> = directions.iter().filter(|d| d.gain() > 0.0).collect();
        if usable.is_empty() {
            continue;
        }
        if let Some(r) = refit(problem, &bases, &[(effect, usable)], effort) {
            let share = if explained > 0.0 { (without.cost - r.fit.cost) / explained } else { 0.0 };
            out.push(Substitute { effect, share, fit: r.fit });
        }
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    Ok(out)
}

/// The model without its `n`-th effect, refitted.
fn without(problem: &Problem, full: &Fit, n: usize, effort: Effort) -> Result<Fit, SimulationError> {
    let own = full.layout.first_of(n)..full.layout.first_of(n) + full.layout.effects[n].header().parameters.len();
    let mut layout = full.layout.clone();
    layout.effects.remove(n);
    layout.held = full
        .layout
        .held
        .iter()
        .filter(|h| !own.contains(h))
        .map(|&h| if h >= own.end { h - own.len() } else { h })
        .collect();
    let mut theta = full.point.theta.clone();
    theta.drain(own);
    fit(problem, &layout, Point { theta, initial: full.point.initial.clone() }, effort)
}
