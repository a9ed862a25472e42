//! Levenberg-Marquardt on normal equations, within bounds, along valleys that bend.

use model::integrate::SimulationError;
use nalgebra::{DMatrix, DVector};

use crate::bend::{Bend, bend};
use crate::layout::Layout;
use crate::normal::Normal;
use crate::problem::{Piece, Point, Problem};

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
    /// Each step is tried with derivatives at once, on the trust that it is taken: saves a simulation where it is.
    pub ahead: bool,
}

impl Default for Effort {
    fn default() -> Self {
        Effort { iterations: 25, tolerance: 1e-6, promise: f64::INFINITY, creep: 0.0, ahead: false }
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

    /// Parameters of the `n`-th effect.
    pub fn values_of(&self, n: usize) -> &[f64] {
        &self.point.theta[self.layout.first_of(n)..self.layout.first_of(n + 1)]
    }

    /// Every effect is what its name says ([`model::effects::Effect::is_itself`]).
    pub fn are_themselves(&self) -> bool {
        self.layout.effects.iter().enumerate().all(|(n, effect)| effect.is_itself(self.values_of(n)))
    }
}

/// Minimises the problem's cost from `start`, with the linearisation there that the problem may have kept. It keeps that of the end, where the last step was
/// made with one.
pub fn fit(problem: &Problem, layout: &Layout, start: Point, effort: Effort) -> Result<Fit, SimulationError> {
    let known = problem.kept_at(layout, &start).map(|pieces| pieces.to_vec());
    let (fit, pieces) = fit_from(problem, layout, start, effort, known)?;
    if let Some(pieces) = pieces {
        problem.keep(&fit.layout, &fit.point, pieces);
    }
    Ok(fit)
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
    let mut known = known.filter(|_| point.theta == before);
    if known.is_none() && effort.iterations > 0 {
        known = Some(problem.linearise(layout, &point)?);
    }
    let mut cost = match &known {
        Some(pieces) => problem.cost_of_pieces(pieces, &point),
        None => problem.cost_of(&problem.residuals(layout, &point)?, &point),
    };
    // near the minimum already: flat directions must not wait for the damping to fall
    let mut damping = if effort.promise.is_finite() { 1e-7 } else { 1e-3 };
    let mut growth = 2.0;
    let mut converged = false;
    let mut creeping = 0;
    // whether the way is expected to bend
    let mut look = false;
    let mut may_hold = true;
    'outer: for iteration in 0..effort.iterations {
        let pieces = match known.take() {
            Some(pieces) => pieces,
            None => problem.linearise(layout, &point)?,
        };
        let normal = problem.normal(&pieces, layout.len(), &point);
        let active = pushed_out(&point.theta, &bounds, &normal.gradient, &normal.matrix);
        let enough = effort.promise * misfit(problem, cost);
        let of_initial: f64 = normal.promised_by_initial().iter().sum();
        let promised = promised(&normal, &active);
        if enough.is_finite() && promised.is_some_and(|promised| promised < enough) {
            converged = true;
            known = Some(pieces);
            break;
        }
        let mut ahead = effort.ahead;
        let (before, mut rejected) = (damping, 0);
        let mut held = active.clone();
        let before_it = problem.cost_by_stretch(&pieces, &point);
        loop {
            let Some(step) = damped_step(&normal.matrix, &normal.gradient, &held, damping) else {
                damping *= 10.0;
                if damping > 1e12 {
                    break 'outer;
                }
                continue;
            };
            let of_it = |gradient: &_| damped_step(&normal.matrix, gradient, &held, damping);
            let bend = look.then(|| bend(problem, layout, (&point, &pieces, &normal), &step, of_it)).flatten();
            let mut trial = moved(&point, &normal, &step, bend.as_ref(), &bounds);
            let mut trial_pieces = if ahead { problem.linearise(layout, &trial).ok() } else { None };
            let by_stretch = match &trial_pieces {
                Some(pieces) => problem.cost_by_stretch(pieces, &trial),
                None => problem.cost_by_stretch_at(layout, &trial),
            };
            let mut trial_cost: f64 = by_stretch.iter().sum();
            if effort.ahead && trial_pieces.is_none() && trial_cost < cost {
                // at the edge of what can be simulated values may come to their end and their derivatives not: no place to go on from
                trial_pieces = problem.linearise(layout, &trial).ok();
                if trial_pieces.is_none() {
                    trial_cost = f64::INFINITY;
                }
            }
            ahead = false;
            // of the parameters' straight step; the initial values' own is not damped, and says nothing of the damping
            let predicted = 2.0 * normal.gradient.dot(&step) - (step.transpose() * &normal.matrix * &step)[(0, 0)];
            let worth = enough.min(effort.tolerance * cost);
            if trial_cost >= cost
                && let Some(settled) =
                    problem.settled(layout, (&point, &before_it), (&trial, &by_stretch), &normal, worth)
            {
                trial_cost = problem.cost(layout, &settled);
                (trial, trial_pieces) = (settled, None);
            }
            if trial_cost < cost {
                let gain = (cost - trial_cost) / predicted.max(1e-300);
                let relative = (cost - trial_cost) / cost;
                // a step that gained little where much was promised has failed, not arrived
                let little = (effort.tolerance * cost).max(IMMATERIAL * misfit(problem, cost));
                let arrived = relative < effort.tolerance && promised.is_none_or(|promised| promised < little);
                // with the shapes held it is at its minimum: now they move, however little
                let without_shapes = held != active;
                may_hold = !without_shapes || relative > HARDLY;
                point = trial;
                cost = trial_cost;
                known = trial_pieces;
                damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).max(0.1)).max(1e-9);
                growth = 2.0;
                look = if look { bend.is_none_or(|bend| bend.share > SLIGHT) } else { gain < AS_PROMISED };
                if arrived && enough.is_infinite() && !without_shapes {
                    converged = true;
                    break 'outer;
                }
                creeping = if relative < effort.creep && misfit(problem, cost) > FAR { creeping + 1 } else { 0 };
                if creeping >= CREEPING {
                    break 'outer;
                }
                break;
            }
            look = true;
            rejected += 1;
            if may_hold && rejected == REJECTED && held_shapes(&mut held, layout) {
                damping = before;
                continue;
            }
            damping *= growth;
            growth *= 2.0;
            if !may_hold {
                // the shapes spoil a bold step: on the way to a small one the dampings between are not tried
                damping = damping.max(TIMID);
            }
            if predicted + of_initial < worth || damping > 1e10 {
                converged = true;
                known = Some(pieces);
                break 'outer;
            }
        }
        tracing::debug!(iteration, cost, damping, "fit");
    }
    Ok((Fit { layout: layout.clone(), point, cost, converged }, known))
}

/// What the whole step would gain linearly: a damped one promises little along a flat direction, however far its minimum is.
fn promised(normal: &Normal, held: &[bool]) -> Option<f64> {
    let step = damped_step(&normal.matrix, &normal.gradient, held, 1e-13)?;
    Some(normal.gradient.dot(&step) + normal.promised_by_initial().iter().sum::<f64>())
}

/// Cost of the minimum that the slopes at a point promise, without bound below where they promise none; a fit from there goes on with them.
pub fn promised_minimum(problem: &Problem, layout: &Layout, point: &Point) -> Result<f64, SimulationError> {
    let pieces = problem.linearised(layout, point)?;
    let normal = problem.normal(&pieces, layout.len(), point);
    let held = pushed_out(&point.theta, &layout.bounds(), &normal.gradient, &normal.matrix);
    Ok(problem.cost_of_pieces(&pieces, point) - promised(&normal, &held).unwrap_or(f64::INFINITY))
}

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

/// A step with the shapes held that takes less than this share of the cost: at the next one they are not held.
const HARDLY: f64 = 1e-3;

/// Damping from which steps are tried in which shapes that spoil a bold one move.
const TIMID: f64 = 1e-4;

/// What the whole step promises, noise variances, where nothing matters any more that it would gain: no parameter is a third of its standard error from the minimum.
const IMMATERIAL: f64 = 0.1;

/// Holds the effects' shapes; false where all of them are held already.
fn held_shapes(held: &mut [bool], layout: &Layout) -> bool {
    layout.shapes().into_iter().fold(false, |any, i| any | !std::mem::replace(&mut held[i], true))
}

/// A step that gains less than this share of what it promised, or nothing, may have left a valley that bends: it is worth a simulation to know how,
const AS_PROMISED: f64 = 0.75;
/// until a bend is no more than this share of its step.
const SLIGHT: f64 = 0.1;

/// Where a step of the parameters leads, within the bounds, with its bend if that is known. The initial values follow the way that the parameters can go.
pub(crate) fn moved(
    point: &Point,
    normal: &Normal,
    step: &DVector<f64>,
    bend: Option<&Bend>,
    bounds: &[(f64, f64)],
) -> Point {
    let mut out = point.clone();
    for (i, v) in out.theta.iter_mut().enumerate() {
        *v += step[i] + bend.map_or(0.0, |bend| bend.theta[i]);
    }
    clip(&mut out.theta, bounds);
    let taken = DVector::from_iterator(step.len(), out.theta.iter().zip(&point.theta).map(|(a, b)| a - b));
    for (n, (initial, d)) in out.initial.iter_mut().zip(normal.initial_step(&taken)).enumerate() {
        for (i, (value, d)) in initial.iter_mut().zip(d).enumerate() {
            *value += d + bend.map_or(0.0, |bend| bend.initial[n][i]);
        }
    }
    out
}

/// Brings what lies beyond its bounds to them.
pub(crate) fn clip(theta: &mut [f64], bounds: &[(f64, f64)]) {
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
pub(crate) fn damped_step(h: &DMatrix<f64>, g: &DVector<f64>, held: &[bool], damping: f64) -> Option<DVector<f64>> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use model::Parameters;
    use model::effects::find;

    #[test]
    fn a_fit_does_not_end_where_its_shapes_were_held() {
        let mut truth = Parameters::example();
        truth.pump.f1 *= 4.0;
        let rubber = find("end_stop").and_then(|e| e.refined()).unwrap().effect;
        let values = [6.0, 6.0, 18.0, 10.0, 0.0, 0.0, 0.06];
        let runs = [7, 8].map(|seed| dynamic(&truth, Some((rubber, values.to_vec())), 20.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        // a contact that begins late and is hard from there on: bold steps of its shapes lead nowhere
        let start = [&layout.vector_of(&truth)[..], &[20.0, 20.0, 24.0, 1.5, 0.0, 0.0, 0.01]].concat();
        let effort = Effort { iterations: 60, tolerance: 1e-4, ..Effort::default() };
        let found = fit(&problem, &layout.with(rubber), problem.point(start), effort).unwrap();
        let targets = problem.targets() as f64;
        assert!(found.cost < 1.02 * targets, "{} {:?}", found.cost / targets, &found.point.theta[layout.len()..]);
        assert!((found.point.theta[layout.len() + 2] - 18.0).abs() < 0.1);
    }

    /// A contact too hard for bold steps of its shapes: the damping rises, and a step gains less than the tolerance far from the minimum.
    #[test]
    fn a_damped_step_that_gains_little_is_no_arrival_while_the_whole_one_promises_more() {
        let mut truth = Parameters::example();
        truth.pump.f1 *= 4.0;
        let rubber = find("end_stop").and_then(|e| e.refined()).unwrap().effect;
        let values = [6.0, 6.0, 18.0, 10.0, 0.0, 0.0, 0.06];
        let runs = [7, 8].map(|seed| dynamic(&truth, Some((rubber, values.to_vec())), 12.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        let effort = Effort { iterations: 120, tolerance: 1e-3, ..Effort::default() };
        for own in [[20.0, 20.0, 24.0, 1.5, 0.0, 0.0, 0.01], [10.0, 10.0, 22.0, 1.0, 0.0, 0.0, 0.02]] {
            let start = [&layout.vector_of(&truth)[..], &own].concat();
            let found = fit(&problem, &layout.with(rubber), problem.point(start), effort).unwrap();
            let left = found.cost / problem.targets() as f64;
            assert!(found.converged && left < 1.03, "{left} from {own:?}");
        }
    }

    #[test]
    fn slopes_promise_the_minimum_that_a_fit_then_reaches() {
        let truth = Parameters::example();
        let (problem, layout) = (problem(&[dynamic(&truth, None, 12.0, 7)]), layout(&truth));
        let mut beside = problem.point(layout.vector_of(&truth));
        beside.theta[0] *= 1.002;
        let cost = problem.cost(&layout, &beside);
        let promised = promised_minimum(&problem, &layout, &beside).unwrap();
        let reached = fit(&problem, &layout, beside, Effort::default()).unwrap().cost;
        assert!(cost - reached > 5.0, "{cost} {reached}");
        assert!((promised - reached).abs() < 0.2 * (cost - reached), "{cost} promises {promised}: {reached}");
    }
}
