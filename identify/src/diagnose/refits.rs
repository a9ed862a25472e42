//! Refits of a round's candidates, in heats, with the general forms and other shapes of the best.

use model::effects::{Effect, empirical};
use model::integrate::SimulationError;

use super::MATERIAL;
use super::round::Round;
use crate::fit::{Effort, Fit};
use crate::guided::{GUIDED_S, Guided, taken_away};
use crate::misfit;
use crate::problem::Problem;
use crate::refit::{Bases, Refit, refit};
use crate::score::Direction;
use crate::{forms, shapes};

/// Share of one effect's direction that another's hold from which on they look alike: an angle of less than 18 degrees.
pub(super) const ALIKE: f64 = 0.9;
/// Beside a better one a candidate matters that does half of it linearly, and has other forms and shapes that gains half as much.
const HALF: f64 = 0.5;
/// Share of the cost: with less a step the 25 steps of the last heat come to no other verdict on a misfit that is gross after them too.
const CREEP: f64 = 0.005;
/// A fit that is brought to its minimum. A gross effect needs many linearisations, and a stiff one (a stop) has places that can be simulated and not
/// linearised, which must not be stepped to.
pub(super) fn to_the_end() -> Effort {
    Effort { iterations: 40, tolerance: 1e-6, creep: CREEP, ahead: true, ..Effort::default() }
}
/// Refits each set of the shortlist; the lowest cost first, without what is not itself any more ([`Fit::are_themselves`]). `beside`: a candidate that
/// need not be refitted; who leaves many times what that leaves is not brought to the end.
///
/// In heats: each candidate gets a few steps, those that keep up some more, and those that are still near the best are brought
/// to their minimum, for only there can they be compared. Who falls far behind is in the result as it was left.
pub(super) fn refit_all(
    problem: &Problem,
    bases: &Bases,
    round: &Round,
    shortlist: &[Vec<&'static dyn Effect>],
    beside: Option<&Fit>,
    progress: &dyn Fn(&str),
) -> Vec<Refit> {
    let before = bases.scene.fit.cost;
    let mut led = beside.and_then(|fit| bases.guided.map(|guided| guided.cost_of(fit))).unwrap_or(f64::INFINITY);
    let beside = beside.map_or(f64::INFINITY, |fit| fit.cost);
    let mut out: Vec<Refit> = Vec::new();
    for set in shortlist {
        let added: Vec<(&'static dyn Effect, Vec<&Direction>)> = set
            .iter()
            .map(|e| (*e, round.of(e.header().id).into_iter().map(|i| &round.directions[i]).collect()))
            .collect();
        // beside one that explains nearly all, in free run or where it is led, only what looks like it matters, and that is refitted as such
        let explained = out.iter().any(|r| is_nearly_all(problem, before, r.fit.cost))
            || bases.guided.is_some_and(|guided| guided.is_all_but_explained(led));
        let best = out.iter().filter(|r| is_all_but_noise(problem, before, r.fit.cost)).find_map(Refit::only);
        if bases.gross && best.is_some_and(|id| !matters_beside(round, id, set, before)) {
            continue;
        }
        let own =
            if explained { Bases { gross: false, guided: None, ..*bases } } else { Bases { beside: led, ..*bases } };
        if let Some(refit) = refit(problem, &own, &added, HEATS[0].effort()) {
            led = refit.led.map_or(led, |cost| cost.min(led));
            out.push(refit);
        }
    }
    for heat in &HEATS[1..] {
        out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
        let Some(best) = out.first().map(|r| r.fit.cost) else { break };
        let gain = (before - best).max(0.0);
        for (place, r) in out.iter_mut().enumerate() {
            let keeps_up = before - r.fit.cost >= heat.share * gain && r.fit.cost <= heat.times * best.min(beside);
            if !r.fit.converged
                && place < heat.most
                && keeps_up
                && let Ok(fit) = crate::fit::fit(problem, &r.fit.layout, r.fit.point.clone(), heat.effort_for(&r.fit))
            {
                r.fit = fit;
            }
        }
    }
    out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    let gain = before - out.first().map_or(before, |r| r.fit.cost.min(beside));
    let hope = least_gain(problem, bases.scene.fit);
    for r in out.iter_mut().take(SHAPED).filter(|r| before - r.fit.cost > (HALF * gain).max(hope)) {
        if a_form_may_tell(problem, &r.fit) {
            r.fit = forms::refined(problem, r.fit.clone(), &r.added, forms::FOLLOWED, GENERAL.effort(), forms::CLEARLY);
        }
        if r.led.is_none() && !is_noise(problem, &r.fit) {
            r.fit = shapes::search(problem, r.fit.clone(), HEATS[2].effort());
        }
    }
    out.retain(|r| r.fit.are_themselves());
    out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    for r in &out {
        progress(&format!("{} refitted: cost {:.0} from {before:.0}", r.added.join(" + "), r.fit.cost));
    }
    out
}

/// Share of what is missing that a candidate takes away where it explains a gross misfit: others then need not be looked for with all that leads to gross
/// effects.
const NEARLY_ALL: f64 = 0.98;

/// Cost a target that is hardly more than that of noise.
const HARDLY_MORE: f64 = 1.5;

/// A fit of cost `after` leaves hardly more than noise of what one of cost `before` does.
pub(super) fn is_all_but_noise(problem: &Problem, before: f64, after: f64) -> bool {
    after < HARDLY_MORE * problem.targets() as f64 && is_nearly_all(problem, before, after)
}

/// Beside one that leaves hardly more than noise of a gross misfit (`before`: its cost) a set matters that looks like it or does half of it linearly.
pub(super) fn matters_beside(round: &Round, id: &str, set: &[&'static dyn Effect], before: f64) -> bool {
    let alike = |other: &str| round.share_held(id, other).is_some_and(|held| held > ALIKE);
    round.gain_of(set) >= HALF * before || set.iter().any(|e| alike(e.header().id))
}

/// A fit of cost `after` takes away all but nothing of what one of cost `before` leaves beside noise.
pub(super) fn is_nearly_all(problem: &Problem, before: f64, after: f64) -> bool {
    taken_away(before, after, problem.targets()) > NEARLY_ALL
}

/// Share of what is missing below which a candidate at its minimum is not what is missing, in no shape or form.
const HOPE: f64 = 0.1;

/// What a candidate must gain on a model to be what that lacks, or part of it.
pub(super) fn least_gain(problem: &Problem, without: &Fit) -> f64 {
    misfit::parts_left_by(problem, without).map_or(0.0, |missing| HOPE * misfit::cost(&missing))
}

/// So many of the best candidates are given their general form and other shapes where theirs leave more than noise: the rig's may differ, or
/// they may be caught in a false minimum.
const SHAPED: usize = 3;
/// A general form has to find its place first.
pub(super) const GENERAL: Heat = Heat { iterations: 15, ..HEATS[3] };

/// A fit leaves nothing that matters.
fn is_noise(problem: &Problem, fit: &Fit) -> bool {
    misfit::left_by(problem, fit).is_ok_and(|left| left < MATERIAL)
}

/// A general form may take away what [`forms::CLEARLY`] asks of it: that much of the cost, or more, is structured.
pub(super) fn a_form_may_tell(problem: &Problem, fit: &Fit) -> bool {
    let left = misfit::parts_left_by(problem, fit);
    left.is_ok_and(|left| misfit::largest(&left) >= MATERIAL && misfit::cost(&left) > (1.0 - forms::CLEARLY) * fit.cost)
}

/// A heat of [`refit_all`].
pub(super) struct Heat {
    /// Runs in it who is among so many,
    most: usize,
    /// gains at least this share of what the best gains,
    share: f64,
    /// and leaves at most so many times what the best leaves.
    times: f64,
    iterations: usize,
    tolerance: f64,
}

impl Heat {
    pub fn effort(&self) -> Effort {
        Effort { iterations: self.iterations, tolerance: self.tolerance, creep: CREEP, ..Effort::default() }
    }

    /// Of terms without a name, which are many, their curve and their balance are asked for, and no value to the last digit.
    fn effort_for(&self, fit: &Fit) -> Effort {
        let nameless = fit.layout.effects.last().is_some_and(|e| empirical::is_nameless(*e));
        let tolerance = if nameless { self.tolerance.max(TERMS) } else { self.tolerance };
        Effort { tolerance, ..self.effort() }
    }
}

/// Relative decrease of the cost below which terms without a name are where they are looked for.
const TERMS: f64 = 1e-3;

/// A gross effect that is bent into place needs many steps, so a heat is generous in what it lets pass.
const HEATS: [Heat; 4] = [
    Heat { most: usize::MAX, share: 0.0, times: f64::INFINITY, iterations: 2, tolerance: 1e-5 },
    Heat { most: 5, share: 0.4, times: 20.0, iterations: 4, tolerance: 1e-5 },
    Heat { most: 4, share: 0.6, times: 5.0, iterations: 6, tolerance: 1e-5 },
    Heat { most: 3, share: 0.85, times: 2.0, iterations: 25, tolerance: 1e-6 },
];

/// A model on the start of each run where its simulation follows what was measured, from its fit or the component experiments on.
pub(super) fn guided(problem: &Problem, current: &Fit, component: &[f64]) -> Option<Guided> {
    let mut from_component = current.point.theta.clone();
    from_component[..component.len()].copy_from_slice(component);
    Guided::new(&problem.shortened(GUIDED_S), &current.layout, &current.point.theta, &from_component)
}

/// A model fitted to the brief runs, from its fit to the whole ones on.
pub(super) fn nested_on(brief: &Problem, fit: &Fit) -> Result<Fit, SimulationError> {
    let effort = Effort { iterations: 12, tolerance: 1e-6, creep: CREEP, ..Effort::default() };
    crate::fit::fit(brief, &fit.layout, fit.point.clone(), effort)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gross_misfit_is_explained_by_what_leaves_little_beside_noise() {
        let truth = model::Parameters::example();
        let problem = crate::common::problem(&[crate::common::dynamic(&truth, None, 4.0, 7)]);
        let noise = problem.targets() as f64;
        let is = |before: f64, after: f64| is_nearly_all(&problem, before * noise, after * noise);
        assert!(is(1000.0, 10.0) && is(11.0, 1.15), "which ends at 1");
        assert!(!is(1000.0, 25.0) && !is(11.0, 1.5) && !is(1.0, 0.9));
    }

    #[test]
    fn terms_without_a_name_are_not_followed_to_the_last_digit_and_names_are() {
        let truth = model::Parameters::example();
        let of = |effect: &'static dyn Effect| {
            let layout = crate::common::layout(&truth).with(effect);
            let point = crate::problem::Point { theta: vec![0.0; layout.len()], initial: Vec::new() };
            HEATS[3].effort_for(&Fit { layout, point, cost: 1.0, converged: false }).tolerance
        };
        assert_eq!(of(model::effects::find("pump_lag").unwrap()), HEATS[3].tolerance);
        assert_eq!(of(empirical::EMPIRICAL[0]), TERMS);
    }

    #[test]
    fn what_a_candidate_must_gain_is_a_share_of_what_is_missing_and_next_to_nothing_where_nothing_is() {
        let truth = model::Parameters::example();
        let lag = model::effects::find("pump_lag").unwrap();
        for (values, missing) in [(None, false), (Some((lag, vec![0.05])), true)] {
            let problem = crate::common::problem(&[crate::common::dynamic(&truth, values, 20.0, 51)]);
            let layout = crate::common::layout(&truth);
            let at = problem.point(layout.vector_of(&truth));
            let fit = crate::fit::fit(&problem, &layout, at, Effort::default()).unwrap();
            let (least, targets) = (least_gain(&problem, &fit), problem.targets() as f64);
            if missing {
                let whole = fit.cost - targets;
                assert!(whole > 10.0 * targets, "a misfit of {whole}");
                assert!(least > 0.05 * whole && least < 0.11 * whole, "{least} of {whole}");
            } else {
                assert!(least < 0.005 * targets, "{least} of {targets}");
            }
        }
    }

    #[test]
    fn a_form_is_asked_for_where_more_than_its_share_is_left() {
        let truth = model::Parameters::example();
        let plain = model::effects::find("pump_lag").unwrap();
        let asked = |effect: &'static dyn Effect, values: &[f64]| {
            let problem =
                crate::common::problem(&[crate::common::dynamic(&truth, Some((effect, values.to_vec())), 20.0, 51)]);
            let layout = crate::common::layout(&truth);
            let mut point = problem.point(layout.vector_of(&truth));
            point.theta.push(0.01);
            let found = crate::fit::fit(&problem, &layout.with(plain), point, Effort::default()).unwrap();
            a_form_may_tell(&problem, &found)
        };
        assert!(asked(plain.refined().unwrap().effect, &[0.014, 0.6, 0.15]), "a pump that ramps");
        assert!(!asked(plain, &[0.02]), "one that is late by the library's law");
    }

    /// Which of these effects are refitted, in this order, on runs of a rig whose pump is late by so much.
    fn refitted(tau_s: f64, ids: &[&str], gross: bool) -> Vec<&'static str> {
        let truth = model::Parameters::example();
        let effect = |id: &str| model::effects::find(id).unwrap();
        let late = Some((effect("pump_lag"), vec![tau_s]));
        let runs = [7, 8].map(|seed| crate::common::dynamic(&truth, late.clone(), 12.0, seed));
        let (problem, layout) = (crate::common::problem(&runs), crate::common::layout(&truth));
        let component = layout.vector_of(&truth);
        let bent = crate::fit::fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
        let round = Round::new(&problem, &bent, ids.iter().map(|id| effect(id))).unwrap();
        let (scene, component) = (&round.scene, &component[..]);
        let bases = Bases { scene, component, short: &problem, guided: None, beside: f64::INFINITY, gross };
        let sets: Vec<Vec<&'static dyn Effect>> = ids.iter().map(|id| vec![effect(id)]).collect();
        let mut out: Vec<_> =
            refit_all(&problem, &bases, &round, &sets, None, &|_| ()).iter().filter_map(Refit::only).collect();
        out.sort();
        out
    }

    #[test]
    fn beside_a_late_pump_what_looks_like_it_matters_and_what_does_half_of_it_linearly() {
        let truth = model::Parameters::example();
        let effect = |id: &str| model::effects::find(id).unwrap();
        let (lag, other) = (effect("pump_lag"), effect("pump_asymmetry"));
        let problem = crate::common::problem(&[crate::common::dynamic(&truth, Some((lag, vec![0.004])), 12.0, 7)]);
        let layout = crate::common::layout(&truth);
        let at = problem.point(layout.vector_of(&truth));
        let bent = crate::fit::fit(&problem, &layout, at, Effort::default()).unwrap();
        let round = Round::new(&problem, &bent, [lag, other].into_iter()).unwrap();
        let gain = round.gain_of(&[other]);
        assert!(matters_beside(&round, "pump_lag", &[lag], f64::INFINITY), "its like");
        assert!(!matters_beside(&round, "pump_lag", &[other], 3.0 * gain.max(1.0)));
        assert!(matters_beside(&round, "pump_lag", &[other], 1.5 * gain), "two thirds of it");
        let targets = problem.targets() as f64;
        let noise = |before: f64, after: f64| is_all_but_noise(&problem, before * targets, after * targets);
        assert!(noise(100.0, 1.1) && !noise(100.0, 1.6) && !noise(2.0, 1.2), "what noise leaves, of much more");
    }

    #[test]
    fn beside_one_that_explains_a_gross_misfit_to_the_noise_only_its_like_is_refitted() {
        let both = ["pump_asymmetry", "pump_lag"];
        assert_eq!(refitted(0.04, &["pump_lag", "pump_asymmetry"], true), ["pump_lag"]);
        assert_eq!(refitted(0.04, &["pump_asymmetry", "pump_lag"], true), both, "nothing is explained yet");
        assert_eq!(refitted(0.04, &["pump_lag", "pump_asymmetry"], false), both, "a small one costs little");
        assert_eq!(
            refitted(0.0, &["pump_lag", "pump_asymmetry"], true),
            both,
            "noise before and after explains nothing"
        );
    }
}
