//! Joint refits of base parameters and candidate effects, and how two of them compare.

use model::effects::Effect;

use crate::fit::{Effort, Fit, fit};
use crate::problem::{Point, Problem};
use crate::score::Direction;

/// A candidate set of effects, refitted.
#[derive(Clone)]
pub struct Refit {
    /// Ids of what was added to the model before.
    pub added: Vec<&'static str>,
    /// The fit.
    pub fit: Fit,
}

/// Parameter values from which the base may start: where the fit without the effect stands, and where the component
/// experiments do; a gross effect bends the former far off.
pub struct Bases<'a> {
    /// The current fit.
    pub current: &'a Fit,
    /// Base values from the component experiments, in the layout's order.
    pub component: &'a [f64],
}

/// Refits `current` with these effects added, each from its best starts.
pub fn refit(problem: &Problem, bases: &Bases, added: &[(&'static dyn Effect, Vec<&Direction>)], effort: Effort) -> Option<Refit> {
    let mut layout = bases.current.layout.clone();
    for (effect, _) in added {
        layout.effects.push(*effect);
    }
    let mut best: Option<(f64, Point)> = None;
    for start in starts(added) {
        for from_component in [false, true] {
            let mut point = bases.current.point.clone();
            if from_component {
                point.theta[..bases.component.len()].copy_from_slice(bases.component);
            }
            point.theta.extend_from_slice(&start);
            let cost = problem.cost(&layout, &point);
            if best.as_ref().is_none_or(|(c, _)| cost < *c) {
                best = Some((cost, point));
            }
        }
    }
    let (cost, point) = best?;
    if !cost.is_finite() {
        return None;
    }
    let fit = fit(problem, &layout, point, effort).ok()?;
    Some(Refit { added: added.iter().map(|(e, _)| e.header().id).collect(), fit })
}

/// Starts of the effects' parameters: each one's best directions as they stand and scaled to what the residual asks for.
fn starts(added: &[(&'static dyn Effect, Vec<&Direction>)]) -> Vec<Vec<f64>> {
    let each: Vec<Vec<Vec<f64>>> = added
        .iter()
        .map(|(effect, directions)| {
            let mut out = Vec::new();
            for d in directions.iter().take(2) {
                let scale = d.scale().clamp(0.05, 20.0);
                let scaled = effect
                    .header()
                    .parameters
                    .iter()
                    .zip(&d.start)
                    .map(|(p, v)| if p.size { (v * scale).clamp(p.lower, p.upper) } else { *v })
                    .collect();
                out.push(scaled);
                if !(0.3..3.0).contains(&scale) {
                    out.push(d.start.clone());
                }
            }
            if out.is_empty() {
                out.push(effect.header().starts[0].to_vec());
            }
            out
        })
        .collect();
    match &each[..] {
        [one] => one.clone(),
        [a, b] => vec![[a[0].clone(), b[0].clone()].concat()],
        more => vec![more.iter().flat_map(|m| m[0].clone()).collect()],
    }
}

/// By how much the second residual is smaller, in standard errors of the difference by clusters: sums of squares are
/// compared cluster by cluster, so that colour and outliers widen the error instead of feigning certainty.
pub fn advantage(before: &[Vec<f64>], after: &[Vec<f64>], clusters: &[Vec<usize>], count: usize) -> (f64, f64) {
    let mut sums = vec![0.0; count];
    for ((b, a), c) in before.iter().zip(after).zip(clusters) {
        for ((b, a), c) in b.iter().zip(a).zip(c) {
            sums[*c] += b * b - a * a;
        }
    }
    let total: f64 = sums.iter().sum();
    let error: f64 = sums.iter().map(|v| v * v).sum::<f64>().sqrt();
    (total, if error > 0.0 { total / error } else { 0.0 })
}
