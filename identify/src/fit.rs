//! Levenberg-Marquardt on normal equations, within bounds.
//!
//! Derivatives cost most. They may be carried on over steps that come out as promised ([`crate::secant`]), and are taken anew where one does not, or where the
//! fit would end: what counts as a minimum is one by derivatives of that point.

use model::integrate::SimulationError;
use nalgebra::{DMatrix, DVector};

use crate::layout::Layout;
use crate::problem::{Normal, Piece, Point, Problem};
use crate::secant::carried_on;

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Most linearisations.
    pub iterations: usize,
    /// Relative decrease of the cost below which the minimum counts as reached.
    pub tolerance: f64,
    /// Where it is finite, it decides instead of the tolerance: stop when the whole next step promises less than this share of a noise
    /// variance. A hundredth leaves every parameter within a tenth of its standard error of the minimum, however flat that is.
    pub promise: f64,
    /// Far from the noise a fit creeps that gains less than this share of the cost in each of several steps: it is given up there, not
    /// converged. 0: never.
    pub creep: f64,
    /// Derivatives are carried on over steps that come out as promised: saves time where a fit is near its minimum or led by a guide. Far from it, with
    /// kinks on the way, it saves none, and may lead elsewhere.
    pub secants: bool,
}

impl Default for Effort {
    fn default() -> Self {
        Effort { iterations: 25, tolerance: 1e-6, promise: f64::INFINITY, creep: 0.0, secants: false }
    }
}

/// A fitted point.
#[derive(Clone, Debug)]
pub struct Fit {
    /// What was free.
    pub layout: Layout,
    /// Where it ended.
    pub point: Point,
    /// Weighted sum of squares there.
    pub cost: f64,
    /// The tolerance was reached.
    pub converged: bool,
}

impl Fit {
    /// What is left to fit without the `n`-th effect: its layout, and this point without that effect's values.
    pub fn without(&self, n: usize) -> (Layout, Point) {
        let own = self.layout.first_of(n)..self.layout.first_of(n + 1);
        let mut layout = self.layout.clone();
        layout.effects.remove(n);
        let moved = |i: usize| if i < own.start { Some(i) } else { (i >= own.end).then(|| i - own.len()) };
        layout.held = self.layout.held.iter().filter_map(|&i| moved(i)).collect();
        let mut point = self.point.clone();
        point.theta.drain(own.clone());
        (layout, point)
    }
}

/// Minimises the problem's cost from `start`.
pub fn fit(problem: &Problem, layout: &Layout, start: Point, effort: Effort) -> Result<Fit, SimulationError> {
    fit_from(problem, layout, start, effort, None).map(|(fit, _)| fit)
}

/// As [`fit`], from a start whose linearisation is known already. The second part is that of the fit's end, where it is known.
pub fn fit_from(
    problem: &Problem,
    layout: &Layout,
    start: Point,
    effort: Effort,
    known: Option<Vec<Piece>>,
) -> Result<(Fit, Option<Vec<Piece>>), SimulationError> {
    let bounds = layout.bounds();
    let mut point = start;
    let before = point.theta.clone();
    clip(&mut point.theta, &bounds);
    let mut slopes = known.filter(|_| point.theta == before).map(Slopes::fresh);
    let mut cost = match &slopes {
        Some(known) => problem.cost_of_pieces(&known.pieces, &point),
        None => problem.cost_of(&problem.residuals(layout, &point)?, &point),
    };
    // near the minimum already: flat directions must not wait for the damping to fall
    let mut damping = if effort.promise.is_finite() { 1e-7 } else { 1e-3 };
    let mut growth = 2.0;
    let mut converged = false;
    let (mut creeping, mut iteration) = (0, 0);
    let mut retreat: Option<Retreat> = None;
    'outer: while iteration < effort.iterations {
        let current = match slopes.take() {
            Some(known) => known,
            None => match (problem.linearise(layout, &point), retreat.take()) {
                (Ok(pieces), _) => Slopes::fresh(pieces),
                // at the edge of what can be simulated values may come to their end and their derivatives not: no place to go on from
                (Err(error), Some(back)) if back.damping < MOST_DAMPING => {
                    tracing::debug!(%error, "back to the last point that can be linearised");
                    (point, cost, damping) = (back.point, back.cost, 10.0 * back.damping);
                    Slopes::fresh(back.pieces)
                }
                (Err(error), _) => return Err(error),
            },
        };
        let carried = current.carried;
        let fresh = carried == 0;
        if fresh {
            iteration += 1;
            retreat = Some(Retreat { point: point.clone(), cost, pieces: current.pieces.clone(), damping });
        }
        let normal = problem.normal(&current.pieces, layout.len(), &point);
        let active = pushed_out(&point.theta, &bounds, &normal.gradient, &normal.matrix);
        let enough = effort.promise * misfit(problem, cost);
        if enough.is_finite() {
            // of the whole step: a damped one promises little along a flat direction, however far its minimum is
            let whole = damped_step(&normal.matrix, &normal.gradient, &active, 1e-13);
            if whole.is_some_and(|step| normal.gradient.dot(&step) < enough) {
                if !fresh {
                    continue;
                }
                converged = true;
                slopes = Some(current);
                break;
            }
        }
        let (before, mut rejected) = (damping, 0);
        let mut held = active.clone();
        loop {
            let Some(step) = damped_step(&normal.matrix, &normal.gradient, &held, damping) else {
                damping *= 10.0;
                if damping > 1e12 {
                    break 'outer;
                }
                continue;
            };
            let trial = stepped(&point, &step, &normal, &bounds);
            let residuals = problem.residuals(layout, &trial).unwrap_or_default();
            let trial_cost = if residuals.is_empty() { f64::INFINITY } else { problem.cost_of(&residuals, &trial) };
            let predicted = 2.0 * normal.gradient.dot(&step) - (step.transpose() * &normal.matrix * &step)[(0, 0)];
            if trial_cost < cost {
                let gain = (cost - trial_cost) / predicted.max(1e-300);
                let relative = (cost - trial_cost) / cost;
                let little = relative < effort.tolerance && enough.is_infinite();
                let creeps = relative < effort.creep && misfit(problem, trial_cost) > FAR;
                if effort.secants && carried < CARRIED && gain > AS_PROMISED && !little && !creeps {
                    let pieces = carried_on(current.pieces, &point, &trial, residuals);
                    slopes = Some(Slopes { pieces, carried: carried + 1 });
                }
                point = trial;
                cost = trial_cost;
                damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).max(0.1)).max(1e-9);
                growth = 2.0;
                if !fresh {
                    break;
                }
                if little {
                    converged = true;
                    break 'outer;
                }
                creeping = if creeps { creeping + 1 } else { 0 };
                if creeping >= CREEPING {
                    break 'outer;
                }
                break;
            }
            if !fresh {
                damping = before;
                break;
            }
            rejected += 1;
            if rejected == REJECTED && held_shapes(&mut held, layout) {
                damping = before;
                continue;
            }
            damping *= growth;
            growth *= 2.0;
            if predicted < enough.min(effort.tolerance * cost) || damping > MOST_DAMPING {
                converged = true;
                slopes = Some(current);
                break 'outer;
            }
        }
        tracing::debug!(iteration, carried, cost, damping, "fit");
    }
    let known = slopes.filter(|known| known.carried == 0).map(|known| known.pieces);
    Ok((Fit { layout: layout.clone(), point, cost, converged }, known))
}

/// The point a step further on, within the bounds, with the initial values that go with it.
fn stepped(from: &Point, step: &DVector<f64>, normal: &Normal, bounds: &[(f64, f64)]) -> Point {
    let mut to = from.clone();
    to.theta.iter_mut().zip(step.iter()).for_each(|(value, d)| *value += d);
    clip(&mut to.theta, bounds);
    let taken = DVector::from_iterator(step.len(), to.theta.iter().zip(&from.theta).map(|(a, b)| a - b));
    for (initial, d) in to.initial.iter_mut().zip(normal.initial_step(&taken)) {
        initial.iter_mut().zip(d).for_each(|(value, d)| *value += d);
    }
    to
}

/// A linearisation, fresh or carried on over so many steps.
struct Slopes {
    pieces: Vec<Piece>,
    carried: usize,
}

impl Slopes {
    fn fresh(pieces: Vec<Piece>) -> Self {
        Slopes { pieces, carried: 0 }
    }
}

/// The last point that was linearised, for the case that one further on can't be.
struct Retreat {
    point: Point,
    cost: f64,
    pieces: Vec<Piece>,
    damping: f64,
}

/// Most steps over which derivatives are carried on.
const CARRIED: usize = 3;
/// Share of the promised gain from which on a step came out as promised.
const AS_PROMISED: f64 = 0.9;
/// Damping with which a step leads nowhere.
const MOST_DAMPING: f64 = 1e10;

/// Cost a target (noise alone: 1) from which a fit is far from the noise.
pub(crate) const FAR: f64 = 10.0;
/// Steps in a row that gain little.
const CREEPING: usize = 4;

/// Size of the residuals over that of the noise, squared, at least 1.
fn misfit(problem: &Problem, cost: f64) -> f64 {
    (cost / problem.targets().max(1) as f64).max(1.0)
}

/// After so many steps that lead nowhere the shapes of effects are held for this one: how a gap closes within a millisecond, say, has slopes
/// that no step of the integration resolves, and they spoil the step of everything else.
const REJECTED: usize = 2;

/// Holds the effects' shapes; false where all of them are held already.
fn held_shapes(held: &mut [bool], layout: &Layout) -> bool {
    layout.shapes().into_iter().fold(false, |any, i| any | !std::mem::replace(&mut held[i], true))
}

fn clip(theta: &mut [f64], bounds: &[(f64, f64)]) {
    for (v, (lower, upper)) in theta.iter_mut().zip(bounds) {
        *v = v.clamp(*lower, *upper);
    }
}

/// Entries that stand at a bound and would leave it, and entries without any influence.
fn pushed_out(theta: &[f64], bounds: &[(f64, f64)], gradient: &DVector<f64>, matrix: &DMatrix<f64>) -> Vec<bool> {
    (0..theta.len())
        .map(|i| {
            (theta[i] <= bounds[i].0 && gradient[i] < 0.0)
                || (theta[i] >= bounds[i].1 && gradient[i] > 0.0)
                || matrix[(i, i)] <= 0.0
        })
        .collect()
}

/// Solves (H + damping * diag H) step = gradient for the entries that are not held.
fn damped_step(h: &DMatrix<f64>, g: &DVector<f64>, held: &[bool], damping: f64) -> Option<DVector<f64>> {
    let free: Vec<usize> = (0..g.len()).filter(|&i| !held[i]).collect();
    let n = free.len();
    let scale: Vec<f64> = free.iter().map(|&i| h[(i, i)].sqrt()).collect();
    let a = DMatrix::from_fn(n, n, |i, j| {
        h[(free[i], free[j])] / (scale[i] * scale[j]) + if i == j { damping } else { 0.0 }
    });
    let b = DVector::from_fn(n, |i, _| g[free[i]] / scale[i]);
    let x = a.cholesky()?.solve(&b);
    let mut step = DVector::zeros(g.len());
    for (i, &at) in free.iter().enumerate() {
        step[at] = x[i] / scale[i];
    }
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// Covariance of the parameters from the normal matrix; `None` entries (no influence) get an infinite variance.
pub fn covariance(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    let scale: Vec<f64> = (0..n).map(|i| matrix[(i, i)].max(0.0).sqrt()).collect();
    let correlation = DMatrix::from_fn(n, n, |i, j| {
        if scale[i] > 0.0 && scale[j] > 0.0 {
            matrix[(i, j)] / (scale[i] * scale[j])
        } else if i == j {
            1.0
        } else {
            0.0
        }
    });
    let eigen = correlation.symmetric_eigen();
    let inverse = DMatrix::from_fn(n, n, |i, j| {
        (0..n)
            .map(|k| {
                let value = eigen.eigenvalues[k].max(1e-14);
                eigen.eigenvectors[(i, k)] * eigen.eigenvectors[(j, k)] / value
            })
            .sum::<f64>()
    });
    DMatrix::from_fn(n, n, |i, j| {
        if scale[i] > 0.0 && scale[j] > 0.0 {
            inverse[(i, j)] / (scale[i] * scale[j])
        } else if i == j {
            f64::INFINITY
        } else {
            0.0
        }
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::common::{dynamic, layout, problem};
    use crate::plant::{Plant, PlantHeader};
    use crate::plants::rec::REC;
    use crate::predict::Linear;
    use crate::prepare::Stretch;
    use model::Parameters;

    /// The rig, whose linearisations and simulations of a stretch are counted, and which has none of the first where its first parameter is beyond an edge.
    struct Counted {
        linearisations: AtomicUsize,
        simulations: AtomicUsize,
        edge: f64,
    }

    impl Counted {
        /// It lives as long as the tests.
        fn rig(edge: f64) -> &'static Counted {
            Box::leak(Box::new(Counted { linearisations: AtomicUsize::new(0), simulations: AtomicUsize::new(0), edge }))
        }

        fn count(&self) -> (usize, usize) {
            (self.linearisations.load(Ordering::Relaxed), self.simulations.load(Ordering::Relaxed))
        }
    }

    impl Plant for Counted {
        fn header(&self) -> &'static PlantHeader {
            REC.header()
        }

        fn cluster_s(&self, stretch: &Stretch) -> Option<f64> {
            REC.cluster_s(stretch)
        }

        fn complete_values(&self, k: &mut [f64]) {
            REC.complete_values(k);
        }

        fn predict(
            &self,
            s: &Stretch,
            l: &Layout,
            theta: &[f64],
            initial: &[f64],
        ) -> Result<Vec<f64>, SimulationError> {
            self.simulations.fetch_add(1, Ordering::Relaxed);
            REC.predict(s, l, theta, initial)
        }

        fn linearise(
            &self,
            s: &Stretch,
            l: &Layout,
            theta: &[f64],
            initial: &[f64],
        ) -> Result<Linear, SimulationError> {
            self.linearisations.fetch_add(1, Ordering::Relaxed);
            if theta[0] > self.edge {
                Err(SimulationError::NotFinite { time_s: 0.0 })
            } else {
                REC.linearise(s, l, theta, initial)
            }
        }

        fn rows(
            &self,
            s: &Stretch,
            l: &Layout,
            theta: &[f64],
            initial: &[f64],
        ) -> Result<Vec<Vec<f64>>, SimulationError> {
            REC.rows(s, l, theta, initial)
        }
    }

    /// The fit of a rig's recordings, from so many times the true base values; and its targets.
    fn fitted(plant: &'static Counted, times: f64) -> (Fit, usize) {
        let truth = Parameters::example();
        let runs = [7, 8].map(|seed| dynamic(&truth, None, 12.0, seed));
        let problem = Problem { plant, ..problem(&runs) };
        let layout = layout(&truth);
        let start = problem.point(layout.vector_of(&truth).iter().map(|v| times * v).collect());
        let effort = Effort { secants: true, ..Effort::default() };
        (fit(&problem, &layout, start, effort).unwrap(), problem.targets())
    }

    #[test]
    fn derivatives_are_carried_on_over_steps_and_lead_to_the_minimum() {
        let rig = Counted::rig(f64::INFINITY);
        let (there, targets) = fitted(rig, 0.9);
        let (linearisations, simulations) = rig.count();
        assert!(there.converged && there.cost < 1.1 * targets as f64, "{} {targets}", there.cost);
        assert!(simulations > linearisations + 2, "{simulations} simulations, {linearisations} linearisations");
        // from the minimum on, with derivatives of its own, nothing is gained
        let (again, _) = fitted(Counted::rig(f64::INFINITY), 1.0);
        assert!((there.cost / again.cost - 1.0).abs() < 1e-5, "{} {}", there.cost, again.cost);
    }

    #[test]
    fn a_point_that_cannot_be_linearised_is_stepped_back_from() {
        let m2 = Parameters::example().torque.m2;
        let (start, edge) = (1.1 * m2, 1.03 * m2);
        assert!(
            start < edge && fitted(Counted::rig(f64::INFINITY), 1.1).0.point.theta[0] > edge,
            "the edge is on the way"
        );
        let stopped = fitted(Counted::rig(edge), 1.1).0.point.theta[0];
        assert!(start < stopped && stopped <= edge, "{start} {stopped} {edge}");
    }
}
