//! The form of what is named, at the end.
//!
//! A name is compared in the library's form, and in a general one where that leaves more than noise. Once the names stand, the general forms are asked for
//! whatever is left: what is little in the runs that were fitted may be much in others.

use model::integrate::SimulationError;

use super::PREFERRED;
use super::compare::{GENERAL, to_the_end};
use super::search::{HELD, Name, Search, Step};
use crate::fit::fit;
use crate::forms::refined;
use crate::refit::advantage;

impl Search<'_> {
    /// The step with each of its names in its general form where that fits the runs better, and data that were left out.
    pub fn in_best_form(&self, step: Step) -> Result<Step, SimulationError> {
        let mut best = step;
        let ids: Vec<&'static str> = best.ids().into_iter().collect();
        for id in ids {
            let general = refined(self.problem, best.fit.clone(), &[id], GENERAL.effort(), 1.0);
            if general.layout.len() == best.fit.layout.len() {
                continue;
            }
            let ended = fit(self.problem, &general.layout, general.point, to_the_end())?;
            let Some(effect) = ended.layout.effects.iter().copied().find(|e| e.header().id == id) else { continue };
            let names = best.names.iter().map(|name| match name.effect.header().id == id {
                true => Name { effect, ..name.clone() },
                false => name.clone(),
            });
            let names = names.collect();
            let other = self.step(ended, names)?;
            let (_, better) = advantage(&best.residual, &other.residual, &self.clusters, self.count);
            let (_, held) = advantage(&best.held_out, &other.held_out, &self.clusters, self.count);
            let cost = other.fit.cost / best.fit.cost;
            tracing::info!(id, better, held, cost, "general form at the end");
            if better >= PREFERRED && held >= HELD {
                best = other;
            }
        }
        Ok(best)
    }
}
