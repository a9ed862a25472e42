//! What a diagnosis has found so far: the reference model, then with one effect, then with two.

use std::collections::BTreeSet;

use model::effects::Effect;

use super::Ranked;
use crate::colour::{Colour, colours};
use crate::fit::Fit;
use crate::misfit::{self, Part};
use crate::problem::Problem;

/// An effect that was added.
#[derive(Clone)]
pub(super) struct Name {
    pub effect: &'static dyn Effect,
    /// Among the candidates of its round.
    pub probability: f64,
    /// Sets of ids that explain the data as well.
    pub equivalent: Vec<String>,
    /// The run that would tell it from them, where there are any,
    pub next_experiment: Option<String>,
    /// and the candidates that it was compared with, best first.
    pub ranked: Vec<Ranked>,
}

impl Name {
    /// One that nothing else explains.
    pub fn without_rivals(effect: &'static dyn Effect) -> Self {
        Name { effect, probability: 1.0, equivalent: Vec::new(), next_experiment: None, ranked: Vec::new() }
    }

    /// The ranking that leads with it and with what explains the data as well.
    fn tie_first(&self) -> Vec<Ranked> {
        tie_first(self.effect.header().id, &self.equivalent, &self.ranked)
    }
}

/// Candidates with those of a tie first: `own` or a set with it, and those that are equivalent to it.
fn tie_first(own: &str, equivalent: &[String], ranked: &[Ranked]) -> Vec<Ranked> {
    let is_tied = |r: &Ranked| r.id.split('+').any(|id| id == own) || equivalent.contains(&r.id);
    let (tied, others): (Vec<Ranked>, Vec<Ranked>) = ranked.iter().cloned().partition(is_tied);
    tied.into_iter().chain(others).collect()
}

/// A model with what was added, fitted to the whole.
#[derive(Clone)]
pub(super) struct Step {
    pub fit: Fit,
    pub names: Vec<Name>,
    pub residual: Vec<Vec<f64>>,
    /// Residuals of folds that were left out.
    pub held_out: Vec<Vec<f64>>,
    /// Part of what the effects do that sits in runs which ask for other sizes: the largest of all.
    pub disagreement: f64,
    /// The library's score test was asked, and is not significant.
    pub silent: bool,
}

impl Step {
    /// Ids of what is named, whatever its rivals.
    pub fn ids(&self) -> BTreeSet<&'static str> {
        self.names.iter().map(|n| n.effect.header().id).collect()
    }

    /// The run that would tell a name from its rivals, where there are any: of the last name that has some.
    pub fn next_experiment(&self) -> Option<String> {
        self.tied().and_then(|name| name.next_experiment.clone())
    }

    /// The candidates of that name, it and its rivals first.
    pub fn ranking_of_tie(&self) -> Option<Vec<Ranked>> {
        self.tied().map(Name::tie_first)
    }

    fn tied(&self) -> Option<&Name> {
        self.names.iter().rev().find(|name| name.next_experiment.is_some())
    }
}

/// What was found so far.
pub(super) struct Found {
    /// The reference model, then with one effect, then with two.
    pub steps: Vec<Step>,
    /// Candidates of the first round.
    pub ranking: Vec<Ranked>,
    /// The noise: by channel, as the fit that leaves least shows it.
    pub colours: Vec<Colour>,
    /// Terms without a name that convince by themselves, once they were looked for.
    pub convincing: Option<Option<Step>>,
}

impl Found {
    pub fn last(&self) -> &Step {
        self.steps.last().unwrap_or_else(|| unreachable!("the reference model is a step"))
    }

    /// Goes on from a step. One that has dropped an earlier name stands in that one's place, and one of the same names in that of the
    /// step before.
    pub fn take(&mut self, step: Step) {
        let keeps = |before: &Step| {
            let ids: Vec<&str> = step.names.iter().map(|n| n.effect.header().id).collect();
            before.names.len() < ids.len() && before.names.iter().all(|n| ids.contains(&n.effect.header().id))
        };
        self.steps.retain(keeps);
        self.steps.push(step);
    }

    pub fn parts(&self, problem: &Problem, step: &Step) -> Vec<Part> {
        misfit::parts(problem, &step.residual, &self.colours)
    }

    /// Takes the noise of a better fit.
    pub fn learn(&mut self, problem: &Problem, residual: &[Vec<f64>]) {
        for (own, other) in self.colours.iter_mut().zip(colours(problem, residual)) {
            if other.at(0) < own.at(0) {
                *own = other;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ranking_leads_with_those_that_can_t_be_told_apart_whichever_round_they_are_of() {
        let ranked = |id: &str, probability: f64| Ranked { id: id.to_owned(), probability };
        let all = [ranked("pump_lag", 0.5), ranked("tilt", 0.3), ranked("backlash", 0.1), ranked("torque_cubic", 0.1)];
        let ids = |own: &str, equivalent: &[&str]| -> Vec<String> {
            let equivalent: Vec<String> = equivalent.iter().map(|id| (*id).to_owned()).collect();
            tie_first(own, &equivalent, &all).into_iter().map(|r| r.id).collect()
        };
        assert_eq!(ids("torque_cubic", &["tilt"]), ["tilt", "torque_cubic", "pump_lag", "backlash"]);
        assert_eq!(ids("pump_lag", &["tilt"]), ["pump_lag", "tilt", "backlash", "torque_cubic"]);
        let sets = [ranked("tilt", 0.6), ranked("pump_lag+end_stop", 0.4)];
        assert_eq!(tie_first("end_stop", &[], &sets)[0].id, "pump_lag+end_stop");
    }
}
