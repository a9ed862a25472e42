//! The candidates of one round, tested against the current model.

use std::sync::OnceLock;

use model::effects::Effect;
use model::integrate::SimulationError;
use rayon::prelude::*;

use super::refits::guided;
use super::search::Search;
use super::under_guide::UnderGuide;
use crate::fit::Fit;
use crate::guided::Guided;
use crate::problem::Problem;
use crate::score::{Direction, Gram, Scene};
use crate::significance::p_of_largest;

/// A round of candidates at the current model.
pub(super) struct Round<'a> {
    pub scene: Scene<'a>,
    pub directions: Vec<Direction>,
    pub gram: Gram,
    guided: OnceLock<Option<Guided>>,
    under_guide: OnceLock<Option<UnderGuide>>,
}

impl<'a> Round<'a> {
    pub fn new(
        problem: &'a Problem,
        fit: &'a Fit,
        candidates: impl Iterator<Item = &'static dyn Effect>,
    ) -> Result<Self, SimulationError> {
        let scene = Scene::new(problem, fit)?;
        let directions: Vec<Direction> = candidates.flat_map(|e| scene.directions(e)).collect();
        Ok(Self::with(scene, directions))
    }

    /// With each candidate's usual direction alone: enough to say whether a balance is at peace.
    pub fn usual(
        problem: &'a Problem,
        fit: &'a Fit,
        candidates: &[&'static dyn Effect],
    ) -> Result<Self, SimulationError> {
        let scene = Scene::new(problem, fit)?;
        let directions = candidates.par_iter().filter_map(|e| scene.usual_direction(*e)).collect();
        Ok(Self::with(scene, directions))
    }

    fn with(scene: Scene<'a>, directions: Vec<Direction>) -> Self {
        let gram = Gram::new(&directions);
        Round { scene, directions, gram, guided: OnceLock::new(), under_guide: OnceLock::new() }
    }

    /// The current model where its simulation follows what was measured; `None` where the plant's can't be guided.
    pub fn guided(&self, search: &Search) -> Option<&Guided> {
        self.guided.get_or_init(|| guided(search.problem, self.scene.fit, search.component)).as_ref()
    }

    /// What the effects that the current model lacks take away linearly under its guide; `None` where the plant's can't be guided.
    pub fn under_guide(&self, search: &Search) -> Result<Option<UnderGuide>, SimulationError> {
        if let Some(known) = self.under_guide.get() {
            return Ok(known.clone());
        }
        let asked = match self.guided(search) {
            Some(guided) => UnderGuide::of(guided, &search.open(self.scene.fit))?,
            None => None,
        };
        Ok(self.under_guide.get_or_init(|| asked).clone())
    }

    /// Positions of an effect's directions that may be used, the best first.
    pub fn of(&self, id: &str) -> Vec<usize> {
        let mut out: Vec<usize> = (0..self.directions.len())
            .filter(|&i| self.directions[i].effect.header().id == id && self.directions[i].gain() > 0.0)
            .collect();
        out.sort_by(|a, b| self.directions[*b].gain().total_cmp(&self.directions[*a].gain()));
        out
    }

    /// Part of the cost that these effects together take away, linearly.
    pub fn gain_of(&self, set: &[&'static dyn Effect]) -> f64 {
        self.gram.gain(&set.iter().flat_map(|e| self.of(e.header().id)).collect::<Vec<_>>())
    }

    /// Share of one effect's best direction that another's hold: nearly all where the two look alike; `None` where the one has no direction.
    pub fn share_held(&self, id: &str, other: &str) -> Option<f64> {
        let own = *self.of(id).first()?;
        let held = self.gram.share_held(own, &self.every(other));
        tracing::debug!(id, other, held, "angle");
        Some(held)
    }

    /// Positions of all directions of an effect.
    pub fn every(&self, id: &str) -> Vec<usize> {
        (0..self.directions.len()).filter(|&i| self.directions[i].effect.header().id == id).collect()
    }

    /// By how many standard errors of the noise each candidate would show, by the direction that shows most.
    pub fn shows(&self) -> Vec<(&'static str, f64)> {
        let mut out: Vec<(&'static str, f64)> = Vec::new();
        for d in &self.directions {
            let (id, shows) = (d.effect.header().id, d.square.sqrt());
            match out.iter_mut().find(|(own, _)| *own == id) {
                Some((_, most)) => *most = most.max(shows),
                None => out.push((id, shows)),
            }
        }
        out
    }

    /// p-value of the largest statistic among the directions of these effects.
    pub fn p_value(&self, keep: impl Fn(&Direction) -> bool) -> f64 {
        let chosen: Vec<&Direction> = self.directions.iter().filter(|d| keep(d)).collect();
        let evidence: Vec<_> = chosen.iter().map(|d| self.scene.by_cluster(d)).collect();
        let one_sided: Vec<bool> =
            chosen.iter().map(|d| d.effect.header().parameters.iter().all(|p| !p.size || p.lower >= 0.0)).collect();
        p_of_largest(&evidence, &one_sided, 20)
    }

    /// Sets of one effect out of `candidates`, and the best of two where two together explain far more than either, the best first.
    pub fn shortlist(&self, candidates: &[&'static dyn Effect], most: usize) -> Vec<Vec<&'static dyn Effect>> {
        let mut singles: Vec<(f64, usize)> =
            candidates.iter().enumerate().map(|(n, e)| (self.gain_of(&[*e]), n)).filter(|(g, _)| *g > 0.0).collect();
        singles.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(&(top, _)) = singles.first() else { return Vec::new() };
        let mut out: Vec<Vec<&'static dyn Effect>> = singles
            .iter()
            .take(most)
            .enumerate()
            .filter(|(i, (g, _))| *i < 3 || *g > 0.2 * top)
            .map(|(_, (_, n))| vec![candidates[*n]])
            .collect();
        // a gross misfit in a few clusters misleads the gain: the two that most clusters agree on are tried as well
        let mut agreed: Vec<(f64, usize)> = (0..candidates.len())
            .map(|n| {
                let own = self.of(candidates[n].header().id);
                let most = own.iter().map(|&i| self.scene.by_cluster(&self.directions[i]).agreement());
                (most.fold(0.0, f64::max), n)
            })
            .collect();
        agreed.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, n) in agreed.into_iter().take(2) {
            if !out.iter().any(|set| set[0].header().id == candidates[n].header().id) {
                out.push(vec![candidates[n]]);
            }
        }
        let mut pair: Option<(f64, usize, usize)> = None;
        for i in 0..candidates.len() {
            for j in 0..i {
                let both = [self.of(candidates[i].header().id), self.of(candidates[j].header().id)].concat();
                let gain = self.gram.gain(&both);
                if pair.is_none_or(|(g, _, _)| gain > g) {
                    pair = Some((gain, i, j));
                }
            }
        }
        if let Some((gain, i, j)) = pair
            && gain > 1.5 * top
        {
            out.push(vec![candidates[i], candidates[j]]);
        }
        out
    }
}
