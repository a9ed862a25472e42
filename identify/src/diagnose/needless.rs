//! Names that another one makes needless.
//!
//! Where two effects act, the first round may name a third one that does a little of both. Once the true ones are there, the fit is as
//! good without it. And where the first name's fit was caught in a false minimum, a second one may only have helped it out: its size
//! then runs towards nothing, and what little chance lets it gain may be alike in all clusters.

use model::integrate::SimulationError;

use super::found::Step;
use super::search::Search;
use super::{MATERIAL, PREFERRED};
use crate::colour::{Colour, colours};
use crate::fit::{Effort, Fit};
use crate::misfit;
use crate::problem::Problem;
use crate::refit::advantage;

impl Search<'_> {
    /// The step without the first of its names that it does not need, neither on the brief runs nor on the whole ones, where an effect that acts now and
    /// then (a valve's lag, when it switches) shows far more often; fitted to the whole. `None` where it needs all. `brief`: its fit to the brief runs.
    pub fn without_needless(&self, step: &Step, brief: &Fit) -> Result<Option<Step>, SimulationError> {
        let on_brief = self.brief.residuals(&brief.layout, &brief.point)?;
        for name in step.names.iter().filter(|_| step.names.len() > 1) {
            let id = name.effect.header().id;
            let Some(n) = brief.layout.effects.iter().position(|e| e.header().id == id) else { continue };
            let (layout, point) = brief.without(n);
            let effort = Effort { iterations: 15, tolerance: 1e-6, ..Effort::default() };
            let Ok(less) = crate::fit::fit(&self.brief, &layout, point, effort) else { continue };
            let left = self.brief.residuals(&less.layout, &less.point)?;
            if needs(&self.brief, id, (brief.cost, &on_brief), (less.cost, &left)) {
                continue;
            }
            let effort = Effort { iterations: 30, tolerance: 1e-6, ..Effort::default() };
            let Ok(fit) = crate::fit::fit(self.problem, &less.layout, less.point, effort) else { continue };
            let names = step.names.iter().filter(|other| other.effect.header().id != id).cloned().collect();
            let lean = self.step(fit, names)?;
            if needs(self.problem, id, (step.fit.cost, &step.residual), (lean.fit.cost, &lean.residual)) {
                continue;
            }
            (self.progress)(&format!("{id} is not needed"));
            return Ok(Some(lean));
        }
        Ok(None)
    }
}

/// Whether a fit needs a name: its cost and residuals with it and without.
fn needs(problem: &Problem, name: &str, with: (f64, &[Vec<f64>]), without: (f64, &[Vec<f64>])) -> bool {
    let (clusters, count) = crate::score::clusters(problem);
    let (_, worse) = advantage(without.1, with.1, &clusters, count);
    let does = does(problem, with.1, without.1, &colours(problem, with.1));
    let of_cost = 1.0 - with.0 / without.0;
    tracing::info!(name, worse, does, of_cost, "is the name needed");
    is_needed(worse, does, of_cost)
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
    use crate::common::{layout, problem, run};
    use crate::diagnose::Declared;
    use crate::diagnose::found::Name;
    use model::Parameters;
    use model::effects::{Effect, find};

    /// Ids that a step with creep and a lag of the brake valve is left with, of runs of a rig with these effects; the brief runs end after one
    /// switch of that valve.
    fn left_of_creep_and_lag(acting: Vec<(&'static dyn Effect, Vec<f64>)>) -> Vec<&'static str> {
        let truth = Parameters::example();
        let runs = [7, 8, 9].map(|seed| run(&truth, acting.clone(), 20.0, seed));
        let (problem, plain) = (problem(&runs), layout(&truth));
        let component = plain.vector_of(&truth);
        let bare = fit_of(&problem, &plain, problem.point(component.clone()));
        let named = ["wall_creep", "brake_valve_lag"].map(|id| find(id).unwrap());
        let both = plain.with(named[0]).with(named[1]);
        let point = problem.point([component.clone(), vec![0.5, 1.5, 0.01, 0.01]].concat());
        let fit = fit_of(&problem, &both, point);
        let base = Declared { problem: &problem, fit: &bare, component: &component };
        let mut search = Search::new(&[], &base, &|_| ());
        search.brief = problem.shortened(8.0);
        let brief = search.nested(&fit).unwrap();
        let step = search.step(fit, named.map(Name::without_rivals).to_vec()).unwrap();
        let left = search.without_needless(&step, &brief).unwrap().unwrap_or(step);
        left.ids().into_iter().collect()
    }

    fn fit_of(problem: &Problem, layout: &crate::layout::Layout, point: crate::problem::Point) -> Fit {
        crate::fit::fit(problem, layout, point, Effort::default()).unwrap()
    }

    #[test]
    fn what_acts_now_and_then_is_needed_where_the_whole_runs_need_it() {
        let creep = || (find("wall_creep").unwrap(), vec![0.6, 1.3]);
        assert_eq!(left_of_creep_and_lag(vec![creep()]), ["wall_creep"]);
        let lag = (find("brake_valve_lag").unwrap(), vec![0.0, 0.02]);
        assert_eq!(left_of_creep_and_lag(vec![creep(), lag]), ["brake_valve_lag", "wall_creep"]);
    }

    #[test]
    fn a_needed_name_is_certain_and_matters() {
        assert!(is_needed(5.0, 0.3, 0.01));
        assert!(!is_needed(1.0, 0.3, 0.5), "chance may do as much");
        assert!(!is_needed(8.0, 0.001, 0.001), "chance may do as little everywhere");
        assert!(is_needed(3.2, 0.0, 0.18), "a gross misfit that swings");
        assert!(!is_needed(-2.0, 0.0, -0.1));
    }
}
