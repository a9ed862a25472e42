//! From what was found to the verdict.

use model::effects::Balance;
use model::integrate::SimulationError;

use super::found::{Found, Name, Step};
use super::nameless::{BEYOND_NOISE, is_certain};
use super::round::Round;
use super::search::Search;
use super::{Added, CONSISTENT, DISAGREE, Diagnosis, EXPLAINED, GROSS, MATERIAL, MOST_EFFECTS, SUBSTANTIAL, Verdict};
use crate::fit::{Fit, fit};
use crate::identification::polish;
use crate::misfit::{self, Part};
use crate::problem::Problem;
use crate::simplify::{errors_of_simplified, simplify};

impl Search<'_> {
    /// What a step leaves, as the data that were left out of its fit show it.
    pub fn left(&self, found: &Found, step: &Step) -> Vec<Part> {
        misfit::parts(self.problem, &step.held_out, &found.colours)
    }

    /// What the names of a step leave, beside what there was before the last of them and at first.
    fn leaves(&self, found: &Found, before: &Step, step: &Step) -> Leaves {
        let left = self.left(found, step);
        let total = |step: &Step| misfit::total(&self.left(found, step));
        let (whole, before_it, after) = (total(&found.steps[0]), total(before), misfit::total(&left));
        Leaves {
            first: before.names.is_empty(),
            largest: misfit::largest(&left),
            share: if before_it > 0.0 { 1.0 - after / before_it } else { 1.0 },
            of_whole: if whole > 0.0 { (before_it - after) / whole } else { 1.0 },
            next_to_nothing: after < SUBSTANTIAL * whole,
            agreed: step.disagreement <= DISAGREE,
        }
    }

    /// Whether the names of a step are the explanation.
    fn explains(&self, found: &Found, number: usize) -> Explains {
        let step = &found.steps[number];
        let leaves = self.leaves(found, &found.steps[number - 1], step);
        // where it said nothing at first either the campaign is too short for it
        let silent = step.silent && !found.steps[0].silent;
        tracing::info!(names = ?step.ids(), ?leaves, silent, step.disagreement, "what the names leave");
        if leaves.is_noise_that_creeps(silent) { Explains::Yes } else { leaves.explained() }
    }

    /// A step's second name is beside the point ([`Leaves::beside_the_point`]).
    pub fn is_beside_the_point(&self, found: &Found, before: &Step, step: &Step) -> bool {
        self.leaves(found, before, step).beside_the_point()
    }

    /// The names of a step are not the explanation, whatever terms without one leave.
    pub fn is_unexplained(&self, found: &Found, before: &Step, step: &Step) -> bool {
        self.leaves(found, before, step).explained() == Explains::No
    }

    /// The verdict.
    pub fn conclude(&self, mut found: Found, first: &Round) -> Result<Diagnosis, SimulationError> {
        let before = found.steps[0].clone();
        let largest = misfit::largest(&found.parts(self.problem, &before));
        let judged: Vec<Explains> = (1..found.steps.len()).map(|n| self.explains(&found, n)).collect();
        let last = |as_judged: Explains| judged.iter().rposition(|j| *j == as_judged).map(|n| n + 1);
        let mut chosen = last(Explains::Yes);
        let nameless = match chosen {
            Some(n) => {
                let left = self.left(&found, &found.steps[n]);
                let of_whole = misfit::total(&left) / misfit::total(&self.left(&found, &before));
                let names = &found.steps[n].names;
                let balance = |n: &Name| n.effect.header().balance;
                let apart = names.iter().any(|n| balance(n) != balance(&names[0]));
                match enough(names.len(), apart, misfit::largest(&left), of_whole) {
                    Some(share) => {
                        let cost = found.steps[n].fit.cost;
                        self.nameless(&mut found, first, true)?.filter(|step| {
                            let less = misfit::total(&self.left(&found, step)) < share * misfit::total(&left);
                            less && (share <= 1.0 || step.fit.cost < cost)
                        })
                    }
                    None => None,
                }
            }
            None if largest >= MATERIAL => {
                let certain = is_certain(largest, found.steps.len() > 1, !before.silent);
                let nameless = self.nameless(&mut found, first, certain)?;
                let total = |step: &Step| misfit::total(&self.left(&found, step));
                match (last(Explains::Mostly), &nameless) {
                    // no other effect of any form comes near the name
                    (Some(n), Some(terms)) if total(&found.steps[n]) < NAMELESS * total(terms) => {
                        chosen = Some(n);
                        None
                    }
                    _ => match nameless {
                        Some(terms) => Some(self.where_a_name_points(&mut found, first, terms)?),
                        None => None,
                    },
                }
            }
            None => None,
        };
        let (verdict, step, names) = match (nameless, chosen) {
            (Some(step), _) => {
                let step = self.handed_on(&found, step)?;
                let carried = step.fit.layout.effects.last().copied();
                let names = carried.map(Name::without_rivals).into_iter().collect();
                (Verdict::Unrecognised, step, names)
            }
            (None, Some(n)) => {
                let mut step = self.in_best_form(found.steps[n].clone())?;
                step.fit = simplify(self.problem, step.fit)?;
                step.fit = polished(self.problem, step.fit);
                step.residual = self.problem.residuals(&step.fit.layout, &step.fit.point)?;
                let tie = step.next_experiment().is_some();
                let names = step.names.clone();
                (if tie { Verdict::Ambiguous } else { Verdict::Attributed }, step, names)
            }
            (None, None) => (Verdict::None, before.clone(), Vec::new()),
        };
        let tie = chosen.filter(|_| verdict == Verdict::Ambiguous).map(|n| &found.steps[n]);
        let next_experiment = tie.and_then(Step::next_experiment);
        // what was compared first may be another name, which is certain by now
        let ranking = tie.and_then(Step::ranking_of_tie).unwrap_or_else(|| found.ranking.clone());
        let effects = self.added(&step.fit, &names)?;
        let balances = if effects.is_empty() {
            balance_p_values(first, first, &effects)
        } else {
            let nested = self.nested(&step.fit)?;
            let mut others = self.open(&nested);
            others.retain(|e| !effects.iter().any(|a| a.effect.header().balance == e.header().balance));
            let last = Round::usual(&self.brief, &nested, &others)?;
            balance_p_values(first, &last, &effects)
        };
        let (parts_before, parts_after) = (found.parts(self.problem, &before), found.parts(self.problem, &step));
        Ok(Diagnosis {
            verdict,
            effects,
            ranking,
            balances,
            explained: if verdict == Verdict::None { 1.0 } else { explained_share(&parts_before, &parts_after) },
            shows: first.shows(),
            silent: step.silent,
            after: step.fit,
            parts_before,
            parts_after,
            next_experiment,
        })
    }

    /// What a fit carries, with values and standard errors.
    fn added(&self, fit: &Fit, names: &[Name]) -> Result<Vec<Added>, SimulationError> {
        if names.is_empty() {
            return Ok(Vec::new());
        }
        let known = errors_of_simplified(self.problem, fit)?;
        Ok(names
            .iter()
            .map(|name| {
                let header = name.effect.header();
                let n = fit.layout.effects.iter().position(|e| e.header().id == header.id);
                let entries = n.map_or(0..0, |n| {
                    let first = fit.layout.first_of(n);
                    first..first + header.parameters.len()
                });
                Added {
                    effect: name.effect,
                    probability: name.probability,
                    equivalent: name.equivalent.clone(),
                    values: fit.point.theta[entries.clone()].to_vec(),
                    known: known[entries].to_vec(),
                }
            })
            .collect())
    }
}

/// At its minimum, along flat directions as well: comparing candidates ends where the cost hardly falls, which may be standard errors away along those.
fn polished(problem: &Problem, reached: Fit) -> Fit {
    match fit(problem, &reached.layout, reached.point.clone(), polish()) {
        Ok(fit) if fit.cost < reached.cost => {
            tracing::info!(from = reached.cost, to = fit.cost, converged = fit.converged, "polished");
            fit
        }
        _ => reached,
    }
}

/// What the names of a step leave on data that were left out.
#[derive(Clone, Copy, Debug)]
struct Leaves {
    /// Nothing was named before them.
    first: bool,
    /// The largest part of what is left, noise floors.
    largest: f64,
    /// What the last of them explains, as a share of what there was before it,
    share: f64,
    /// and of the whole.
    of_whole: f64,
    /// All together leave no substantial part of the whole.
    next_to_nothing: bool,
    /// Every run asks for the same size of them.
    agreed: bool,
}

impl Leaves {
    /// Either what they leave is noise. Or the last of them explains the overwhelming share of what was there before it, or
    /// together they leave no substantial part of the whole, and every run asks for the same size of it: then the rest is a matter of
    /// form, for another effect never has the form of an error exactly. A second name does a substantial part of the whole, or the overwhelming
    /// share of what was left, or leaves nothing that matters. Names that each explain part of a misfit which stays are none. What two names
    /// leave has no bound in noise floors: on measured data what is known of a machine leaves three (EMPS), imitations leave from one to five.
    fn explained(&self) -> Explains {
        let nearly_all = self.share >= EXPLAINED;
        let substantial = self.first || self.of_whole >= SUBSTANTIAL || nearly_all || self.largest < MATERIAL;
        let overwhelming = nearly_all || self.next_to_nothing;
        if substantial && (self.largest < CONSISTENT || (overwhelming && self.agreed)) {
            Explains::Yes
        } else if substantial && self.share >= MOSTLY && self.agreed {
            Explains::Mostly
        } else {
            Explains::No
        }
    }

    /// What is left, up to what noise that creeps may leave, goes with nothing that the library knows (`silent`), as what was there before did.
    fn is_noise_that_creeps(&self, silent: bool) -> bool {
        silent && self.agreed && self.largest < BEYOND_NOISE
    }

    /// A second name that does no substantial part, and leaves a gross misfit: whatever stands in the place of the first, the two are not what is
    /// missing.
    fn beside_the_point(&self) -> bool {
        !self.first && self.of_whole < SUBSTANTIAL && self.largest > GROSS
    }
}

/// How far names are the explanation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Explains {
    /// They are.
    Yes,
    /// They are if terms without a name leave far more.
    Mostly,
    /// Not by themselves.
    No,
}

/// A name that explains less than [`EXPLAINED`] but this share stands where terms without a name leave twice as much as it, or more.
const MOSTLY: f64 = 0.75;
/// Two names that leave less than this (noise floors) are no imitation of something else.
const IMITATED: f64 = 0.2;
/// Two names of which this share of the whole or less is left (a tenth of its amplitude) may leave it for want of form.
const FORM_OF_TWO: f64 = 0.01;
/// Terms that are preferred to these leave next to nothing of it: with terms for everything they always leave a little less. So must those that
/// are preferred to one name that leaves a gross misfit, but no substantial part of the whole.
const NEXT_TO_NOTHING: f64 = 0.2;
/// One name of which less than this share of the whole is left (a thirtieth of its amplitude) is what is missing, however many noise floors its form leaves.
const ALL_BUT_FORM: f64 = 0.001;
/// Two effects in different balances of which less than this share of the whole is left (a hundredth of its amplitude) are what is missing.
const BOTH: f64 = 1e-4;
/// Terms without a name, which are many, predict about as well as two names where they leave at most so many times as much.
const ALIKE: f64 = 2.0;
/// Terms without a name are preferred to a name that leaves more than noise where they leave less than this share of what the name
/// leaves.
const NAMELESS: f64 = 0.5;

/// The share of what names leave below which terms without a name must come to be preferred to them; `None` where names need no
/// such comparison. `largest`: what they leave, noise floors; `of_whole`: as a share of what there was.
///
/// A name whose form leaves a substantial part must do better, and at least as well where that is a gross misfit; one that leaves less of it, but
/// certainly more than noise, not much worse, unless it is the thirtieth part of the amplitude.
///
/// Two names that leave more than noise, and more than want of form would, are one thing imitated by two where terms of one balance fit the data better
/// (which the caller must see to: the share is above 1) and leave about as much of what was left out: many a foreign effect is imitated by two. Two names `apart`, in
/// different balances, are so whatever they leave that matters, unless it is the hundredth part of the amplitude.
fn enough(names: usize, apart: bool, largest: f64, of_whole: f64) -> Option<f64> {
    if apart {
        return (largest >= MATERIAL && of_whole >= BOTH).then_some(ALIKE);
    }
    if names >= MOST_EFFECTS {
        let share = if of_whole > FORM_OF_TWO { ALIKE } else { NEXT_TO_NOTHING };
        return (largest >= IMITATED).then_some(share);
    }
    if of_whole >= SUBSTANTIAL {
        return (largest >= CONSISTENT).then_some(if largest > GROSS { 1.0 } else { NAMELESS });
    }
    (largest > GROSS && of_whole >= ALL_BUT_FORM).then_some(NEXT_TO_NOTHING)
}

/// 1 - structured residual after / before, over the parts that decide.
pub(super) fn explained_share(before: &[Part], after: &[Part]) -> f64 {
    let total = misfit::total(before);
    if total > 0.0 { 1.0 - misfit::total(after) / total } else { 1.0 }
}

/// p-value by balance: of a balance in which something was added, under the declared model; of the others, with that added,
/// so that one effect does not light up every balance.
fn balance_p_values(first: &Round, last: &Round, added: &[Added]) -> Vec<(Balance, f64)> {
    Balance::ALL
        .into_iter()
        .map(|b| {
            let own = added.iter().any(|a| a.effect.header().balance == b);
            let round = if own { first } else { last };
            (b, round.p_value(|d| d.effect.header().balance == b))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_leaves_noise_or_a_matter_of_its_form_and_a_second_one_does_much_or_all() {
        let noise =
            Leaves { first: true, largest: 0.2, share: 0.5, of_whole: 0.5, next_to_nothing: false, agreed: true };
        assert_eq!(noise.explained(), Explains::Yes);
        let form = Leaves { largest: 3.0, share: 0.9, of_whole: 0.9, ..noise };
        assert_eq!(form.explained(), Explains::Yes);
        assert_eq!(Leaves { agreed: false, ..form }.explained(), Explains::No, "each run asks for another size");
        assert_eq!(Leaves { share: 0.8, ..form }.explained(), Explains::Mostly);
        assert_eq!(Leaves { share: 0.8, next_to_nothing: true, ..form }.explained(), Explains::Yes);
        assert_eq!(Leaves { share: 0.6, ..form }.explained(), Explains::No);
        let second = Leaves { first: false, of_whole: 0.01, ..noise };
        assert_eq!(second.explained(), Explains::No, "neither much nor all");
        assert_eq!(Leaves { largest: 0.05, ..second }.explained(), Explains::Yes, "what it leaves does not matter");
        assert_eq!(Leaves { share: 0.95, agreed: false, ..second }.explained(), Explains::Yes);
        let some = Leaves { share: 0.8, next_to_nothing: true, largest: 0.6, ..second };
        assert_eq!(some.explained(), Explains::No, "more than noise, and a small part of the whole");
        let forms = Leaves { share: 0.95, ..some };
        assert_eq!(forms.explained(), Explains::Yes, "nearly all that was left");
        assert_eq!(Leaves { agreed: false, ..forms }.explained(), Explains::No);
        let creeps = Leaves { share: 0.5, largest: 1.3, ..form };
        assert!(creeps.is_noise_that_creeps(true) && creeps.explained() == Explains::No);
        assert!(!creeps.is_noise_that_creeps(false), "a candidate goes with it");
        assert!(!Leaves { largest: 3.5, ..creeps }.is_noise_that_creeps(true), "far more than such noise");
        assert!(!Leaves { agreed: false, ..creeps }.is_noise_that_creeps(true));
        let idle = Leaves { largest: 3.0, share: 0.3, ..second };
        assert!(idle.beside_the_point() && idle.explained() == Explains::No);
        assert!(
            !Leaves { largest: 1.0, ..idle }.beside_the_point(),
            "what is left may yet be a matter of the first one's form"
        );
        assert!(!Leaves { of_whole: 0.1, ..idle }.beside_the_point(), "it does a substantial part");
        assert!(!Leaves { first: true, ..idle }.beside_the_point());
    }

    #[test]
    fn two_names_are_held_against_terms_without_one_sooner_than_a_single_name() {
        assert_eq!(enough(1, false, 0.3, 0.5), None, "noise, nearly");
        assert_eq!(enough(1, false, 1.0, 0.01), None, "a matter of its form");
        assert_eq!(enough(1, false, 2.0, 0.01), Some(NEXT_TO_NOTHING), "or the name of something else");
        assert_eq!(enough(1, false, 14.0, 0.0003), None, "a stop of a thousand floors in another form");
        assert_eq!(enough(1, false, 1.0, 0.1), Some(NAMELESS));
        assert_eq!(enough(1, false, 30.0, 0.1), Some(1.0), "a gross part of the whole is no matter of form");
        assert_eq!(enough(1, false, 0.0, f64::NAN), None, "nothing was there");
        assert_eq!(enough(2, false, 0.1, 0.5), None, "noise");
        assert_eq!(enough(2, false, 0.3, 0.001), Some(NEXT_TO_NOTHING));
        assert_eq!(enough(2, false, 2.0, 0.03), Some(ALIKE), "one thing may be imitated by two");
        assert_eq!(enough(2, true, 0.11, 0.02), Some(ALIKE), "one balance may do for both");
        assert_eq!(enough(2, true, 0.05, 0.001), None, "what they leave does not matter");
        assert_eq!(enough(2, true, 0.6, 0.00006), None, "nothing of one balance is imitated so well");
    }

    #[test]
    fn a_fit_that_was_left_along_a_flat_direction_is_brought_to_its_minimum() {
        let truth = model::Parameters::example();
        let (problem, layout) =
            (crate::common::problem(&[crate::common::dynamic(&truth, None, 12.0, 7)]), crate::common::layout(&truth));
        let at = problem.point(layout.vector_of(&truth));
        let least = fit(&problem, &layout, at, polish()).unwrap();
        let std = crate::identification::standard_errors(&problem, &least).unwrap();
        let mut point = least.point.clone();
        point.theta[1] += 3.0 * std[1];
        let left = Fit { cost: problem.cost(&layout, &point), point, ..least.clone() };
        assert!(left.cost > least.cost + 1.0, "{} and {}", left.cost, least.cost);
        assert!(polished(&problem, left).cost < least.cost + 0.1);
        let again = polished(&problem, least.clone()).cost;
        assert!(again <= least.cost && least.cost - again < 0.01, "{again} below the minimum of {}", least.cost);
    }
}
