//! Terms without a name: in which balance something is missing, where no name says what.

use model::effects::empirical::EMPIRICAL;
use model::effects::{Balance, Effect};
use model::integrate::SimulationError;

use super::conclude::explained_share;
use super::found::{Found, Step};
use super::holdout::HoldOut;
use super::refits::refit_all;
use super::round::Round;
use super::search::Search;
use super::under_guide::UnderGuide;
use super::whole::on_the_whole;
use super::{CLEAR, LEVEL, PREFERRED};
use crate::colour::Colour;
use crate::fit::{Effort, Fit, fit};
use crate::guided::LEADS;
use crate::misfit;
use crate::problem::Problem;
use crate::refit::advantage;

/// Something is missing, whether a term explains it or not: a structured residual of this size (noise floors) that is in part explained by a name, or that the
/// library's score test tells from noise that creeps, or that is far more than such noise.
pub(super) fn is_certain(largest: f64, named: bool, scored: bool) -> bool {
    named || largest > BEYOND_NOISE || (scored && largest > CLEAR)
}

/// A rest of a second shows at least a third of what noise has that creeps: what is more (noise floors) is no noise, whatever its colour.
pub(crate) const BEYOND_NOISE: f64 = 3.0;

impl Search<'_> {
    /// The nameless term of the balance that explains most, where there is something to explain. `certain`: there is ([`is_certain`]). Otherwise the terms'
    /// score test, their size, and the data that were left out must agree. `first`: the round at the reference model.
    pub fn nameless(&self, found: &mut Found, first: &Round, certain: bool) -> Result<Option<Step>, SimulationError> {
        if certain {
            return self.look_for_nameless(found, first, true, None);
        }
        if found.convincing.is_none() {
            found.convincing = Some(self.look_for_nameless(found, first, false, None)?);
        }
        Ok(found.convincing.clone().flatten())
    }

    fn look_for_nameless(
        &self,
        found: &mut Found,
        first: &Round,
        certain: bool,
        only: Option<Balance>,
    ) -> Result<Option<Step>, SimulationError> {
        let reference = found.steps[0].clone();
        let round = Round::new(&self.brief, first.scene.fit, EMPIRICAL.iter().copied())?;
        let p = round.p_value(|_| true);
        tracing::info!(p, certain, "nameless terms");
        if p > LEVEL && !certain {
            return Ok(None);
        }
        let under = if only.is_some() { None } else { self.nameless_under_guide(found, first)? };
        let Some(fit) = empirical(self, &round, first, under.as_ref(), &found.colours, only)? else { return Ok(None) };
        let step = self.step(fit, Vec::new())?;
        found.learn(self.problem, &step.residual);
        let before = self.left(found, &reference);
        let after = self.left(found, &step);
        let share = explained_share(&before, &after);
        let (held, better) = advantage(&reference.held_out, &step.held_out, &self.clusters, self.count);
        tracing::info!(term = ?step.fit.layout.effects, share, held, better, "nameless term");
        let convincing = held > 0.0 && better > PREFERRED && share > 0.0;
        Ok((certain || convincing).then_some(step))
    }

    /// Terms as they are handed on: pulled towards nothing as hard as lets them predict best. Where the model predicts worse with them than without even
    /// so, it is the reference model with the same terms of no size: they say in which balance something is missing.
    pub fn handed_on(&self, found: &Found, step: Step) -> Result<Step, SimulationError> {
        let before = self.left(found, &found.steps[0]);
        let step = match self.pulled_back(found, &step)? {
            Some(pulled) => pulled,
            None => step,
        };
        let carried = step.fit.layout.effects.last().copied();
        let Some(term) = carried.filter(|_| explained_share(&before, &self.left(found, &step)) <= 0.0) else {
            return Ok(step);
        };
        let mut point = self.reference.point.clone();
        point.theta.extend(term.header().scaled(&step.fit.point.theta[point.theta.len()..], 0.0));
        self.step(fit(self.problem, &step.fit.layout, point, AS_IT_IS)?, Vec::new())
    }

    /// Terms that predict best where they are pulled; `None` where they do as they are, or where the linearised pull does not lead to what it promises.
    fn pulled_back(&self, found: &Found, step: &Step) -> Result<Option<Step>, SimulationError> {
        let hold_out = HoldOut::of(self.problem, &step.fit, &self.clusters)?;
        let best = Pulled::best(self.problem, &step.fit, &hold_out, &found.colours);
        if best.share == 0.0 {
            return Ok(None);
        }
        let mut point = step.fit.point.clone();
        for (value, d) in point.theta.iter_mut().zip(hold_out.moved(&terms(&step.fit), best.share)) {
            *value += d;
        }
        let mut held = step.fit.layout.clone();
        held.held.extend(terms(&step.fit).iter().map(|(entry, _)| *entry));
        let Ok(based) = fit(self.problem, &held, point, TO_THE_TERMS) else { return Ok(None) };
        let pulled = Fit { layout: step.fit.layout.clone(), ..based };
        // a place that can be simulated and not linearised is none to go on from
        let Ok(there) = HoldOut::of(self.problem, &pulled, &self.clusters) else { return Ok(None) };
        let held_out = there.pulled(&terms(&pulled), best.share);
        let residual = self.problem.residuals(&pulled.layout, &pulled.point)?;
        let pulled = Step { fit: pulled, residual, held_out, ..step.clone() };
        let leaves = |step: &Step| misfit::total(&self.left(found, step));
        tracing::info!(
            share = best.share,
            before = leaves(step),
            after = leaves(&pulled),
            "nameless terms pulled back"
        );
        Ok((leaves(&pulled) < leaves(step)).then_some(pulled))
    }

    /// Terms without a name, or those of the balance in which the names that were refused lie, all in one, where these fit the data and predict what was
    /// left out better than the terms do: terms that explain less than a name that is not the explanation say nothing of where it lies.
    pub fn where_a_name_points(&self, found: &mut Found, first: &Round, terms: Step) -> Result<Step, SimulationError> {
        let names: Vec<Balance> = found.last().names.iter().map(|n| n.effect.header().balance).collect();
        let of_terms = terms.fit.layout.effects.last().map(|e| e.header().balance);
        let leaves = |step: &Step| (step.fit.cost, misfit::total(&self.left(found, step)));
        let Some(balance) = pointed_at(&names, of_terms, leaves(found.last()), leaves(&terms)) else {
            return Ok(terms);
        };
        tracing::info!(?balance, "the names that were refused say more of the balance than terms without a name");
        Ok(self.look_for_nameless(found, first, true, Some(balance))?.unwrap_or(terms))
    }
}

/// The balance of the names that were refused, where it is one, not that of the terms without a name, and the names leave less than those, of what was
/// fitted (cost) and of what was left out. Terms that fit far better may predict less only because they are many.
fn pointed_at(
    names: &[Balance],
    terms: Option<Balance>,
    left_by_names: (f64, f64),
    left_by_terms: (f64, f64),
) -> Option<Balance> {
    let own = *names.first()?;
    let elsewhere = names.iter().all(|b| *b == own) && terms != Some(own);
    let less = left_by_names.0 < left_by_terms.0 && left_by_names.1 < left_by_terms.1;
    (elsewhere && less).then_some(own)
}

/// What the terms of one balance leave.
#[derive(Clone, Copy)]
struct Told {
    /// Of data that were left out.
    left: f64,
    /// Of the data they were fitted to.
    fitted: f64,
    /// What they take away where the simulation follows what was measured, as a share; 0 where it can't.
    guided: f64,
}

/// A point as it is.
const AS_IT_IS: Effort = Effort { iterations: 0, tolerance: 0.0, promise: f64::INFINITY, creep: 0.0, ahead: false };
/// The base parameters follow terms that were pulled.
const TO_THE_TERMS: Effort =
    Effort { iterations: 8, tolerance: 1e-5, promise: f64::INFINITY, creep: 0.0, ahead: false };

/// Shares of what each term does that it costs to be pulled by, weakest first.
const PULLS: [f64; 7] = [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1];

/// How hard terms are pulled towards nothing to predict best what is left out. They are many, and nearly alike where the data are: unpulled, the small
/// differences between them go far astray beyond that.
struct Pulled {
    share: f64,
    /// What they then leave of data left out.
    left: f64,
}

impl Pulled {
    fn best(problem: &Problem, fit: &Fit, hold_out: &HoldOut, colours: &[Colour]) -> Self {
        let entries = terms(fit);
        let each = PULLS.into_iter().map(|share| {
            let residual = hold_out.pulled(&entries, share);
            Pulled { share, left: misfit::unweighted(&misfit::parts(problem, &residual, colours)) }
        });
        let first = Pulled { share: 0.0, left: f64::INFINITY };
        each.fold(first, |best, next| if next.left < best.left { next } else { best })
    }
}

/// Entries of the last effect's sizes with their values.
fn terms(fit: &Fit) -> Vec<(usize, f64)> {
    let Some(last) = fit.layout.effects.len().checked_sub(1) else { return Vec::new() };
    let first = fit.layout.first_of(last);
    let own = fit.layout.effects[last].header().parameters.iter().enumerate().filter(|(_, p)| p.size);
    own.map(|(i, _)| (first + i, fit.point.theta[first + i])).collect()
}

/// Terms that leave more than this of data left out do not predict them.
const PREDICTED: f64 = 0.5;

/// Terms that leave at most so many times what the best ones do of the data that they were fitted to fit them as well.
const FITS_AS_WELL: f64 = 1.25;

/// Which terms predict best. A gross misfit that none of them predicts is one that they have to go on from (a curve beyond the angles it was seen at, a
/// memory longer than theirs): how far they go astray there says nothing of the balance. Where the simulation follows what was measured nothing goes astray: who
/// takes away far more there than the others tells. If nobody does, what they make of the data they have tells, unless others fit as well and predict
/// better by as much. `whole`: what is left out without them.
fn tells(told: &[Told], whole: f64, gross: bool) -> Option<usize> {
    let left = |n: &usize| told[*n].left;
    let predicts_best = (0..told.len()).min_by(|a, b| left(a).total_cmp(&left(b)))?;
    if !gross || left(&predicts_best) <= PREDICTED * whole {
        return Some(predicts_best);
    }
    let most = (0..told.len()).max_by(|a, b| told[*a].guided.total_cmp(&told[*b].guided))?;
    let far_more = |n: usize| n == most || told[most].guided >= FAR_MORE * told[n].guided;
    if told[most].guided >= LEADS && (0..told.len()).all(far_more) {
        return Some(most);
    }
    let fits_best = (0..told.len()).min_by(|a, b| told[*a].fitted.total_cmp(&told[*b].fitted))?;
    let fits = |n: &usize| told[*n].fitted <= FITS_AS_WELL * told[fits_best].fitted;
    let better = |n: &usize| FITS_AS_WELL * left(n) <= left(&fits_best);
    let other = (0..told.len()).filter(|n| fits(n) && better(n)).min_by(|a, b| left(a).total_cmp(&left(b)));
    Some(other.unwrap_or(fits_best))
}

/// Terms that take away so many times what the others do under a guide tell.
const FAR_MORE: f64 = 1.5;

/// The balance whose nameless terms predict left-out data best, refitted: what is fitted better may only be the set with more terms.
/// `round`: of those terms; `under`: what they take away under a guide, where the misfit is gross; `colours`: of the noise. `only`: of this balance alone.
fn empirical(
    search: &Search,
    round: &Round,
    first: &Round,
    under: Option<&UnderGuide>,
    colours: &[Colour],
    only: Option<Balance>,
) -> Result<Option<Fit>, SimulationError> {
    let ports = search.problem.plant.header().ports;
    let terms = EMPIRICAL.iter().filter(|e| e.header().ports.iter().all(|p| ports.contains(p)));
    let terms = terms.filter(|e| only.is_none_or(|balance| e.header().balance == balance));
    let mut gains: Vec<(f64, &'static dyn Effect)> = terms.map(|e| (round.gain_of(&[*e]), *e)).collect();
    gains.sort_by(|a, b| b.0.total_cmp(&a.0));
    tracing::debug!(?gains, "nameless terms");
    let top = gains.first().map_or(0.0, |(g, _)| *g);
    // a free run that is elsewhere than the rig was leads no terms, neither those that are missing nor those that are not
    let shows = under.filter(|under| under.shows);
    let bases = search.bases(round, shows.and_then(|_| first.guided(search)), false);
    let open = |e: &'static dyn Effect| under.is_none_or(|under| !under.rules_out(e));
    let worth = gains.into_iter().filter(|(g, e)| *g > 0.3 * top && open(*e)).take(3);
    let mut sets: Vec<Vec<&'static dyn Effect>> = worth.map(|(_, e)| vec![e]).collect();
    if let Some(under) = shows {
        // beside the first that explains all nobody is led
        sets.sort_by(|a, b| under.share(b[0]).total_cmp(&under.share(a[0])));
    }
    let (clusters, _) = crate::score::clusters(&search.brief);
    let (mut told, mut fits) = (Vec::new(), Vec::new());
    for refit in refit_all(&search.brief, &bases, round, &sets, None, search.progress) {
        let hold_out = HoldOut::of(&search.brief, &refit.fit, &clusters)?;
        let pulled = Pulled::best(&search.brief, &refit.fit, &hold_out, colours);
        let fitted = search.brief.residuals(&refit.fit.layout, &refit.fit.point)?;
        let fitted = misfit::unweighted(&misfit::parts(&search.brief, &fitted, colours));
        let guided = under.zip(refit.fit.layout.effects.last()).map_or(0.0, |(under, terms)| under.share(*terms));
        let of = Told { left: pulled.left, fitted, guided };
        tracing::info!(term = ?refit.added, cost = refit.fit.cost, pulled.share, of.left, of.fitted, of.guided, "nameless terms on data left out");
        told.push(of);
        fits.push(refit.fit);
    }
    let before = HoldOut::of(&search.brief, first.scene.fit, &clusters)?.residuals();
    let whole = misfit::unweighted(&misfit::parts(&search.brief, &before, colours));
    let Some(best) = tells(&told, whole, under.is_some()).map(|n| fits.swap_remove(n)) else { return Ok(None) };
    let effort = Effort { iterations: 8, tolerance: 1e-4, ..Effort::default() };
    let led = on_the_whole(search.problem, &search.reference, search.component, &best, effort);
    // no start leads below the reference model: from there on, with terms of no size
    Ok(led.or_else(|| {
        let mut point = search.reference.point.clone();
        // the term is the last of the effects: a declared model may carry others
        let term = best.layout.effects.last()?;
        point.theta.extend(term.header().scaled(&best.point.theta[point.theta.len()..], 0.0));
        fit(search.problem, &best.layout, point, effort).ok()
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_score_test_tells_from_noise_that_creeps_is_certain_where_it_is_far_more_or_a_name_explains_a_part() {
        assert!(!is_certain(0.9, false, false) && !is_certain(2.0, false, false));
        assert!(is_certain(0.9, false, true) && is_certain(0.9, true, false) && is_certain(3.5, false, false));
        assert!(!is_certain(0.6, false, true));
    }

    #[test]
    fn refused_names_point_at_their_balance_where_terms_without_one_say_less() {
        use Balance::{Flow, Sensor, Torque};
        let (names, terms) = ((60.0, 0.8), (90.0, 0.9));
        assert_eq!(pointed_at(&[Torque], Some(Sensor), names, terms), Some(Torque));
        assert_eq!(pointed_at(&[Torque, Torque], Some(Sensor), names, terms), Some(Torque));
        assert_eq!(pointed_at(&[Torque], Some(Sensor), names, (90.0, 0.4)), None, "the terms predict more");
        assert_eq!(pointed_at(&[Torque], Some(Sensor), names, (50.0, 0.9)), None, "the terms fit more");
        assert_eq!(pointed_at(&[Torque, Flow], Some(Sensor), names, terms), None, "two balances");
        assert_eq!(pointed_at(&[Torque], Some(Torque), names, terms), None, "it is theirs");
        assert_eq!(pointed_at(&[], Some(Torque), names, terms), None, "nothing was refused");
    }

    #[test]
    fn terms_that_predict_best_stand_and_where_none_predicts_a_gross_misfit_those_that_fit_best() {
        let of = |left: f64, fitted: f64, guided: f64| Told { left, fitted, guided };
        let none = |told: [Told; 2]| tells(&told, 100.0, true);
        assert_eq!(none([of(60.0, 10.0, 0.0), of(40.0, 30.0, 0.0)]), Some(1), "one of them predicts");
        assert_eq!(none([of(900.0, 10.0, 0.0), of(70.0, 30.0, 0.0)]), Some(0), "none does");
        assert_eq!(tells(&[of(900.0, 10.0, 0.0), of(70.0, 30.0, 0.0)], 100.0, false), Some(1), "nor is it gross");
        assert_eq!(none([of(900.0, 10.0, 0.0), of(70.0, 11.0, 0.0)]), Some(1), "which of two fits does not tell");
        assert_eq!(none([of(71.0, 10.0, 0.0), of(70.0, 12.0, 0.0)]), Some(0), "nor how they predict");
        assert_eq!(none([of(900.0, 30.0, 0.8), of(70.0, 10.0, 0.4)]), Some(0), "the guide tells");
        assert_eq!(none([of(900.0, 30.0, 0.5), of(70.0, 10.0, 0.4)]), Some(1), "it does not");
        assert_eq!(none([of(900.0, 30.0, 0.04), of(70.0, 10.0, 0.0)]), Some(1), "where hardly anything shows there");
        assert_eq!(none([of(60.0, 30.0, 0.8), of(40.0, 10.0, 0.1)]), Some(1), "one that predicts stands all the same");
        assert_eq!(tells(&[], 100.0, true), None);
    }
}
