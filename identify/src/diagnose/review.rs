//! A name, seen again beside another one.
//!
//! The first round sees what both effects do together, and may name one that does a little of both, or find two that do as well. Beside
//! the second name its candidates are compared once more: each for what the second leaves. Where one round names two at once, neither
//! was compared beside the other, so both are seen again.

use model::integrate::SimulationError;

use super::PREFERRED;
use super::compare::{joined, look_alikes, rank, rivals, where_they_differ};
use super::found::{Found, Name, Step};
use super::refits::{is_all_but_noise, is_nearly_all, matters_beside, refit_all, to_the_end};
use super::round::Round;
use super::search::{Search, is_gross};
use crate::fit::{Effort, Fit};
use crate::refit::{Refit, advantage};

impl Search<'_> {
    /// The step with these of its two names as the comparison beside the other leaves each: with other rivals or none, or replaced by one
    /// that does better. `brief`: the step's fit to the brief runs. A step with other than two names stays as it is.
    pub fn reviewed(
        &self,
        found: &mut Found,
        step: Step,
        brief: Fit,
        ids: &[&'static str],
    ) -> Result<Step, SimulationError> {
        let mut seen = (step, brief);
        for id in ids {
            seen = self.seen_again(found, seen, id)?;
        }
        Ok(seen.0)
    }

    /// [`Search::reviewed`] for one name, with the fit to the brief runs that goes with the step.
    fn seen_again(
        &self,
        found: &mut Found,
        (step, brief): (Step, Fit),
        own: &'static str,
    ) -> Result<(Step, Fit), SimulationError> {
        let [one, two] = &step.names[..] else { return Ok((step, brief)) };
        let (first, second) = if one.effect.header().id == own { (one, two) } else { (two, one) };
        let Some(n) = brief.layout.effects.iter().position(|e| e.header().id == own) else { return Ok((step, brief)) };
        let (layout, point) = brief.without(n);
        let effort = Effort { iterations: 12, tolerance: 1e-6, ..Effort::default() };
        let Ok(alone) = crate::fit::fit(&self.brief, &layout, point, effort) else { return Ok((step, brief)) };
        // beside a name that explains all of it only what looks like it matters, and nobody need be led to that
        let explained = is_nearly_all(&self.brief, alone.cost, brief.cost);
        let misfit_is_gross = is_gross(&self.brief, &alone, &found.colours)?;
        let gross = !explained && misfit_is_gross;
        let open = self.open(&alone);
        let round = Round::new(&self.brief, &alone, open.iter().copied())?;
        let guided = if gross { round.guided(self) } else { None };
        let under = guided.map(|_| round.under_guide(self)).transpose()?.flatten();
        if self.is_unexplained(found, found.last(), &step) && under.is_some_and(|under| under.leads_nobody()) {
            tracing::info!(own, beside = second.effect.header().id, "nobody leads beside a name that does not explain");
            return Ok((step, brief));
        }
        let bases = self.bases(&round, guided, gross);
        let mut shortlist = self.shortlist(&round, &open, &bases)?;
        shortlist.retain(|set| set.len() == 1 && set[0].header().id != own);
        if misfit_is_gross && is_all_but_noise(&self.brief, alone.cost, brief.cost) {
            shortlist.retain(|set| matters_beside(&round, own, set, alone.cost));
        }
        let mut refits = refit_all(&self.brief, &bases, &round, &shortlist, Some(&brief), self.progress);
        refits.push(Refit { added: vec![own], fit: brief.clone(), led: None });
        refits.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
        let alike = look_alikes(&round, &refits, &open);
        if !alike.is_empty() {
            let more = refit_all(&self.brief, &bases, &round, &alike, Some(&brief), self.progress);
            refits = joined(refits, more);
        }
        let others = rivals(&self.brief, &refits, alone.cost)?;
        let best = &refits[0];
        tracing::info!(own, beside = second.effect.header().id, best = ?best.added, rivals = others.len(), "seen again");
        let ranked = rank(&self.brief, &refits)?;
        let probability = |id: &str| ranked.iter().find(|r| r.id == id).map_or(0.0, |r| r.probability);
        let next = |a: &Fit, others: &[&Refit]| match others.first() {
            Some(b) => where_they_differ(&self.brief, a, &b.fit).map(Some),
            None => Ok(None),
        };
        // the whole set of those that can't be told apart, without the one that is named
        let beside = |id: &str| -> Vec<&Refit> {
            std::iter::once(best).chain(&others).filter(|r| !r.added.contains(&id)).collect()
        };
        let equivalent = |set: &[&Refit]| set.iter().map(|r| r.added.join("+")).collect();

        if !best.added.contains(&own) && self.is_better(best, &brief)? {
            let fit = crate::fit::fit(self.problem, &best.fit.layout, best.fit.point.clone(), to_the_end());
            let effect = best.fit.layout.effects.iter().find(|e| best.added.contains(&e.header().id)).copied();
            if let (Ok(fit), Some(effect)) = (fit, effect)
                && fit.cost < step.fit.cost
            {
                let id = effect.header().id;
                let set = beside(id);
                let next_experiment = next(&best.fit, &set)?;
                let (probability, equivalent) = (probability(id), equivalent(&set));
                let name = Name { effect, probability, equivalent, next_experiment, ranked: ranked.clone() };
                let other = self.step(fit, vec![second.clone(), name])?;
                found.learn(self.problem, &other.residual);
                if self.accepts(found, &step, &other, best)? {
                    (self.progress)(&format!("{id} in the place of {own}"));
                    return Ok((other, best.fit.clone()));
                }
            }
        }
        let set = beside(own);
        let among = best.added.contains(&own) || others.iter().any(|r| r.added.contains(&own));
        if !among {
            return Ok((step, brief));
        }
        let seen = Name {
            probability: probability(own),
            equivalent: equivalent(&set),
            next_experiment: next(&brief, &set)?,
            ranked: ranked.clone(),
            effect: first.effect,
        };
        let names = step.names.iter().map(|n| if n.effect.header().id == own { seen.clone() } else { n.clone() });
        Ok((Step { names: names.collect(), ..step }, brief))
    }

    /// A refit is better than a fit of the brief runs, cluster by cluster.
    fn is_better(&self, refit: &Refit, than: &Fit) -> Result<bool, SimulationError> {
        let (clusters, count) = crate::score::clusters(&self.brief);
        let before = self.brief.residuals(&than.layout, &than.point)?;
        let after = self.brief.residuals(&refit.fit.layout, &refit.fit.point)?;
        let (total, z) = advantage(&before, &after, &clusters, count);
        Ok(total > 0.0 && z >= PREFERRED)
    }
}
