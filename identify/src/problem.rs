//! A set of stretches with weights: residuals and their derivatives.

use model::integrate::SimulationError;
use rayon::prelude::*;

use crate::guide::Guide;
use crate::kept::Kept;
use crate::layout::Layout;
use crate::plant::Plant;
use crate::plants::rec::REC;
use crate::predict::Initial;
use crate::prepare::{Channel, Stand, Stretch};

/// What is fitted: stretches and the standard deviation of a single sample of each of their channels.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Whose stretches they are.
    pub plant: &'static dyn Plant,
    /// The stretches.
    pub stretches: Vec<Stretch>,
    /// By stretch and [`Channel`]: standard deviation of one sample's noise, in the channel's unit.
    pub std: Vec<Vec<f64>>,
    /// By stretch and [`Channel`]: mean square that the steps of a sensor leave structured, where its noise does not dither
    /// them, in units of `std` squared; 0 for most.
    pub steps: Vec<Vec<f64>>,
    /// The last derivatives at a fit's end.
    pub kept: Kept,
}

/// A point in the space of a fit.
#[derive(Clone, Debug)]
pub struct Point {
    /// In the order of the layout.
    pub theta: Vec<f64>,
    /// Corrections of the initial values, one a stretch.
    pub initial: Vec<Initial>,
}

/// Weighted residuals of one stretch with their derivatives.
#[derive(Clone)]
pub struct Piece {
    /// (measured - predicted) / standard error, one a target.
    pub residual: Vec<f64>,
    /// d predicted / d parameter / standard error, row-major with a column for each parameter and each initial value.
    pub slope: Vec<f64>,
}

impl Default for Problem {
    /// Nothing yet, of the REC rig.
    fn default() -> Self {
        Problem { plant: &REC, stretches: Vec::new(), std: Vec::new(), steps: Vec::new(), kept: Kept::default() }
    }
}

impl Problem {
    /// The plant's channels.
    pub fn channels(&self) -> impl ExactSizeIterator<Item = Channel> + use<> {
        (0..self.plant.header().channels.len() as u8).map(Channel)
    }

    /// Standard error of a target.
    pub fn target_std(&self, stretch: usize, target: usize) -> f64 {
        let t = &self.stretches[stretch].targets[target];
        self.std[stretch][t.channel.index()] / (t.samples as f64).sqrt()
    }

    /// A point with these parameters and uncorrected initial values.
    pub fn point(&self, theta: Vec<f64>) -> Point {
        Point { theta, initial: self.stretches.iter().map(|s| vec![0.0; s.initial.len()]).collect() }
    }

    /// The stretches that `keep` selects.
    pub fn part(&self, keep: impl Fn(usize, &Stretch) -> bool) -> (Problem, Vec<usize>) {
        let chosen: Vec<usize> = (0..self.stretches.len()).filter(|&i| keep(i, &self.stretches[i])).collect();
        let part = Problem {
            plant: self.plant,
            stretches: chosen.iter().map(|&i| self.stretches[i].clone()).collect(),
            std: chosen.iter().map(|&i| self.std[i].clone()).collect(),
            steps: chosen.iter().map(|&i| self.steps[i].clone()).collect(),
            kept: Kept::default(),
        };
        (part, chosen)
    }

    /// The same stretches, those with a free lever no longer than `length_s` each.
    pub fn shortened(&self, length_s: f64) -> Problem {
        let stretches = self.stretches.iter().map(|s| s.shortened(length_s)).collect();
        Problem { stretches, ..self.clone() }
    }

    /// The same, with simulations of a free lever that follow what was measured; `None` where the plant's can't.
    pub fn guided(&self, guide: Guide) -> Option<Problem> {
        let free = |s: &Stretch| (s.stand == Stand::Free).then_some(guide);
        let stretches = self.stretches.iter().map(|s| Stretch { guide: free(s), ..s.clone() }).collect();
        self.plant.can_be_guided().then(|| Problem { stretches, ..self.clone() })
    }

    /// Number of targets.
    pub fn targets(&self) -> usize {
        self.stretches.iter().map(|s| s.targets.len()).sum()
    }

    /// Weighted residuals, stretch by stretch.
    pub fn residuals(&self, layout: &Layout, point: &Point) -> Result<Vec<Vec<f64>>, SimulationError> {
        self.each(|n| self.residual_of(n, layout, &point.theta, &point.initial[n]))
    }

    /// Weighted residuals of one stretch.
    pub(crate) fn residual_of(
        &self,
        n: usize,
        layout: &Layout,
        theta: &[f64],
        initial: &Initial,
    ) -> Result<Vec<f64>, SimulationError> {
        Ok(self.weigh(n, &self.plant.predict(&self.stretches[n], layout, theta, initial)?))
    }

    /// What `of` says of every stretch, on all cores, the longest first so that none waits for it at the end.
    pub(crate) fn each<T: Send>(
        &self,
        of: impl Fn(usize) -> Result<T, SimulationError> + Sync,
    ) -> Result<Vec<T>, SimulationError> {
        let mut order: Vec<usize> = (0..self.stretches.len()).collect();
        order.sort_by_key(|&n| std::cmp::Reverse(self.stretches[n].rows()));
        let done = order.into_iter().par_bridge().map(|n| match of(n) {
            Ok(t) => Ok((n, t)),
            Err(error) => Err(error.in_run(&self.stretches[n].file)),
        });
        let mut done: Vec<(usize, T)> = done.collect::<Result<_, SimulationError>>()?;
        done.sort_by_key(|(n, _)| *n);
        Ok(done.into_iter().map(|(_, t)| t).collect())
    }

    fn weigh(&self, n: usize, predicted: &[f64]) -> Vec<f64> {
        let targets = &self.stretches[n].targets;
        predicted.iter().enumerate().map(|(t, y)| (targets[t].measured - y) / self.target_std(n, t)).collect()
    }

    /// Sum of squares, with what the initial values' priors say.
    pub fn cost_of(&self, residuals: &[Vec<f64>], point: &Point) -> f64 {
        let fit: f64 = residuals.iter().flatten().map(|r| r * r).sum();
        fit + self.prior(point)
    }

    /// The same of linearised pieces.
    pub fn cost_of_pieces(&self, pieces: &[Piece], point: &Point) -> f64 {
        let fit: f64 = pieces.iter().flat_map(|p| &p.residual).map(|r| r * r).sum();
        fit + self.prior(point)
    }

    fn prior(&self, point: &Point) -> f64 {
        point.initial.iter().enumerate().map(|(n, initial)| self.prior_of(n, initial)).sum()
    }

    /// What a stretch's prior says of its initial values.
    pub(crate) fn prior_of(&self, n: usize, initial: &Initial) -> f64 {
        let known = initial.iter().zip(&self.stretches[n].initial_std).filter(|(_, std)| **std > 0.0);
        known.map(|(value, std)| (value / std).powi(2)).sum()
    }

    /// [`Self::cost_of`] at a point; infinite where the model can't be simulated.
    pub fn cost(&self, layout: &Layout, point: &Point) -> f64 {
        self.cost_by_stretch_at(layout, point).iter().sum()
    }

    /// Residuals and derivatives of every stretch.
    pub fn linearise(&self, layout: &Layout, point: &Point) -> Result<Vec<Piece>, SimulationError> {
        self.each(|n| {
            let linear = self.plant.linearise(&self.stretches[n], layout, &point.theta, &point.initial[n])?;
            let columns = layout.len() + point.initial[n].len();
            let residual = self.weigh(n, &linear.predicted);
            let mut slope = linear.slope;
            for (t, row) in slope.chunks_mut(columns).enumerate() {
                let std = self.target_std(n, t);
                row.iter_mut().for_each(|v| *v /= std);
                // what is held has no influence
                layout.held.iter().for_each(|&h| row[h] = 0.0);
            }
            Ok(Piece { residual, slope })
        })
    }

    /// Re-estimates the noise of each run and channel from the fast part of the residuals at a point, where that is larger
    /// than what the channel itself shows (inputs that are measured bring noise of their own). The
    /// pieces are weighed anew.
    pub fn reweigh(&mut self, pieces: &mut [Piece]) {
        let residuals: Vec<Vec<f64>> = pieces.iter().map(|p| p.residual.clone()).collect();
        let factors = self.widen(&residuals);
        for ((piece, factors), s) in pieces.iter_mut().zip(factors).zip(&self.stretches) {
            let columns = piece.slope.len() / s.targets.len().max(1);
            for (t, (r, row)) in piece.residual.iter_mut().zip(piece.slope.chunks_mut(columns.max(1))).enumerate() {
                let factor = factors[s.targets[t].channel.index()];
                *r /= factor;
                row.iter_mut().for_each(|v| *v /= factor);
            }
        }
    }

    /// By stretch and channel: by how much the noise is larger than was thought, which it is from now on.
    fn widen(&mut self, residuals: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut factors = vec![vec![1.0; self.channels().len()]; self.stretches.len()];
        let runs: std::collections::BTreeSet<usize> = self.stretches.iter().map(|s| s.run).collect();
        for run in runs {
            for channel in self.channels() {
                let mut series = Vec::new();
                let members: Vec<usize> = (0..self.stretches.len()).filter(|&n| self.stretches[n].run == run).collect();
                for &n in &members {
                    let targets = &self.stretches[n].targets;
                    series
                        .extend((0..targets.len()).filter(|&t| targets[t].channel == channel).map(|t| residuals[n][t]));
                    series.push(f64::NAN);
                }
                let factor = crate::noise::white_std_of_adjacent(&series).unwrap_or(1.0);
                if factor > 1.1 {
                    for &n in &members {
                        self.std[n][channel.index()] *= factor;
                        factors[n][channel.index()] = factor;
                    }
                }
            }
        }
        factors
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test")]

    use crate::common::{dynamic, layout, problem};
    use model::Parameters;
    use model::effects::empirical::EMPIRICAL;
    use model::effects::find;

    #[test]
    fn more_states_than_can_be_integrated_are_told() {
        let truth = Parameters::example();
        let problem = problem(&[dynamic(&truth, None, 4.0, 7)]);
        let mut layout = layout(&truth);
        let mut theta = layout.vector_of(&truth);
        let general = |id: &str| find(id).unwrap().refined().unwrap().effect;
        for effect in [general("wall_creep"), general("elastic_hysteresis"), general("pressure_lag"), EMPIRICAL[1]] {
            layout = layout.with(effect);
            theta.extend_from_slice(effect.header().starts[0]);
        }
        let point = problem.point(theta);
        let too_many = |error: String| assert!(error.contains("at most 16 states"), "{error}");
        too_many(problem.residuals(&layout, &point).unwrap_err().to_string());
        too_many(problem.linearise(&layout, &point).err().unwrap().to_string());
    }
}
