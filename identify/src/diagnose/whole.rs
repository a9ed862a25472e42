//! From a fit to the brief runs to one to the whole ones.

use model::integrate::SimulationError;

use super::found::Found;
use super::refits::{GENERAL, a_form_may_tell, guided, to_the_end};
use super::search::{Search, is_gross};
use super::{LOST, MATERIAL};
use crate::false_minimum::left_behind;
use crate::fit::{Effort, FAR, Fit, fit};
use crate::forms::{CLEARLY, FOLLOWED, refined};
use crate::misfit;
use crate::problem::{Point, Problem};

/// Tells which start leads.
const FEW: Effort = Effort { iterations: 3, tolerance: 1e-6, promise: f64::INFINITY, creep: 0.0, ahead: true };

/// A start that after those steps leaves at most so many times what the fit does may yet end below it.
const HALFWAY: f64 = 1.5;

/// A fit in the best minimum that was found for it.
pub(super) struct Seated {
    pub fit: Fit,
    /// The fit to the brief runs that goes with it, where that stood in another minimum.
    pub brief: Option<Fit>,
}

impl Search<'_> {
    /// The fit `brief` of the brief runs brought to the whole ones, as [`on_the_whole`], or, where that leaves a gross misfit, from where a guide leads: it may
    /// stand in a false minimum, and a second effect must not be named for what another start would have gained. `current`: the model without what the
    /// candidate adds, on the whole runs; `without`: on the brief ones.
    pub fn seated(
        &self,
        found: &Found,
        current: &Fit,
        brief: &Fit,
        without: &Fit,
    ) -> Result<Option<Seated>, SimulationError> {
        let Some(lead) = lead(self.problem, current, self.component, brief) else { return Ok(None) };
        // what takes away little is not named, wherever it stands
        let little = brief.cost / without.cost > (1.0 - LOST) * found.steps[0].fit.cost / current.cost;
        let led =
            if little || !is_gross(self.problem, &lead, &found.colours)? { None } else { self.let_go(&lead, brief) };
        let (start, moved) = match led {
            Some(led) if led.cost < lead.cost => {
                tracing::info!(from = lead.cost, to = led.cost, "a guide leads further");
                (led, true)
            }
            _ => (lead, false),
        };
        let Some(fit) = ended(self.problem, current, start, to_the_end()) else { return Ok(None) };
        let (fit, general) = match self.formed(&fit, current, brief) {
            Some((fit, general)) => (fit, Some(general)),
            None => (fit, None),
        };
        let reached = fit.cost;
        let fit = self.sought_from_afar(fit)?;
        let moved = moved || fit.cost < reached;
        let there = if moved { self.nested(&fit).ok().filter(|there| there.cost < brief.cost) } else { None };
        Ok(Some(Seated { fit, brief: there.or(general) }))
    }

    /// The fit of the whole runs with what was added in its general form, and the brief runs' with it: where the whole ones leave what a form may take and
    /// the brief ones do not, as a stop that the lever comes into deeper later on.
    fn formed(&self, fit: &Fit, current: &Fit, brief: &Fit) -> Option<(Fit, Fit)> {
        if a_form_may_tell(&self.brief, brief) || !a_form_may_tell(self.problem, fit) {
            return None;
        }
        let before: Vec<&str> = current.layout.effects.iter().map(|e| e.header().id).collect();
        let added: Vec<&str> =
            fit.layout.effects.iter().map(|e| e.header().id).filter(|id| !before.contains(id)).collect();
        let general = refined(self.problem, fit.clone(), &added, FOLLOWED, GENERAL.effort(), CLEARLY);
        if general.layout.len() == fit.layout.len() {
            return None;
        }
        tracing::info!(from = fit.cost, to = general.cost, "general form on the whole runs");
        // where the brief runs can't be simulated from there the name keeps the form that it has
        let brief = self.nested(&general).ok()?;
        Some((general, brief))
    }

    /// A fit that leaves more than noise, or a better one of the same names: from where it is, but for the base values that had taken the effects' place before
    /// they were in the model, and from base values that no effect has bent. Far from the noise it is the form or another effect that is missing.
    pub fn sought_from_afar(&self, reached: Fit) -> Result<Fit, SimulationError> {
        let leaves_more = |fit: &Fit| Ok(misfit::left_by(self.problem, fit)? >= MATERIAL);
        let far = reached.cost > FAR * self.problem.targets() as f64;
        if far || !leaves_more(&reached)? {
            return Ok(reached);
        }
        let unbent = reached.layout.unbent(&reached.point.theta);
        let mut led = reached.clone();
        if unbent != led.point.theta {
            led = left_behind(self.problem, led, &unbent);
        }
        if led.cost >= reached.cost || leaves_more(&led)? {
            let mut afar = led.point.theta.clone();
            afar[..self.component.len()].copy_from_slice(self.component);
            led = left_behind(self.problem, led, &afar);
        }
        if led.cost >= reached.cost {
            return Ok(reached);
        }
        // where it can't be linearised it stays where it was led
        let ended = fit(self.problem, &led.layout, led.point.clone(), to_the_end()).unwrap_or(led);
        tracing::info!(from = reached.cost, to = ended.cost, "the names fit better from afar");
        Ok(ended)
    }

    /// A few steps on the whole runs from where a guide lets go of the model. It lets go in several places; a few steps on the brief runs tell which of them
    /// may be better than the `brief` fit, and the best of them is tried.
    fn let_go(&self, lead: &Fit, brief: &Fit) -> Option<Fit> {
        let starts = guided(self.problem, lead, self.component)?.let_go();
        let few = |problem: &Problem, theta: Vec<f64>| fit(problem, &lead.layout, problem.point(theta), FEW).ok();
        let led: Vec<Fit> = starts.into_iter().filter_map(|theta| few(&self.brief, theta)).collect();
        tracing::debug!(brief = brief.cost, costs = ?led.iter().map(|fit| fit.cost).collect::<Vec<_>>(), "the guide lets go");
        let best = led.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        if best.cost < HALFWAY * brief.cost { few(self.problem, best.point.theta) } else { None }
    }
}

/// Brings a fit of the brief runs to the whole ones. More must not come out as worse than the current model: besides the brief
/// fit's own point, the current model's base and that of the component experiments lead with the effect's values, and
/// the one that promises most is brought to its minimum.
pub(super) fn on_the_whole(
    problem: &Problem,
    current: &Fit,
    component: &[f64],
    brief: &Fit,
    to_the_end: Effort,
) -> Option<Fit> {
    lead(problem, current, component, brief).and_then(|lead| ended(problem, current, lead, to_the_end))
}

fn lead(problem: &Problem, current: &Fit, component: &[f64], brief: &Fit) -> Option<Fit> {
    let added = &brief.point.theta[current.point.theta.len()..];
    let from_current = Point {
        theta: current.point.theta.iter().chain(added).copied().collect(),
        initial: current.point.initial.clone(),
    };
    let mut from_component = from_current.clone();
    from_component.theta[..component.len()].copy_from_slice(component);
    from_component.initial.iter_mut().for_each(|values| values.fill(0.0));
    let led = fit(problem, &brief.layout, brief.point.clone(), FEW);
    if let Err(error) = &led {
        tracing::debug!(%error, "a brief fit can't be simulated on the whole runs");
    }
    let mut tried: Vec<Fit> = led.into_iter().collect();
    if tried.first().is_none_or(|fit| fit.cost > current.cost) {
        let more = [from_current, from_component];
        tried.extend(more.into_iter().filter_map(|p| fit(problem, &brief.layout, p, FEW).ok()));
    }
    tried.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// At its minimum; `None` where that is above the current model's.
fn ended(problem: &Problem, current: &Fit, lead: Fit, to_the_end: Effort) -> Option<Fit> {
    // a lead of the same tolerance may have come to its end
    let fit = if lead.converged { lead } else { fit(problem, &lead.layout, lead.point, to_the_end).ok()? };
    tracing::debug!(cost = fit.cost, converged = fit.converged, current = current.cost, "on the whole runs");
    (fit.cost < current.cost).then_some(fit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use crate::diagnose::Declared;
    use model::Parameters;
    use model::effects::find;

    #[test]
    fn a_gross_fit_in_a_false_minimum_is_led_out_of_it_and_the_brief_one_follows() {
        let truth = Parameters::example();
        let friction = find("stribeck_friction").unwrap();
        let runs = [7, 8, 9].map(|seed| dynamic(&truth, Some((friction, vec![1.5, 0.2, 0.02])), 12.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        let component = layout.vector_of(&truth);
        let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
        let base = Declared { problem: &problem, fit: &bent, component: &component };
        let search = Search::new(&[], &base, &|_| ());
        let found = search.start().unwrap();
        let without = search.nested(&bent).unwrap();
        let targets = |problem: &Problem| 1.1 * problem.targets() as f64;
        for start in [[1.0, 0.2, 0.2], [0.5, 0.2, 0.15]] {
            let mut point = without.point.clone();
            point.theta.extend(start);
            let brief = fit(&search.brief, &layout.with(friction), point, Effort::default()).unwrap();
            let seated = search.seated(&found, &bent, &brief, &without).unwrap().unwrap();
            assert!(brief.cost > 3.0 * targets(&search.brief), "a free run finds it as well: {}", brief.cost);
            assert!(seated.fit.cost < targets(&problem), "{start:?}: {}", seated.fit.cost);
            assert!(seated.brief.is_some_and(|led| led.cost < targets(&search.brief)));
        }
    }

    #[test]
    fn a_fit_of_names_in_a_false_minimum_is_found_from_base_values_that_no_effect_has_bent() {
        let truth = Parameters::example();
        let displacement = find("displacement_pressure").unwrap();
        let values = [0.0, -0.35, 0.1];
        let runs = [7, 8, 9].map(|seed| dynamic(&truth, Some((displacement, values.to_vec())), 12.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        let component = layout.vector_of(&truth);
        let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
        let search = Search::new(&[], &Declared { problem: &problem, fit: &bent, component: &component }, &|_| ());
        let layout = layout.with(displacement);
        let mut point = bent.point.clone();
        point.theta.extend(values);
        let cost = problem.cost(&layout, &point);
        let stuck = Fit { layout, point, cost, converged: true };
        let targets = problem.targets() as f64;
        assert!(cost > 2.0 * targets && cost < FAR * targets, "{}", cost / targets);
        let led = search.sought_from_afar(stuck).unwrap();
        assert!(led.cost < 1.1 * targets, "{}", led.cost / targets);
        let again = search.sought_from_afar(led.clone()).unwrap();
        assert_eq!(again.cost, led.cost, "what leaves noise stays");
    }

    #[test]
    fn losses_that_have_taken_a_friction_s_place_are_led_back_from_where_they_are() {
        let truth = Parameters::example();
        let friction = find("pressure_friction").unwrap();
        let runs = [7, 8, 9].map(|seed| dynamic(&truth, Some((friction, vec![1.2, 0.025])), 12.0, seed));
        let (problem, mut layout) = (problem(&runs), layout(&truth));
        layout.base.insert(0, model::parameters::index::L1);
        let component = layout.vector_of(&truth);
        let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
        let named = layout.with(friction);
        let targets = problem.targets() as f64;
        // losses that weaken with speed and turn round late
        let astray = |share: f64| {
            let mut losses = truth.losses;
            losses.l1 -= 9.0 * share;
            losses.l2 += 3.0 * share;
            losses.a += 0.03 * share;
            let theta = [&layout.vector_of(&Parameters { losses, ..truth })[..], &[1.2, 0.025]].concat();
            let point = problem.point(theta);
            Fit { cost: problem.cost(&named, &point), layout: named.clone(), point, converged: true }
        };
        let stuck = (1..=20).map(|n| astray(0.05 * f64::from(n))).find(|fit| fit.cost > 2.0 * targets).unwrap();
        assert!(stuck.cost < FAR * targets, "{}", stuck.cost / targets);
        // the other start is not what leads it here
        let nowhere: Vec<f64> = component.iter().map(|v| -v).collect();
        let from_nowhere = [&nowhere[..], &[1.2, 0.025]].concat();
        assert_eq!(left_behind(&problem, stuck.clone(), &from_nowhere).cost, stuck.cost);
        let search = Search::new(&[], &Declared { problem: &problem, fit: &bent, component: &nowhere }, &|_| ());
        let led = search.sought_from_afar(stuck).unwrap();
        assert!(led.cost < 1.03 * targets, "{}", led.cost / targets);
    }
}
