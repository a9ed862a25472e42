//! Which candidate could explain the residual: score tests, orthogonal to everything that is fitted already.
//!
//! A candidate's direction is a secant: the change of the predictions when the effect is added at one of its starts. What the
//! base parameters and the initial values could do as well is projected out. The residual is coloured, so significance is
//! never taken from single samples but from sums over clusters of several seconds.

use std::sync::Arc;

use model::effects::{Effect, empirical};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::fit::Fit;
use crate::layout::Layout;
use crate::normal::covariance;
use crate::normal::{Normal, take_moved};
use crate::predict::Initial;
use crate::problem::{Piece, Point, Problem};

/// A model with its residual and derivatives, ready to test candidates against.
pub struct Scene<'a> {
    problem: &'a Problem,
    /// What was linearised.
    pub fit: &'a Fit,
    pub(crate) pieces: Arc<Vec<Piece>>,
    pub(crate) normal: Normal,
    inverse: DMatrix<f64>,
    /// The residual with everything fitted projected out.
    pub residual: Vec<Vec<f64>>,
    /// Cluster of each target, stretch by stretch.
    pub clusters: Vec<Vec<usize>>,
    /// Number of clusters.
    pub cluster_count: usize,
}

/// One direction of a candidate.
pub struct Direction {
    /// The candidate, or its general form where that is of another kind ([`model::effects::Refined::screened`]).
    pub effect: &'static dyn Effect,
    /// The parameters at which the secant was taken.
    pub start: Vec<f64>,
    /// The secant as it is: what the surrogates are drawn of, so that they pass the same projection.
    pub raw: Vec<Vec<f64>>,
    /// The secant, orthogonal to everything fitted, stretch by stretch.
    pub secant: Vec<Vec<f64>>,
    /// secant . secant
    pub square: f64,
    /// secant . residual
    pub with_residual: f64,
}

impl Direction {
    /// By how much the start has to be scaled to explain the residual best.
    pub fn scale(&self) -> f64 {
        self.with_residual / self.square
    }

    /// Reduction of the cost along this direction; 0 where only an unphysical sign would reduce it.
    pub fn gain(&self) -> f64 {
        let one_sided = self.effect.header().parameters.iter().all(|p| !p.size || p.lower >= 0.0);
        if self.square <= 0.0 || (one_sided && self.with_residual <= 0.0) {
            0.0
        } else {
            self.with_residual * self.with_residual / self.square
        }
    }
}

impl<'a> Scene<'a> {
    /// Linearises the fit.
    pub fn new(problem: &'a Problem, fit: &'a Fit) -> Result<Self, model::integrate::SimulationError> {
        let pieces = problem.linearised(&fit.layout, &fit.point)?;
        let normal = problem.normal(&pieces, fit.layout.len(), &fit.point);
        Ok(Self::of(problem, fit, pieces, normal))
    }

    /// Of a fit that is linearised already.
    pub fn of(problem: &'a Problem, fit: &'a Fit, pieces: Arc<Vec<Piece>>, normal: Normal) -> Self {
        let inverse = covariance(&normal.matrix).map(|v| if v.is_finite() { v } else { 0.0 });
        let (clusters, cluster_count) = clusters(problem);
        let mut scene = Scene { problem, fit, pieces, normal, inverse, residual: Vec::new(), clusters, cluster_count };
        let raw: Vec<Vec<f64>> = scene.pieces.iter().map(|p| p.residual.clone()).collect();
        scene.residual = scene.orthogonal(raw);
        scene
    }

    /// Removes from a vector of targets what parameters and initial values can produce.
    fn orthogonal(&self, mut v: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let (step, initial) = self.produced_by(&v);
        take_moved(&mut v, &self.pieces, &step, &initial);
        v
    }

    /// The change of parameters and initial values that comes nearest to a vector of targets.
    fn produced_by(&self, v: &[Vec<f64>]) -> (DVector<f64>, Vec<Initial>) {
        let (reduced, inner) = self.normal.gradient_of(&self.pieces, v);
        let step = &self.inverse * reduced;
        let initial = self.normal.back(&step, &inner);
        (step, initial)
    }

    /// The fit with effects of these values added, and what was fitted moved so that, linearly, it takes back what it can of what they do: where the data
    /// know the sum alone, an effect comes in at the expense of what had taken it up. `layout`: the fit's with the effects; `None` where they can't be
    /// simulated.
    pub fn taken_back(&self, layout: &Layout, values: &[f64]) -> Option<Point> {
        let mut point = self.fit.point.clone();
        point.theta.extend_from_slice(values);
        let (step, initial) = self.produced_by(&self.change(layout, &point)?);
        for ((value, d), (lower, upper)) in point.theta.iter_mut().zip(step.iter()).zip(layout.bounds()) {
            *value = (*value - d).clamp(lower, upper);
        }
        for (values, d) in point.initial.iter_mut().zip(&initial) {
            values.iter_mut().zip(d).for_each(|(value, d)| *value -= d);
        }
        Some(point)
    }

    /// By how much the predictions at a point lie above those of the fit, in standard errors.
    fn change(&self, layout: &Layout, point: &Point) -> Option<Vec<Vec<f64>>> {
        let with = self.problem.residuals(layout, point).ok()?;
        let base = self.pieces.iter().map(|p| &p.residual);
        Some(base.zip(&with).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect())
    }

    /// The directions of a candidate; those that can't be simulated or do nothing are left out.
    pub fn directions(&self, effect: &'static dyn Effect) -> Vec<Direction> {
        if empirical::is_nameless(effect) {
            return self.term_directions(effect);
        }
        let own = effect.header().starts.iter().map(|start| (effect, *start));
        let general = effect.refined().into_iter().flat_map(|r| r.screened.iter().map(move |start| (r.effect, *start)));
        let places: Vec<(&'static dyn Effect, &[f64])> = own.chain(general).collect();
        places.into_par_iter().filter_map(|(form, start)| self.direction(form, start)).collect()
    }

    /// The directions of a sum of terms, each at its usual size: a sum is linear, so all of them follow from its slopes at nothing.
    fn term_directions(&self, effect: &'static dyn Effect) -> Vec<Direction> {
        let layout = self.fit.layout.with(effect);
        let first = self.fit.layout.len();
        let mut point = self.fit.point.clone();
        point.theta.resize(layout.len(), 0.0);
        let Ok(pieces) = self.problem.linearise(&layout, &point) else { return Vec::new() };
        let of_term = |(term, start): (usize, &&[f64])| {
            let change = |(piece, initial): (&Piece, &Initial)| {
                let rows = piece.slope.chunks(layout.len() + initial.len());
                rows.map(|row| row[first + term] * start[term]).collect()
            };
            self.along(effect, start, pieces.iter().zip(&point.initial).map(change).collect())
        };
        effect.header().starts.par_iter().enumerate().filter_map(of_term).collect()
    }

    /// The first direction of a candidate, its usual one.
    pub fn usual_direction(&self, effect: &'static dyn Effect) -> Option<Direction> {
        self.direction(effect, effect.header().starts.first()?)
    }

    /// The direction of a candidate with these parameters; `None` where it can't be simulated or does nothing.
    pub fn direction(&self, effect: &'static dyn Effect, start: &[f64]) -> Option<Direction> {
        let layout = self.fit.layout.with(effect);
        let mut point = self.fit.point.clone();
        point.theta.extend_from_slice(start);
        self.along(effect, start, self.change(&layout, &point)?)
    }

    /// A direction along a given change of the predictions (in standard errors, target by target), orthogonal to everything
    /// that is fitted; `None` where nothing is left of it.
    pub fn along(&self, effect: &'static dyn Effect, start: &[f64], raw: Vec<Vec<f64>>) -> Option<Direction> {
        let secant = self.orthogonal(raw.clone());
        let square = dot(&secant, &secant);
        let with_residual = dot(&secant, &self.residual);
        let start = start.to_vec();
        (square.is_finite() && square > 1e-6).then_some(Direction { effect, start, raw, secant, square, with_residual })
    }

    /// By how much the start of a direction has to be scaled to explain the residual best, and the standard error of that: the
    /// larger of what independent residuals give and of what the sums over clusters say.
    pub fn asked_for(&self, d: &Direction) -> (f64, f64) {
        let scale = d.scale();
        let n = self.cluster_count;
        let (mut sums, mut squares) = (vec![0.0; n], vec![0.0; n]);
        for ((s, r), c) in d.secant.iter().zip(&self.residual).zip(&self.clusters) {
            for ((s, r), c) in s.iter().zip(r).zip(c) {
                sums[*c] += s * (r - scale * s);
                squares[*c] += s * s;
            }
        }
        let pull = |c: usize| 1.0 - (squares[c] / d.square).min(0.95);
        let meat: f64 = (0..n).map(|c| sums[c] * sums[c] / pull(c)).sum();
        (scale, d.square.max(meat).sqrt() / d.square)
    }

    /// Secant times residual by cluster: the sums, and their cosines. A cosine is bounded, so that a cluster with a large
    /// misfit has no more than one voice.
    pub fn by_cluster(&self, d: &Direction) -> Evidence {
        let n = self.cluster_count;
        let (mut sums, mut secant, mut residual) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        for ((s, r), c) in d.secant.iter().zip(&self.residual).zip(&self.clusters) {
            for ((s, r), c) in s.iter().zip(r).zip(c) {
                sums[*c] += s * r;
                secant[*c] += s * s;
                residual[*c] += r * r;
            }
        }
        let cosines = (0..n)
            .map(|c| {
                let norm: f64 = (secant[c] * residual[c]).sqrt();
                if norm > 0.0 { sums[c] / norm } else { 0.0 }
            })
            .collect();
        Evidence { sums, cosines }
    }
}

/// What each cluster says of a direction.
pub struct Evidence {
    /// Secant times residual.
    pub sums: Vec<f64>,
    /// The same over both norms, between -1 and 1.
    pub cosines: Vec<f64>,
}

impl Evidence {
    /// Total of the cosines in standard errors.
    pub fn agreement(&self) -> f64 {
        let norm = self.cosines.iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm > 0.0 { self.cosines.iter().sum::<f64>() / norm } else { 0.0 }
    }
}

/// Clusters of targets: pieces of [`crate::plant::Plant::cluster_s`], or whole stretches.
pub fn clusters(problem: &Problem) -> (Vec<Vec<usize>>, usize) {
    let mut count = 0;
    let mut out = Vec::new();
    for s in &problem.stretches {
        let length_s = problem.plant.cluster_s(s);
        let first = s.time_s[0];
        let of = |t: f64| length_s.map_or(0, |l| ((t - first) / l) as usize);
        out.push(s.targets.iter().map(|t| count + of(t.time_s)).collect());
        count += 1 + of(s.time_s[s.rows() - 1]);
    }
    (out, count)
}

/// Scalar product over all targets.
pub fn dot(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()).sum()
}

/// Gram matrix of directions and their products with the residual.
pub struct Gram {
    matrix: DMatrix<f64>,
    with_residual: DVector<f64>,
}

impl Gram {
    /// Of all directions.
    pub fn new(directions: &[Direction]) -> Self {
        let n = directions.len();
        let pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
        let products: Vec<f64> =
            pairs.par_iter().map(|&(i, j)| dot(&directions[i].secant, &directions[j].secant)).collect();
        let mut matrix = DMatrix::zeros(n, n);
        for (&(i, j), p) in pairs.iter().zip(products) {
            matrix[(i, j)] = p;
            matrix[(j, i)] = p;
        }
        Gram { matrix, with_residual: DVector::from_iterator(n, directions.iter().map(|d| d.with_residual)) }
    }

    /// Reduction of the cost when all of these directions may be used together.
    pub fn gain(&self, chosen: &[usize]) -> f64 {
        let n = chosen.len();
        if n == 0 {
            return 0.0;
        }
        let scale: Vec<f64> = chosen.iter().map(|&i| self.matrix[(i, i)].sqrt()).collect();
        let m = DMatrix::from_fn(n, n, |i, j| self.matrix[(chosen[i], chosen[j])] / (scale[i] * scale[j]));
        let b = DVector::from_fn(n, |i, _| self.with_residual[chosen[i]] / scale[i]);
        let eigen = m.symmetric_eigen();
        let along = eigen.eigenvectors.transpose() * b;
        // directions that are the same but for curvature must not be combined into a difference of large numbers
        along.iter().zip(eigen.eigenvalues.iter()).filter(|(_, l)| **l > 1e-3).map(|(a, l)| a * a / l).sum()
    }

    /// Share of a direction, squared, that lies in the span of others.
    pub fn share_held(&self, one: usize, by: &[usize]) -> f64 {
        let n = by.len();
        if n == 0 {
            return 0.0;
        }
        let norm = |i: usize| self.matrix[(i, i)].sqrt();
        let m = DMatrix::from_fn(n, n, |i, j| self.matrix[(by[i], by[j])] / (norm(by[i]) * norm(by[j])));
        let b = DVector::from_fn(n, |i, _| self.matrix[(by[i], one)] / (norm(by[i]) * norm(one)));
        let eigen = m.symmetric_eigen();
        let along = eigen.eigenvectors.transpose() * b;
        along.iter().zip(eigen.eigenvalues.iter()).filter(|(_, l)| **l > 1e-3).map(|(a, l)| a * a / l).sum()
    }

    /// Cosine between two directions.
    pub fn cosine(&self, i: usize, j: usize) -> f64 {
        self.matrix[(i, j)] / (self.matrix[(i, i)] * self.matrix[(j, j)]).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};

    #[test]
    fn what_terms_do_by_their_slopes_they_do_at_their_usual_sizes() {
        let truth = model::Parameters::example();
        let problem = problem(&[dynamic(&truth, None, 6.0, 5)]);
        let layout = layout(&truth);
        let point = problem.point(layout.vector_of(&truth));
        let fit = Fit { layout, point, cost: 0.0, converged: true };
        let scene = Scene::new(&problem, &fit).expect("it can be simulated");
        for set in empirical::EMPIRICAL {
            let by_slopes = scene.directions(set);
            let mut alike = 0;
            for linear in &by_slopes {
                let secant = scene.direction(set, &linear.start).expect("what has a slope does something");
                let off: Vec<Vec<f64>> = (linear.raw.iter().zip(&secant.raw))
                    .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect())
                    .collect();
                let share = (dot(&off, &off) / dot(&secant.raw, &secant.raw)).sqrt();
                // a lever that comes to rest a moment earlier is no matter of slopes
                assert!(share < 0.5, "{}, {:?}: {share}", set.header().id, linear.start);
                alike += usize::from(share < 0.05);
            }
            assert!(2 * alike > set.header().parameters.len(), "{}: {alike} alike", set.header().id);
        }
    }
}
