//! Refits of a round's candidates, and how they compare.

use model::effects::Effect;
use model::effects::empirical::EMPIRICAL;
use model::integrate::SimulationError;

use super::round::Round;
use super::{Declared, PREFERRED, Ranked};
use crate::fit::{Effort, Fit};
use crate::problem::Problem;
use crate::refit::{Bases, Refit, advantage, refit};
use crate::score::Direction;

/// Above this cost a target no candidate has come near the data, and polishing them is in vain.
const POOR: f64 = 20.0;
/// A rival explains at least this share of what the best candidate does.
const RIVAL: f64 = 0.95;

/// Refits each set of the shortlist; the lowest cost first.
pub(super) fn refit_all(
    problem: &Problem,
    bases: &Bases,
    round: &Round,
    shortlist: &[Vec<&'static dyn Effect>],
    progress: &dyn Fn(&str),
) -> Vec<Refit> {
    let mut out: Vec<Refit> = Vec::new();
    for set in shortlist {
        let best = out.iter().map(|r| r.fit.cost).fold(f64::INFINITY, f64::min);
        let added: Vec<(&'static dyn Effect, Vec<&Direction>)> = set
            .iter()
            .map(|e| (*e, round.of(e.header().id).into_iter().map(|i| &round.directions[i]).collect()))
            .collect();
        let effort = Effort {
            iterations: if bases.gross { 7 } else { 10 },
            tolerance: 3e-4,
            hopeless_above: best * 1.5,
            patience: 2,
            ..Effort::default()
        };
        if let Some(r) = refit(problem, bases, &added, effort) {
            let names: Vec<&str> = r.added.clone();
            progress(&format!("{} refitted: cost {:.0} from {:.0}", names.join(" + "), r.fit.cost, bases.current.cost));
            out.push(r);
        }
    }
    // those that come near the best are brought to their minimum before they are compared
    let best = out.iter().map(|r| r.fit.cost).fold(f64::INFINITY, f64::min);
    if best > POOR * problem.targets() as f64 {
        out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
        return out;
    }
    let near = best + 0.3 * (problem.cost(&bases.current.layout, &bases.current.point) - best).max(0.0);
    for r in out.iter_mut().filter(|r| r.fit.cost <= near) {
        let effort = Effort { iterations: 10, tolerance: 1e-6, ..Effort::default() };
        if let Ok(fit) = crate::fit::fit(problem, &r.fit.layout, r.fit.point.clone(), effort) {
            r.fit = fit;
        }
    }
    out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    out
}

/// Brings a fit of the brief runs to the whole ones. More must not come out as worse: where the brief fit's point does, the
/// current model's base with the effect's values leads instead.
pub(super) fn on_the_whole(problem: &Problem, current: &Fit, brief: &Fit, effort: Effort) -> Option<Fit> {
    let led = crate::fit::fit(problem, &brief.layout, brief.point.clone(), effort).ok();
    if led.as_ref().is_some_and(|f| f.cost < current.cost) {
        return led;
    }
    let mut point = current.point.clone();
    point.theta.extend_from_slice(&brief.point.theta[current.point.theta.len()..]);
    let warm = crate::fit::fit(problem, &brief.layout, point, effort).ok();
    led.into_iter().chain(warm).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// The effect's sizes together are known to be other than zero, and none is pressed against a physical bound.
pub(super) fn is_sound(fit: &Fit, covariance: &nalgebra::DMatrix<f64>, n: usize) -> bool {
    let first = fit.layout.first_of(n);
    let mut sizes = Vec::new();
    for (i, p) in fit.layout.effects[n].header().parameters.iter().enumerate().filter(|(_, p)| p.size) {
        let value = fit.point.theta[first + i];
        if value >= p.upper || (p.lower < 0.0 && value <= p.lower) {
            return false;
        }
        if covariance[(first + i, first + i)].is_finite() {
            sizes.push(first + i);
        }
    }
    // Wald's test of all sizes together: single ones may be exchangeable (the zeros of two sensors, say)
    let value = nalgebra::DVector::from_iterator(sizes.len(), sizes.iter().map(|&i| fit.point.theta[i]));
    let block = covariance.select_rows(&sizes).select_columns(&sizes);
    block.cholesky().is_some_and(|c| value.dot(&c.solve(&value)) > 12.0 + 2.0 * sizes.len() as f64)
}

/// Candidates that explain nearly as much as the best one and that the clusters don't tell from it. `before`: the cost
/// without any of them.
pub(super) fn rivals(problem: &Problem, refits: &[Refit], before: f64) -> Result<Vec<Refit>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let best = problem.residuals(&refits[0].fit.layout, &refits[0].fit.point)?;
    let mut out = Vec::new();
    for r in &refits[1..] {
        // a set that contains the best one is a refinement, not a rival
        if r.added.iter().any(|id| refits[0].added.contains(id)) {
            continue;
        }
        if before - r.fit.cost < RIVAL * (before - refits[0].fit.cost) {
            continue;
        }
        let other = problem.residuals(&r.fit.layout, &r.fit.point)?;
        let (_, z) = advantage(&other, &best, &clusters, count);
        if z < PREFERRED {
            out.push(r.clone());
        }
    }
    Ok(out)
}

/// Probabilities of the refitted candidates from how far they stand behind the best, in standard errors.
pub(super) fn rank(problem: &Problem, refits: &[Refit]) -> Result<Vec<Ranked>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let Some(first) = refits.first() else { return Ok(Vec::new()) };
    let best = problem.residuals(&first.fit.layout, &first.fit.point)?;
    let mut weights = Vec::new();
    for r in refits {
        let other = problem.residuals(&r.fit.layout, &r.fit.point)?;
        let (total, z) = advantage(&other, &best, &clusters, count);
        let weight = (-0.5 * z.max(0.0).powi(2)).exp().max((-0.5 * total.max(0.0)).exp());
        weights.push(weight);
    }
    let sum: f64 = weights.iter().sum();
    Ok(refits.iter().zip(weights).map(|(r, w)| Ranked { id: r.added.join("+"), probability: w / sum }).collect())
}

/// The run in which two models differ most, as advice.
pub(super) fn where_they_differ(problem: &Problem, a: &Fit, b: &Fit) -> Result<String, SimulationError> {
    let ra = problem.residuals(&a.layout, &a.point)?;
    let rb = problem.residuals(&b.layout, &b.point)?;
    let mut by_run: std::collections::BTreeMap<usize, (f64, usize)> = Default::default();
    for ((s, x), y) in problem.stretches.iter().zip(&ra).zip(&rb) {
        let e = by_run.entry(s.run).or_default();
        for ((x, y), t) in x.iter().zip(y).zip(&s.targets) {
            e.0 += (x - y).powi(2);
            e.1 += t.samples;
        }
    }
    let (run, (sum, n)) = by_run
        .into_iter()
        .max_by(|a, b| (a.1.0 / a.1.1 as f64).total_cmp(&(b.1.0 / b.1.1 as f64)))
        .unwrap_or((0, (0.0, 1)));
    let protocol = problem.stretches.iter().find(|s| s.run == run).and_then(|s| s.protocol).map_or("", |p| p.as_str());
    Ok(format!(
        "another {protocol} run, several times as long or with larger amplitude: there the leading candidates differ most ({:.2} noise floors RMS)",
        (sum / n as f64).sqrt()
    ))
}

/// The balance whose nameless terms explain most, refitted.
pub(super) fn empirical(
    brief: &Problem,
    short: &Problem,
    problem: &Problem,
    identified: &Declared,
    component: &[f64],
    progress: &dyn Fn(&str),
) -> Result<Option<(&'static dyn Effect, Fit)>, SimulationError> {
    let ports = problem.plant.header().ports;
    let terms = || EMPIRICAL.iter().filter(|e| e.header().ports.iter().all(|p| ports.contains(p)));
    let round = Round::new(brief, identified.fit, terms().copied())?;
    let mut gains: Vec<(f64, &'static dyn Effect)> =
        terms().map(|e| (round.gram.gain(&round.of(e.header().id)), *e)).collect();
    gains.sort_by(|a, b| b.0.total_cmp(&a.0));
    let bases = Bases { current: identified.fit, component, short, gross: false };
    let sets: Vec<Vec<&'static dyn Effect>> = gains.into_iter().take(3).map(|(_, e)| vec![e]).collect();
    let Some(best) = refit_all(brief, &bases, &round, &sets, progress).into_iter().next() else { return Ok(None) };
    let effort = Effort { iterations: 8, tolerance: 1e-4, ..Effort::default() };
    let Ok(fit) = crate::fit::fit(problem, &best.fit.layout, best.fit.point, effort) else { return Ok(None) };
    let effect = fit.layout.effects[fit.layout.effects.len() - 1];
    Ok(Some((effect, fit)))
}
