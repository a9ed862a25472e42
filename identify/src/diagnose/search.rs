//! The rounds of a diagnosis: which effect is added to the current model.

use std::collections::BTreeSet;

use model::effects::Effect;
use model::integrate::SimulationError;

use super::compare::{better_half, fewest_first, is_sound, joined, look_alikes, rank, rivals, where_they_differ};
use super::found::{Found, Name, Step};
use super::holdout::HoldOut;
use super::refits::{least_gain, nested_on, refit_all};
use super::round::Round;
use super::whole::Seated;
use super::{BRIEF_S, CLEAR, CONSISTENT, Declared, EXPLAINED, GROSS, MATERIAL, MOST_EFFECTS, PREFERRED, SHORT_S};
use crate::colour::{Colour, colours};
use crate::fit::Fit;
use crate::guided::{Guided, SHOWS};
use crate::identification::covariance_of;
use crate::misfit;
use crate::problem::Problem;
use crate::refit::{Bases, Refit, advantage};
use crate::shapes;

/// A fit is so far from the noise that a free run may be elsewhere than the rig was. Friction that stops the lever a little aside leaves no gross structured
/// residual in any channel, and many noise variances a target all the same.
fn is_far(problem: &Problem, fit: &Fit) -> bool {
    fit.cost > SHOWS * problem.targets() as f64
}

/// What a fit leaves is more than a small effect would.
pub(super) fn is_gross(problem: &Problem, fit: &Fit, colours: &[Colour]) -> Result<bool, SimulationError> {
    if is_far(problem, fit) {
        return Ok(true);
    }
    let residual = problem.residuals(&fit.layout, &fit.point)?;
    Ok(misfit::largest(&misfit::parts(problem, &residual, colours)) > GROSS)
}

/// A candidate that every judge accepts.
struct Accepted {
    /// With it, on the whole runs.
    step: Step,
    /// On the brief ones.
    best: Refit,
    /// The brief runs' fit stood in another minimum when the candidates were compared.
    elsewhere: bool,
}

/// What stays the same throughout.
pub(super) struct Search<'a> {
    pub library: &'a [&'static dyn Effect],
    pub problem: &'a Problem,
    /// The declared model, fitted.
    pub reference: Fit,
    /// The first seconds of each run with a free lever.
    pub brief: Problem,
    pub short: Problem,
    /// Base values that no effect has bent: another start for a gross one.
    pub component: &'a [f64],
    pub clusters: Vec<Vec<usize>>,
    pub count: usize,
    pub progress: &'a dyn Fn(&str),
}

impl<'a> Search<'a> {
    pub fn new(
        library: &'a [&'static dyn Effect],
        &Declared { problem, fit: reference, component }: &Declared<'a>,
        progress: &'a dyn Fn(&str),
    ) -> Self {
        let (clusters, count) = crate::score::clusters(problem);
        let (short, brief) = (problem.shortened(SHORT_S), problem.shortened(BRIEF_S));
        let reference = reference.clone();
        Search { library, problem, reference, short, brief, component, clusters, count, progress }
    }

    /// The reference model alone.
    pub fn start(&self) -> Result<Found, SimulationError> {
        let fit = self.reference.clone();
        let hold_out = HoldOut::of(self.problem, &fit, &self.clusters)?;
        let (residual, held_out) = (hold_out.fitted().to_vec(), hold_out.residuals());
        let colours = colours(self.problem, &residual);
        let step = Step { fit, names: Vec::new(), residual, held_out, disagreement: 0.0, silent: false };
        Ok(Found { steps: vec![step], ranking: Vec::new(), colours, convincing: None })
    }

    /// A fitted model as a step, with what it is worth on data that were left out.
    pub fn step(&self, fit: Fit, names: Vec<Name>) -> Result<Step, SimulationError> {
        let hold_out = HoldOut::of(self.problem, &fit, &self.clusters)?;
        let disagreement = (0..fit.layout.effects.len())
            .map(|n| {
                let first = fit.layout.first_of(n);
                let own = fit.layout.effects[n].header().parameters.iter().enumerate().filter(|(_, p)| p.size);
                let sizes: Vec<(usize, f64)> = own.map(|(i, _)| (first + i, fit.point.theta[first + i])).collect();
                hold_out.disagreement(&sizes, &self.clusters)
            })
            .fold(0.0, f64::max);
        let residual = hold_out.fitted().to_vec();
        Ok(Step { held_out: hold_out.residuals(), fit, names, residual, disagreement, silent: false })
    }

    /// Effects that a model does not carry.
    pub fn open(&self, fit: &Fit) -> Vec<&'static dyn Effect> {
        let ids: Vec<&str> = fit.layout.effects.iter().map(|e| e.header().id).collect();
        self.library.iter().copied().filter(|e| !ids.contains(&e.header().id)).collect()
    }

    /// The current model fitted to the brief runs: what candidates are scored against and refitted from.
    pub fn nested(&self, current: &Fit) -> Result<Fit, SimulationError> {
        nested_on(&self.brief, current)
    }

    /// Where a round's refits start.
    pub fn bases<'b>(&'b self, round: &'b Round, guided: Option<&'b Guided>, gross: bool) -> Bases<'b> {
        let (component, short) = (self.component, &self.short);
        Bases { scene: &round.scene, component, short, guided, beside: f64::INFINITY, gross }
    }

    /// Adds the best candidate of a round to the last step; `None` where no judge or not every judge is convinced.
    pub fn round(&self, found: &mut Found, round: &Round) -> Result<Option<Step>, SimulationError> {
        let last = found.last().clone();
        let largest = misfit::largest(&found.parts(self.problem, &last));
        let open = self.open(&last.fit);
        // a model that has taken an effect up fits its own data better than others
        let gross = largest > GROSS || is_far(self.problem, &last.fit);
        let left_out = misfit::largest(&self.left(found, &last));
        tracing::info!(largest, left_out, "misfit, noise floors");
        let guided = if gross || left_out > GROSS { round.guided(self) } else { None };
        let bases = self.bases(round, guided, gross);
        let mut shortlist = self.shortlist(round, &open, &bases)?;
        let room = self.most_names(found).saturating_sub(last.names.len());
        shortlist.retain(|set| set.len() <= room);
        let refits = refit_all(&self.brief, &bases, round, &shortlist, None, self.progress);
        let mut refits = fewest_first(&self.brief, refits, round.scene.fit.cost)?;
        // what looks like the best one must be refitted too before that is named
        let alike = look_alikes(round, &refits, &open);
        if !alike.is_empty() {
            let more = refit_all(&self.brief, &bases, round, &alike, None, self.progress);
            refits = fewest_first(&self.brief, joined(refits, more), round.scene.fit.cost)?;
        }
        let leads = |best: &Refit| round.scene.fit.cost - best.fit.cost >= least_gain(&self.brief, round.scene.fit);
        if !refits.first().is_some_and(leads) {
            if found.ranking.is_empty() {
                found.ranking = rank(&self.brief, &refits)?;
            }
            return Ok(None);
        }
        let (alone, ranked_before) = (better_half(&refits), found.ranking.clone());
        let mut accepted = self.best_of(found, round, refits)?;
        if let Some(alone) = alone.filter(|alone| accepted.is_none() && leads(&alone[0])) {
            // the ranking is that of what is accepted
            let of_two = std::mem::replace(&mut found.ranking, ranked_before);
            accepted = self.best_of(found, round, alone)?;
            if accepted.is_none() {
                found.ranking = of_two;
            }
        }
        match accepted {
            Some(accepted) => self.completed(found, &last, accepted),
            None => Ok(None),
        }
    }

    /// The best of a round's refits (their first) on the whole runs; `None` where it can't be brought there, or no judge or not every judge is convinced.
    fn best_of(
        &self,
        found: &mut Found,
        round: &Round,
        mut refits: Vec<Refit>,
    ) -> Result<Option<Accepted>, SimulationError> {
        let last = found.last().clone();
        let without = round.scene.fit;
        let Some(best) = refits.first_mut() else { return Ok(None) };
        let seated = self.seated(found, &last.fit, &best.fit, without)?;
        if let Some(Seated { brief: Some(brief), .. }) = &seated {
            best.fit = brief.clone();
        }
        let best = &refits[0];
        let ranked = rank(&self.brief, &refits)?;
        if found.ranking.is_empty() {
            found.ranking = ranked.clone();
        }
        let Some(Seated { fit, brief: moved }) = seated else { return Ok(None) };
        let rivals = rivals(&self.brief, &refits, without.cost)?;
        let next_experiment = match rivals.first() {
            Some(rival) => Some(where_they_differ(&self.brief, &best.fit, &rival.fit)?),
            None => None,
        };
        let mut names = last.names.clone();
        names.extend(fit.layout.effects.iter().filter(|e| best.added.contains(&e.header().id)).map(|e| Name {
            effect: *e,
            probability: ranked.iter().find(|r| r.id == best.added.join("+")).map_or(0.0, |r| r.probability),
            equivalent: rivals.iter().map(|r| r.added.join("+")).collect(),
            next_experiment: next_experiment.clone(),
            ranked: ranked.clone(),
        }));
        let step = self.step(fit, names)?;
        found.learn(self.problem, &step.residual);
        let accepted = self.accepts(found, &last, &step, best)?;
        Ok(accepted.then(|| Accepted { step, best: best.clone(), elsewhere: moved.is_some() }))
    }

    /// An accepted step without what is needless in it, and with better names in the places of its own where there are any; `None` where that leads back
    /// to the `last` one.
    fn completed(&self, found: &mut Found, last: &Step, accepted: Accepted) -> Result<Option<Step>, SimulationError> {
        let Accepted { step, best, elsewhere } = accepted;
        (self.progress)(&format!("added {}", best.added.join(" and ")));
        if let Some(lean) = self.without_needless(&step, &best.fit)? {
            let (begun, ended) = ((&last.ids(), last.fit.cost), (&lean.ids(), lean.fit.cost));
            return Ok(if is_back(begun, ended) { None } else { Some(lean) });
        }
        // nor are two that leave most of a gross misfit what is missing, whatever stands in the place of either
        let two_are_lost = step.names.len() == MOST_EFFECTS && self.is_lost(found, &step);
        if two_are_lost || self.is_beside_the_point(found, last, &step) {
            return Ok(Some(step));
        }
        // a name of this round was compared beside the earlier one, unless both are of this round, or that one stood elsewhere
        let mut unseen: Vec<&'static str> = step.names.iter().map(|n| n.effect.header().id).collect();
        unseen.retain(|id| elsewhere || best.added.len() > 1 || !best.added.contains(id));
        self.reviewed(found, step, best.fit.clone(), &unseen).map(Some)
    }

    /// Every judge agrees: the fit is better where it was fitted and where it was not, by more than noise matters, and what
    /// was added is physical and known to be other than zero. Where a misfit is certain and the candidate takes it away, it need not stand out
    /// as far: an effect that shows at a few switches of a valve alone can't.
    pub fn accepts(&self, found: &Found, last: &Step, step: &Step, best: &Refit) -> Result<bool, SimulationError> {
        let before = misfit::total(&found.parts(self.problem, last));
        let removed = (before - misfit::total(&found.parts(self.problem, step))).max(0.0).sqrt();
        let (_, better) = advantage(&last.residual, &step.residual, &self.clusters, self.count);
        let (held, held_better) = advantage(&last.held_out, &step.held_out, &self.clusters, self.count);
        // whether it is there: with its shapes as they are, for sizes trade places with them (a laminar leak with its transition, say)
        let shaped = Fit { layout: shapes::held(&step.fit.layout), ..step.fit.clone() };
        let covariance = covariance_of(self.problem, &shaped)?;
        let position = |id: &str| step.fit.layout.effects.iter().position(|e| e.header().id == id);
        let sound = best.added.iter().all(|id| position(id).is_some_and(|n| is_sound(&step.fit, &covariance, n)));
        let disagreement = step.disagreement;
        tracing::info!(
            names = ?best.added, better, held, held_better, removed, sound, disagreement, cost = step.fit.cost,
            "best candidate"
        );
        // as data left out show it: a fit takes up a part of what is missing
        let (without, with) = (self.left(found, last), self.left(found, step));
        let largest = misfit::largest(&without);
        let complete = misfit::total(&with) < (1.0 - EXPLAINED) * misfit::total(&without);
        let preferred = held > 0.0 && is_preferred(better, held_better, largest, complete);
        Ok(preferred && removed >= MATERIAL && sound)
    }
}

/// A model is preferred to one with a name less: by so many standard errors where it was fitted (`better`) and where it was not. `largest`: noise floors that
/// the one without leaves; `complete`: the name takes nearly all of it away, which of more than noise chance does not. Unless something is missing for certain
/// both must say so: data left out may be predicted better because the fit without the name has gone a little astray.
fn is_preferred(better: f64, held_better: f64, largest: f64, complete: bool) -> bool {
    let needed = if largest > CONSISTENT && complete { HELD } else { PREFERRED };
    better.max(held_better) >= needed && held_better >= HELD && (largest > CLEAR || better >= HELD)
}

/// A round is back where it began, and would only be repeated: at the same names, and no better minimum of their fit.
fn is_back(begun: (&BTreeSet<&str>, f64), ended: (&BTreeSet<&str>, f64)) -> bool {
    begun.0 == ended.0 && ended.1 >= BETTER_MINIMUM * begun.1
}

/// Share of the cost below which a fit of the same names stands in another minimum.
const BETTER_MINIMUM: f64 = 0.99;
/// Standard errors (by clusters) by which data that were left out must be predicted better.
pub(super) const HELD: f64 = 2.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_is_back_at_the_same_names_unless_their_fit_is_in_a_better_minimum() {
        let (one, other) = (BTreeSet::from(["end_stop"]), BTreeSet::from(["wall_creep"]));
        assert!(is_back((&one, 100.0), (&one, 100.0)) && is_back((&one, 100.0), (&one, 101.0)));
        assert!(!is_back((&one, 100.0), (&one, 90.0)), "the same name in a better minimum");
        assert!(!is_back((&one, 100.0), (&other, 100.0)), "another in its place");
        assert!(!is_back((&BTreeSet::new(), 100.0), (&one, 100.0)), "one more");
    }

    #[test]
    fn a_name_is_preferred_where_it_was_fitted_and_where_it_was_not() {
        assert!(is_preferred(3.1, 2.1, 0.2, false) && is_preferred(2.1, 3.1, 0.2, false));
        assert!(!is_preferred(1.7, 3.2, 0.6, false), "the fit without it has gone astray");
        assert!(is_preferred(1.7, 3.2, 0.8, false), "something is missing, in a few clusters");
        assert!(!is_preferred(9.0, 1.9, 0.8, true), "data left out don't say so");
        assert!(!is_preferred(2.5, 2.5, 0.8, false) && is_preferred(1.0, 2.1, 0.8, true));
        assert!(is_preferred(2.5, 2.5, 0.5, true) && !is_preferred(1.9, 2.5, 0.5, true), "more than noise, by both");
        assert!(!is_preferred(2.5, 2.5, 0.4, true), "as little as noise may leave");
    }

    #[test]
    fn a_stiffness_that_grows_throughout_the_stroke_is_no_end_stop() {
        let mut truth = model::Parameters::example();
        truth.pump.f1 *= 4.0;
        let find = |id| model::effects::find(id).unwrap();
        let (cubic, stop) = (find("torque_cubic"), find("end_stop"));
        let runs = [7, 8].map(|seed| crate::common::dynamic(&truth, Some((cubic, vec![-3.0, 0.0, 0.0])), 20.0, seed));
        let (problem, layout) = (crate::common::problem(&runs), crate::common::layout(&truth));
        let component = layout.vector_of(&truth);
        let at = problem.point(component.clone());
        let base = crate::fit::fit(&problem, &layout, at, crate::fit::Effort::default()).unwrap();
        let search = Search::new(&[], &Declared { problem: &problem, fit: &base, component: &component }, &|_| ());
        let without = search.nested(&base).unwrap();
        let round = Round::new(&search.brief, &without, [cubic, stop].into_iter()).unwrap();
        let bases = search.bases(&round, None, true);
        let refits = refit_all(&search.brief, &bases, &round, &[vec![cubic], vec![stop]], None, &|_| ());
        assert_eq!(refits[0].only(), Some("torque_cubic"));
        assert!(refits.iter().all(|r| r.fit.are_themselves()), "a contact from the middle of the stroke on");
    }
}
