//! From what was found to the verdict.

use model::effects::{Balance, Effect};
use model::integrate::SimulationError;

use super::compare::empirical;
use super::round::Round;
use super::search::{Found, Search, Step};
use super::{
    Added, CLEAR, CONSISTENT, DISAGREE, Diagnosis, EXPLAINED, LEVEL, MATERIAL, PREFERRED, SUBSTANTIAL, Verdict,
};
use crate::fit::Fit;
use crate::misfit::{self, Part};
use crate::problem::Problem;
use crate::refit::advantage;
use crate::simplify::simplify;
use crate::uncertainty::Uncertainty;

impl Search<'_> {
    /// What a step leaves, as the data that were left out of its fit show it.
    fn left(&self, found: &Found, step: &Step) -> Vec<Part> {
        misfit::parts(self.problem, &step.held_out, &found.colours)
    }

    /// The names of a step are the explanation.
    ///
    /// Either what they leave is noise. Or the last of them explains the overwhelming share of what was there before it, does
    /// a substantial part of the whole, and every run asks for the same size of it: then the rest is a matter of its
    /// form. Names that each explain part of a misfit which stays are none.
    pub fn explains(&self, found: &Found, number: usize) -> bool {
        let step = &found.steps[number];
        let total = |n: usize| misfit::total(&self.left(found, &found.steps[n]));
        let left = misfit::largest(&self.left(found, step));
        let (first, before, after) = (total(0), total(number - 1), total(number));
        let share = if before > 0.0 { 1.0 - after / before } else { 1.0 };
        let of_whole = if first > 0.0 { (before - after) / first } else { 1.0 };
        let names: Vec<&str> = step.names.iter().map(|n| n.effect.header().id).collect();
        tracing::info!(?names, left, share, of_whole, step.disagreement, "what the names leave");
        let substantial = number == 1 || of_whole >= SUBSTANTIAL;
        substantial && (left < CONSISTENT || (share >= EXPLAINED && step.disagreement <= DISAGREE))
    }

    /// The verdict.
    pub fn conclude(&self, mut found: Found, first: &Round) -> Result<Diagnosis, SimulationError> {
        let chosen = (1..found.steps.len()).rev().find(|&n| self.explains(&found, n));
        let named = found.steps.len() > 1;
        let problem = self.problem;
        let before = found.steps[0].clone();
        let parts_before = found.parts(problem, &before);
        let ranking = std::mem::take(&mut found.ranking);
        if let Some(n) = chosen {
            let step = found.steps[n].clone();
            let tie = found.steps[1..=n].iter().any(|s| s.next_experiment.is_some());
            let next_experiment = found.steps[1..=n].iter().rev().find_map(|s| s.next_experiment.clone());
            let after = simplify(problem, step.fit.clone())?;
            let residual = problem.residuals(&after.layout, &after.point)?;
            let parts_after = misfit::parts(problem, &residual, &found.colours);
            let open = self.open(&after);
            let nested = self.nested(&after)?;
            let last = Round::new(&self.brief, &nested, open.into_iter())?;
            let mut effects: Vec<Added> = step
                .names
                .iter()
                .map(|n| Added {
                    effect: n.effect,
                    probability: n.probability,
                    equivalent: n.equivalent.clone(),
                    values: Vec::new(),
                    std: Vec::new(),
                })
                .collect();
            fill_values(problem, &after, &mut effects)?;
            return Ok(Diagnosis {
                verdict: if tie { Verdict::Ambiguous } else { Verdict::Attributed },
                balances: balance_p_values(first, Some(&last), &effects),
                explained: explained_share(&parts_before, &parts_after),
                effects,
                ranking,
                after,
                parts_before,
                parts_after,
                next_experiment,
            });
        }
        let largest = misfit::largest(&parts_before);
        if largest >= MATERIAL && let Some((effect, fit)) = self.nameless(&mut found, named || largest > CLEAR)? {
            let residual = problem.residuals(&fit.layout, &fit.point)?;
            let parts_after = misfit::parts(problem, &residual, &found.colours);
            let mut effects =
                vec![Added { effect, probability: 1.0, equivalent: Vec::new(), values: Vec::new(), std: Vec::new() }];
            fill_values(problem, &fit, &mut effects)?;
            return Ok(Diagnosis {
                verdict: Verdict::Unrecognised,
                balances: balance_p_values(first, None, &effects),
                explained: explained_share(&parts_before, &parts_after),
                effects,
                ranking,
                after: fit,
                parts_before,
                parts_after,
                next_experiment: None,
            });
        }
        Ok(Diagnosis {
            verdict: Verdict::None,
            effects: Vec::new(),
            ranking,
            balances: balance_p_values(first, None, &[]),
            after: before.fit,
            parts_after: parts_before.clone(),
            parts_before,
            explained: 1.0,
            next_experiment: None,
        })
    }

    /// The nameless term of the balance that explains most, where there is something to explain. `certain`: there is, whether a
    /// term explains it or not. Otherwise the terms' score test, its size, and the data that were left out must agree.
    fn nameless(
        &self,
        found: &mut Found,
        certain: bool,
    ) -> Result<Option<(&'static dyn Effect, Fit)>, SimulationError> {
        let reference = found.steps[0].clone();
        let nested = self.nested(&reference.fit)?;
        let round = Round::new(&self.brief, &nested, model::effects::empirical::EMPIRICAL.iter().copied())?;
        let p = round.p_value(|_| true);
        tracing::info!(p, certain, "nameless terms");
        if p > LEVEL && !certain {
            return Ok(None);
        }
        let Some((effect, fit)) = empirical(self, &nested, &round)? else { return Ok(None) };
        let step = self.step(fit, Vec::new(), None)?;
        found.learn(self.problem, &step.residual);
        let before = self.left(found, &reference);
        let after = self.left(found, &step);
        let share = explained_share(&before, &after);
        let (held, better) = advantage(&reference.held_out, &step.held_out, &self.clusters, self.count);
        tracing::info!(balance = effect.header().balance.as_str(), share, held, better, "nameless term");
        let convincing = held > 0.0 && better > PREFERRED && share > 0.0;
        Ok((certain || convincing).then_some((effect, step.fit)))
    }
}

/// 1 - structured residual after / before, over the parts that decide.
fn explained_share(before: &[Part], after: &[Part]) -> f64 {
    let total = misfit::total(before);
    if total > 0.0 { 1.0 - misfit::total(after) / total } else { 1.0 }
}

/// p-value by balance: of a balance in which something was added, under the declared model; of the others, with that added,
/// so that one effect does not light up every balance.
fn balance_p_values(first: &Round, last: Option<&Round>, added: &[Added]) -> Vec<(Balance, f64)> {
    Balance::ALL
        .into_iter()
        .map(|b| {
            let own = added.iter().any(|a| a.effect.header().balance == b);
            let round = if own { first } else { last.unwrap_or(first) };
            (b, round.p_value(|d| d.effect.header().balance == b))
        })
        .collect()
}

/// Values and standard errors of what was added, from the final fit.
fn fill_values(problem: &Problem, fit: &Fit, added: &mut [Added]) -> Result<(), SimulationError> {
    if added.is_empty() {
        return Ok(());
    }
    let uncertainty = Uncertainty::of(problem, fit)?;
    let std: Vec<f64> = (0..fit.layout.len()).map(|i| uncertainty.of_entry(i)).collect();
    for a in added {
        let id = a.effect.header().id;
        if let Some(n) = fit.layout.effects.iter().position(|e| e.header().id == id) {
            let range = fit.layout.first_of(n)..fit.layout.first_of(n) + a.effect.header().parameters.len();
            a.values = fit.point.theta[range.clone()].to_vec();
            a.std = std[range].to_vec();
        }
    }
    Ok(())
}
