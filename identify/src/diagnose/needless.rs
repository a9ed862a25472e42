//! Names that another one makes needless.
//!
//! Where two effects act, the first round may name a third one that does a little of both. Once the true ones are there, the fit is as
//! good without it. And where the first name's fit was caught in a false minimum, a second one may only have helped it out: its size
//! then runs towards nothing, and what little chance lets it gain may be alike in all clusters.

use model::integrate::SimulationError;

use super::search::{Search, Step};
use super::{MATERIAL, PREFERRED};
use crate::colour::{Colour, colours};
use crate::fit::{Effort, Fit};
use crate::misfit;
use crate::problem::Problem;
use crate::refit::advantage;

impl Search<'_> {
    /// The step without the first of its names that it does not need, fitted to the whole; `None` where it needs all. `brief`: its fit
    /// to the brief runs.
    pub fn without_needless(&self, step: &Step, brief: &Fit) -> Result<Option<Step>, SimulationError> {
        for name in step.names.iter().filter(|_| step.names.len() > 1) {
            let id = name.effect.header().id;
            let Some(n) = brief.layout.effects.iter().position(|e| e.header().id == id) else { continue };
            let Some(less) = needless(&self.brief, brief, n)? else { continue };
            let effort = Effort { iterations: 30, tolerance: 1e-6, ..Effort::default() };
            let point = less.point;
            let Ok(fit) = crate::fit::fit(self.problem, &less.layout, point, effort) else { continue };
            let names = step.names.iter().filter(|other| other.effect.header().id != id).cloned().collect();
            (self.progress)(&format!("{id} is not needed"));
            return self.step(fit, names).map(Some);
        }
        Ok(None)
    }
}

/// The fit without its `n`-th effect, where it is as good, cluster by cluster, or where what that effect does would not matter.
fn needless(problem: &Problem, fit: &Fit, n: usize) -> Result<Option<Fit>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let with = problem.residuals(&fit.layout, &fit.point)?;
    let (layout, point) = fit.without(n);
    let effort = Effort { iterations: 15, tolerance: 1e-6, ..Effort::default() };
    let Ok(less) = crate::fit::fit(problem, &layout, point, effort) else { return Ok(None) };
    let left = problem.residuals(&less.layout, &less.point)?;
    let (_, worse) = advantage(&left, &with, &clusters, count);
    let does = does(problem, &with, &left, &colours(problem, &with));
    let of_cost = 1.0 - fit.cost / less.cost;
    tracing::info!(name = fit.layout.effects[n].header().id, worse, does, of_cost, "is the name needed");
    Ok((!is_needed(worse, does, of_cost)).then_some(less))
}

/// Share of the cost that matters: a tenth more of it is a third of a noise floor where the rest is noise, and more where it is not.
const OF_COST: f64 = 0.1;

/// A name without which the fit is `worse`, in standard errors by clusters, and that `does` so much, in noise floors, or takes away this share of the cost:
/// of a gross misfit that swings in free run the structured residual says little.
fn is_needed(worse: f64, does: f64, of_cost: f64) -> bool {
    worse >= PREFERRED && (does >= MATERIAL || of_cost >= OF_COST)
}

/// Structured residual (noise floors, of all runs and channels) that an effect takes away. `with`, `left`: residuals with it and without.
fn does(problem: &Problem, with: &[Vec<f64>], left: &[Vec<f64>], noise: &[Colour]) -> f64 {
    let total = |residuals: &[Vec<f64>]| misfit::total(&misfit::parts(problem, residuals, noise));
    (total(left) - total(with)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_needed_name_is_certain_and_matters() {
        assert!(is_needed(5.0, 0.3, 0.01));
        assert!(!is_needed(1.0, 0.3, 0.5), "chance may do as much");
        assert!(!is_needed(8.0, 0.001, 0.001), "chance may do as little everywhere");
        assert!(is_needed(3.2, 0.0, 0.18), "a gross misfit that swings");
        assert!(!is_needed(-2.0, 0.0, -0.1));
    }
}
