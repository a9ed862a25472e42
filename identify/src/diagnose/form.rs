//! The form of what is named, at the end.
//!
//! A name is compared in the library's form, and in a general one where that leaves more than noise. Once the names stand, the general forms are asked for
//! whatever is left: what does not show in the runs that were fitted may be much in others. There one start has to do.

use model::integrate::SimulationError;

use super::found::{Name, Step};
use super::refits::{GENERAL, to_the_end};
use super::search::{HELD, Search};
use super::{CONSISTENT, PREFERRED};
use crate::fit::fit;
use crate::forms::{FOLLOWED, refined};
use crate::misfit::{self, Part};
use crate::refit::advantage;

/// Structured residual of a fit (noise floors) that may be a form's where the lever is free: a third of what matters.
const HINT: f64 = 0.03;

/// What a form's parameters, two or three more, take of the cost by chance alone (with probability 0.99): such a form is not asked any further.
const CHANCE: f64 = 11.0;

impl Search<'_> {
    /// The step with each of its names in its general form where that fits the runs better, and data that were left out.
    pub fn in_best_form(&self, step: Step) -> Result<Step, SimulationError> {
        let mut best = step;
        // where angle or pressures are inputs their errors leave something in any case
        let (free, led): (Vec<Part>, _) =
            misfit::parts_left_by(self.problem, &best.fit)?.into_iter().partition(|part| part.free);
        let (free, led) = (misfit::largest(&free), misfit::largest(&led));
        tracing::debug!(free, led, "what may be a form's");
        let followed = if free >= HINT || led >= CONSISTENT { FOLLOWED } else { 1 };
        let ids: Vec<&'static str> = best.ids().into_iter().collect();
        for id in ids {
            let general = refined(self.problem, best.fit.clone(), &[id], followed, GENERAL.effort(), 1.0);
            if general.layout.len() == best.fit.layout.len() || best.fit.cost - general.cost < CHANCE {
                continue;
            }
            // where a form can't be linearised, or simulated without a fold, the name keeps the one that it has
            let Ok(ended) = fit(self.problem, &general.layout, general.point, to_the_end()) else { continue };
            let ended = self.sought_from_afar(ended)?;
            if !ended.are_themselves() {
                continue;
            }
            let Some(effect) = ended.layout.effects.iter().copied().find(|e| e.header().id == id) else { continue };
            let names = best.names.iter().map(|name| match name.effect.header().id == id {
                true => Name { effect, ..name.clone() },
                false => name.clone(),
            });
            let names = names.collect();
            let Ok(other) = self.step(ended, names) else { continue };
            let (_, better) = advantage(&best.residual, &other.residual, &self.clusters, self.count);
            let (_, held) = advantage(&best.held_out, &other.held_out, &self.clusters, self.count);
            let cost = other.fit.cost / best.fit.cost;
            tracing::info!(id, better, held, cost, "general form at the end");
            if better >= PREFERRED && held >= HELD {
                // what the score test says of the step is said of its names
                best = Step { silent: best.silent, ..other };
            }
        }
        Ok(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use crate::diagnose::Declared;
    use crate::fit::Effort;
    use model::Parameters;
    use model::effects::{Effect, find};

    /// Entries of the layout's effects after [`Search::in_best_form`], and what it leaves over what the library's form does, for data with this form.
    fn formed(form: &'static dyn Effect, values: &[f64]) -> (usize, f64) {
        let truth = Parameters::example();
        let plain = find("elastic_hysteresis").unwrap();
        let runs = [7, 8, 9].map(|seed| dynamic(&truth, Some((form, values.to_vec())), 30.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth).with(plain));
        let component = crate::common::layout(&truth).vector_of(&truth);
        let start = problem.point([&component[..], &[0.2, 0.1]].concat());
        let named = fit(&problem, &layout, start, Effort::default()).unwrap();
        let (without, point) = named.without(0);
        let reference = fit(&problem, &without, point, Effort::default()).unwrap();
        let search = Search::new(&[], &Declared { problem: &problem, fit: &reference, component: &component }, &|_| ());
        let name = Name::without_rivals(plain);
        let step = Step { silent: true, ..search.step(named, vec![name]).unwrap() };
        let before = step.fit.cost;
        let best = search.in_best_form(step).unwrap();
        assert!(best.silent, "what was said of the names stays");
        assert_eq!(best.names[0].effect.header().parameters.len(), best.fit.layout.len() - without.len());
        (best.fit.layout.len() - without.len(), best.fit.cost / before)
    }

    #[test]
    fn a_general_form_is_taken_where_the_rig_has_one_and_not_where_it_has_the_library_s() {
        let plain = find("elastic_hysteresis").unwrap();
        let general = plain.refined().unwrap().effect;
        let (entries, cost) = formed(general, &[1.0, 0.15, 3.0, 0.6, 0.3, 0.7, 6.0]);
        assert_eq!(entries, general.header().parameters.len(), "{cost}");
        assert!(cost < 0.999, "{cost}");
        assert_eq!(formed(plain, &[0.3, 0.1]), (2, 1.0));
    }
}
