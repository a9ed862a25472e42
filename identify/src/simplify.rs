//! The simplest form of an effect that the data ask for.

use model::integrate::SimulationError;

use crate::fit::{Effort, Fit, fit};
use crate::identification::standard_errors;
use crate::problem::Problem;

/// A size may go when its absence raises the cost by less than this many noise variances (per excess of the misfit).
const WORTH: f64 = 12.0;

/// Sets sizes of effects that have several of them to zero, one after the other, the least certain first, as long as the
/// data do not object; they are held from then on. An effect keeps at least one size.
pub fn simplify(problem: &Problem, start: Fit) -> Result<Fit, SimulationError> {
    let mut best = start;
    for n in 0..best.layout.effects.len() {
        let first = best.layout.first_of(n);
        let sizes: Vec<usize> = best.layout.effects[n]
            .header()
            .parameters
            .iter()
            .enumerate()
            .filter(|(_, p)| p.size)
            .map(|(i, _)| first + i)
            .collect();
        let mut open: Vec<usize> = sizes.clone();
        loop {
            let free = sizes.iter().filter(|i| !best.layout.held.contains(i)).count();
            if free < 2 || open.is_empty() {
                break;
            }
            let std = standard_errors(problem, &best)?;
            let certainty = |i: usize| if std[i].is_finite() { best.point.theta[i].abs() / std[i] } else { 0.0 };
            open.sort_by(|a, b| certainty(*b).total_cmp(&certainty(*a)));
            let Some(least) = open.pop() else { break };
            if certainty(least) > 30.0 {
                break;
            }
            let mut layout = best.layout.clone();
            layout.held.insert(least);
            let mut point = best.point.clone();
            point.theta[least] = 0.0;
            let effort = Effort { iterations: 5, tolerance: 1e-6, ..Effort::default() };
            let misfit = (best.cost / problem.targets() as f64).max(1.0);
            if let Ok(without) = fit(problem, &layout, point, effort)
                && without.cost - best.cost < WORTH * misfit
            {
                best = without;
            }
        }
    }
    Ok(best)
}
