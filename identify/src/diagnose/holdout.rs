//! What a fit is worth on data that it was not fitted to, and whether each part of the data asks for the same size of an effect.
//!
//! The clusters of every stretch are divided into folds. The fit is moved by the step that its linearisation asks for when a
//! fold is left out, and predicts that fold. No simulation is needed, and every fold is held out once. Runs with role
//! validate are never used.

use std::cell::OnceCell;

use model::integrate::SimulationError;
use nalgebra::{DMatrix, DVector};

use crate::fit::Fit;
use crate::normal::covariance;
use crate::prepare::Stand;
use crate::problem::Problem;

/// Folds. Leaving a quarter out hardly weakens what determines a parameter.
const FOLDS: usize = 4;
/// Of what all data say of a direction the other folds must say more than this share, or it counts as known there: where they say nothing (of a stop
/// that only one fold comes to), a fit to them says nothing of it either, and not that the fold is badly predicted.
const KNOWN: f64 = 0.01;
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
    /// Normal matrix and gradient of each fold, once they are asked for.
    by_fold: OnceCell<Vec<(DMatrix<f64>, DVector<f64>)>>,
}

impl HoldOut {
    /// `clusters`: of each target.
    pub fn of(problem: &Problem, fit: &Fit, clusters: &[Vec<usize>]) -> Result<Self, SimulationError> {
        let columns = fit.layout.len();
        let pieces = problem.linearised(&fit.layout, &fit.point)?;
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
        let residual = pieces.iter().map(|p| p.residual.clone()).collect();
        let runs = problem.stretches.iter().map(|s| s.run).collect();
        Ok(HoldOut {
            rows,
            residual,
            columns,
            folds: folds(problem, clusters),
            runs,
            free,
            first_effect: fit.layout.base.len(),
            by_fold: OnceCell::new(),
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

    /// Residuals of the fit to all data.
    pub fn fitted(&self) -> &[Vec<f64>] {
        &self.residual
    }

    /// Residuals of each fold under the fit to the other folds.
    pub fn residuals(&self) -> Vec<Vec<f64>> {
        self.pulled(&[], 0.0)
    }

    /// The same where these entries (with their values) are pulled towards nothing ([`HoldOut::step`]).
    pub fn pulled(&self, entries: &[(usize, f64)], share: f64) -> Vec<Vec<f64>> {
        let of_fold = |f| self.normal(|s, t| self.folds[s][t] == f);
        let parts = self.by_fold.get_or_init(|| (0..FOLDS).map(of_fold).collect());
        let mut out = self.residual.clone();
        let n = self.free.len();
        let all = parts.iter().fold(DMatrix::zeros(n, n), |sum, (h, _)| sum + h);
        for f in 0..FOLDS {
            let (mut h, mut g) = (&all * KNOWN, DVector::zeros(n));
            for (_, (own_h, own_g)) in parts.iter().enumerate().filter(|(o, _)| *o != f) {
                h += own_h;
                g += own_g;
            }
            let step = self.step(h, g, entries, share);
            for ((rows, out), folds) in self.rows.iter().zip(&mut out).zip(&self.folds) {
                for ((row, r), _) in rows.chunks(self.columns).zip(out).zip(folds).filter(|(_, own)| **own == f) {
                    *r -= self.free.iter().zip(step.iter()).map(|(&i, d)| row[i] * d).sum::<f64>();
                }
            }
        }
        out
    }

    /// By how much each entry of the vector moves where these are pulled towards nothing and all data count.
    pub fn moved(&self, entries: &[(usize, f64)], share: f64) -> Vec<f64> {
        let (h, g) = self.normal(|_, _| true);
        let step = self.step(h, g, entries, share);
        let mut out = vec![0.0; self.columns];
        for (&i, d) in self.free.iter().zip(step.iter()) {
            out[i] = *d;
        }
        out
    }

    /// The step of the free entries that data with this normal matrix and gradient ask for, where moving these entries (with their values) away from
    /// nothing costs `share` of the sum of squares of what each does alone: of terms that are nearly alike large ones that cancel are dear.
    fn step(&self, mut h: DMatrix<f64>, mut g: DVector<f64>, entries: &[(usize, f64)], share: f64) -> DVector<f64> {
        for (i, value) in entries {
            if let Some(k) = self.free.iter().position(|free| free == i) {
                let cost = share * h[(k, k)];
                h[(k, k)] += cost;
                g[k] -= cost * value;
            }
        }
        damped_inverse(&h) * g
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
            by_fold: OnceCell::new(),
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
        let ((a, b), (all, _)) = (h.normal(keep), h.normal(|_, _| true));
        let step = (a + all * KNOWN).try_inverse().unwrap() * b;
        let t = h.folds[1].iter().position(|f| *f == 2).unwrap();
        let row = &h.rows[1][2 * t..2 * t + 2];
        let expected = h.residual[1][t] - row[0] * step[0] - row[1] * step[1];
        assert!((held[1][t] - expected).abs() < 1e-9);
        let square = |v: &[Vec<f64>]| v.iter().flatten().map(|r| r * r).sum::<f64>();
        assert!(square(&held) > square(&h.residual), "what is held out is predicted worse");
    }

    /// A parameter acts in the last fold alone, all but a trace.
    #[test]
    fn what_one_fold_alone_tells_is_known_there() {
        let left = |trace: f64| {
            let (mut h, _) = linear(&[0.0], 0.1);
            let quarter = h.residual[0].len() * 3 / FOLDS;
            for (t, row) in h.rows[0].chunks_mut(2).enumerate() {
                row[1] *= if t < quarter { trace } else { 1.0 };
            }
            h.residuals().iter().flatten().map(|r| r * r).sum::<f64>()
        };
        assert!(left(1e-5) < 1.2 * left(1.0), "{} {}", left(1e-5), left(1.0));
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

    /// Two terms that differ by little in what was seen and by much in the last quarter, of which the data ask for the first.
    #[test]
    fn terms_that_are_alike_predict_better_when_they_are_pulled_towards_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let count = 80;
        let mut rows = Vec::new();
        let mut measured = Vec::new();
        for t in 0..count {
            let x = draw();
            let apart = if t < 3 * count / 4 { 0.15 } else { 1.0 };
            rows.extend([x, x + apart * draw()]);
            measured.push(0.5 * x + draw());
        }
        let mut hold_out = HoldOut {
            rows: vec![rows],
            residual: vec![measured],
            columns: 2,
            folds: vec![(0..count).map(|t| t * FOLDS / count).collect()],
            runs: vec![0],
            free: vec![0, 1],
            first_effect: 0,
            by_fold: OnceCell::new(),
        };
        let (h, g) = hold_out.normal(|_, _| true);
        let theta = damped_inverse(&h) * g;
        for (row, r) in hold_out.rows[0].chunks(2).zip(&mut hold_out.residual[0]) {
            *r -= row[0] * theta[0] + row[1] * theta[1];
        }
        let entries = [(0, theta[0]), (1, theta[1])];
        let square = |v: &[Vec<f64>]| v.iter().flatten().map(|r| r * r).sum::<f64>();
        assert_eq!(hold_out.pulled(&entries, 0.0), hold_out.residuals());
        assert!(hold_out.moved(&entries, 0.0).iter().all(|d| d.abs() < 1e-9), "it is the fit");
        let (plain, pulled) = (square(&hold_out.residuals()), square(&hold_out.pulled(&entries, 0.03)));
        assert!(pulled < 0.99 * plain, "{pulled} {plain}");
        let moved = hold_out.moved(&entries, 1e9);
        assert!(entries.iter().all(|(i, value)| (value + moved[*i]).abs() < 1e-6), "pulled to nothing");
    }
}
