//! What a fit is worth on data that it was not fitted to, and whether each part of the data asks for the same size of an effect.
//!
//! The clusters of every stretch are divided into folds. The fit is moved by the step that its linearisation asks for when a
//! fold is left out, and predicts that fold. No simulation is needed, and every fold is held out once. Runs with role
//! validate are never used.

use model::integrate::SimulationError;
use nalgebra::{DMatrix, DVector};

use crate::fit::{Fit, covariance};
use crate::prepare::Stand;
use crate::problem::Problem;

/// Folds. Leaving a quarter out hardly weakens what determines a parameter.
const FOLDS: usize = 4;
/// A run speaks of an effect's size where it holds at least this share of what the effect does.
const VOICE: f64 = 0.05;
/// Sizes that runs ask for may differ from the common one by this share: a name is the claim, and another form of the same
/// effect has another strength at other pressures or speeds, but not another sign.
const ALIKE: f64 = 0.6;
/// Standard errors that a difference must have to count.
const CERTAIN: f64 = 3.0;

/// A fit linearised on the whole problem, what the initial values take up left out.
pub(super) struct HoldOut {
    rows: Vec<Vec<f64>>,
    residual: Vec<Vec<f64>>,
    columns: usize,
    folds: Vec<Vec<usize>>,
    runs: Vec<usize>,
    /// Entries that may move.
    free: Vec<usize>,
    first_effect: usize,
}

impl HoldOut {
    /// `clusters`: of each target.
    pub fn of(problem: &Problem, fit: &Fit, clusters: &[Vec<usize>]) -> Result<Self, SimulationError> {
        let columns = fit.layout.len();
        let pieces = problem.linearise(&fit.layout, &fit.point)?;
        let normal = problem.normal(&pieces, columns, &fit.point);
        let rows = pieces
            .iter()
            .enumerate()
            .map(|(s, p)| {
                let std = &problem.stretches[s].initial_std;
                normal.without_initial(s, p, columns, &fit.point.initial[s], std).0
            })
            .collect();
        let bounds = fit.layout.bounds();
        let free = (0..columns)
            .filter(|&i| {
                let (value, (low, high)) = (fit.point.theta[i], bounds[i]);
                normal.matrix[(i, i)] > 0.0 && value > low && value < high
            })
            .collect();
        let residual = pieces.into_iter().map(|p| p.residual).collect();
        let runs = problem.stretches.iter().map(|s| s.run).collect();
        Ok(HoldOut {
            rows,
            residual,
            columns,
            folds: folds(problem, clusters),
            runs,
            free,
            first_effect: fit.layout.base.len(),
        })
    }

    /// Normal matrix and gradient of the free entries over the targets that `keep` selects by stretch and target.
    fn normal(&self, keep: impl Fn(usize, usize) -> bool) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.free.len();
        let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (s, (rows, residual)) in self.rows.iter().zip(&self.residual).enumerate() {
            for (t, (row, r)) in rows.chunks(self.columns).zip(residual).enumerate() {
                if keep(s, t) {
                    for (i, &a) in self.free.iter().enumerate() {
                        let v = row[a];
                        g[i] += v * r;
                        for (j, &b) in self.free[..=i].iter().enumerate() {
                            h[(i, j)] += v * row[b];
                        }
                    }
                }
            }
        }
        h.fill_upper_triangle_with_lower_triangle();
        (h, g)
    }

    /// Residuals of each fold under the fit to the other folds.
    pub fn residuals(&self) -> Vec<Vec<f64>> {
        let parts: Vec<_> = (0..FOLDS).map(|f| self.normal(|s, t| self.folds[s][t] == f)).collect();
        let mut out = self.residual.clone();
        for f in 0..FOLDS {
            let n = self.free.len();
            let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
            for (_, (own_h, own_g)) in parts.iter().enumerate().filter(|(o, _)| *o != f) {
                h += own_h;
                g += own_g;
            }
            let step = damped_inverse(&h) * g;
            for ((rows, out), folds) in self.rows.iter().zip(&mut out).zip(&self.folds) {
                for ((row, r), _) in rows.chunks(self.columns).zip(out).zip(folds).filter(|(_, own)| **own == f) {
                    *r -= self.free.iter().zip(step.iter()).map(|(&i, d)| row[i] * d).sum::<f64>();
                }
            }
        }
        out
    }

    /// Share of what an effect does that sits in runs which ask for another size of it: beyond [`ALIKE`] and certainly so.
    /// `sizes`: its sizes' entries with their values. `clusters` as in [`HoldOut::of`].
    pub fn disagreement(&self, sizes: &[(usize, f64)], clusters: &[Vec<usize>]) -> f64 {
        // what it does beyond what the base could do in its place
        let does: Vec<Vec<f64>> = self
            .rows
            .iter()
            .map(|rows| {
                rows.chunks(self.columns).map(|row| sizes.iter().map(|(i, v)| row[*i] * v).sum::<f64>()).collect()
            })
            .collect();
        let base: Vec<usize> = (0..self.free.len()).filter(|&i| self.free[i] < self.first_effect).collect();
        let (h, _) = self.normal(|_, _| true);
        let h = h.select_rows(&base).select_columns(&base);
        let mut along = DVector::zeros(base.len());
        for (rows, does) in self.rows.iter().zip(&does) {
            for (row, v) in rows.chunks(self.columns).zip(does) {
                for (i, &b) in base.iter().enumerate() {
                    along[i] += row[self.free[b]] * v;
                }
            }
        }
        let taken = damped_inverse(&h) * along;
        let mut by_run: std::collections::BTreeMap<usize, std::collections::BTreeMap<usize, (f64, f64)>> =
            Default::default();
        for (s, (rows, does)) in self.rows.iter().zip(&does).enumerate() {
            for (t, (row, v)) in rows.chunks(self.columns).zip(does).enumerate() {
                let own = v - base.iter().zip(taken.iter()).map(|(&b, d)| row[self.free[b]] * d).sum::<f64>();
                let sums = by_run.entry(self.runs[s]).or_default().entry(clusters[s][t]).or_default();
                sums.0 += own * own;
                sums.1 += own * self.residual[s][t];
            }
        }
        let all: f64 = by_run.values().flat_map(|c| c.values()).map(|c| c.0).sum();
        if all <= 0.0 {
            return 0.0;
        }
        let mut apart = 0.0;
        for (run, clusters) in &by_run {
            let square: f64 = clusters.values().map(|c| c.0).sum();
            if square < VOICE * all {
                continue;
            }
            let off = clusters.values().map(|c| c.1).sum::<f64>() / square;
            let spread = clusters.values().map(|c| (c.1 - off * c.0).powi(2)).sum::<f64>();
            let error = spread.max(square).sqrt() / square;
            tracing::debug!(run, share = square / all, off, error, "size by run");
            if off.abs() > ALIKE && off.abs() > CERTAIN * error {
                apart += square;
            }
        }
        apart / all
    }
}

/// Fold of each target: quarters of each stretch with a free lever, the others by turns.
fn folds(problem: &Problem, clusters: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let mut turn = 0;
    problem
        .stretches
        .iter()
        .zip(clusters)
        .map(|(s, own)| {
            let (first, last) = (own.first().copied().unwrap_or(0), own.last().copied().unwrap_or(0));
            let count = last - first + 1;
            if s.stand == Stand::Free && count >= FOLDS {
                own.iter().map(|c| (c - first) * FOLDS / count).collect()
            } else {
                turn += 1;
                vec![turn % FOLDS; own.len()]
            }
        })
        .collect()
}

/// Inverse of a normal matrix in which directions without any information are held.
fn damped_inverse(h: &DMatrix<f64>) -> DMatrix<f64> {
    covariance(h).map(|v| if v.is_finite() { v } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// One free "run" for each entry of `sizes`: a base parameter of 1 and an effect of the given size in that run, fitted with
    /// one common size. Targets come in clusters of 25.
    fn linear(sizes: &[f64], noise: f64) -> (HoldOut, Vec<Vec<usize>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let count = 500;
        let (mut rows, mut measured, mut clusters, mut folds) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (run, size) in sizes.iter().enumerate() {
            let design: Vec<f64> = (0..2 * count).map(|_| draw()).collect();
            measured.push(design.chunks(2).map(|d| d[0] + size * d[1] + noise * draw()).collect::<Vec<f64>>());
            rows.push(design);
            clusters.push((0..count).map(|t| run * 20 + t / 25).collect::<Vec<_>>());
            folds.push((0..count).map(|t| t * FOLDS / count).collect::<Vec<_>>());
        }
        let mut out = HoldOut {
            rows,
            residual: measured,
            columns: 2,
            folds,
            runs: (0..sizes.len()).collect(),
            free: vec![0, 1],
            first_effect: 1,
        };
        let (h, g) = out.normal(|_, _| true);
        let theta = damped_inverse(&h) * g;
        for (rows, r) in out.rows.iter().zip(&mut out.residual) {
            for (row, r) in rows.chunks(2).zip(r) {
                *r -= row[0] * theta[0] + row[1] * theta[1];
            }
        }
        (out, clusters)
    }

    #[test]
    fn a_fold_is_predicted_as_by_a_fit_without_it() {
        let (h, _) = linear(&[0.5, 0.5], 1.0);
        let held = h.residuals();
        let keep = |s: usize, t: usize| h.folds[s][t] != 2;
        let (a, b) = h.normal(keep);
        let step = a.try_inverse().unwrap() * b;
        let t = h.folds[1].iter().position(|f| *f == 2).unwrap();
        let row = &h.rows[1][2 * t..2 * t + 2];
        let expected = h.residual[1][t] - row[0] * step[0] - row[1] * step[1];
        assert!((held[1][t] - expected).abs() < 1e-9);
        let square = |v: &[Vec<f64>]| v.iter().flatten().map(|r| r * r).sum::<f64>();
        assert!(square(&held) > square(&h.residual), "what is held out is predicted worse");
    }

    #[test]
    fn runs_that_ask_for_other_sizes_disagree_and_others_do_not() {
        let apart = |sizes: &[f64], noise: f64| {
            let (h, clusters) = linear(sizes, noise);
            h.disagreement(&[(1, sizes.iter().sum::<f64>() / sizes.len() as f64)], &clusters)
        };
        assert_eq!(apart(&[0.5, 0.5, 0.5], 0.3), 0.0);
        assert_eq!(apart(&[0.4, 0.5, 0.6], 0.3), 0.0, "another form");
        assert!(apart(&[1.5, -0.3, 0.3], 0.3) > 0.6, "another sign");
        assert!(apart(&[0.05, 0.05, 0.05], 3.0) < 0.4, "noise is no disagreement");
    }
}
