//! The simplest form of an effect that the data ask for.

use model::integrate::SimulationError;

use crate::fit::{Effort, Fit, fit};
use crate::identification::standard_errors;
use crate::problem::Problem;
use crate::uncertainty::{Known, Uncertainty};

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

/// What is known of a fit's entries, whatever sizes [`simplify`] holds at zero. The data do not ask for those, which is not to know that they are zero: what is
/// known of the others goes with how well they are told from them (the zeros of two pressure sensors are known as a difference alone).
pub fn errors_of_simplified(problem: &Problem, fit: &Fit) -> Result<Vec<Known>, SimulationError> {
    let uncertainty = uncertainty_of_simplified(problem, fit)?;
    Ok((0..fit.layout.len()).map(|entry| uncertainty.known(entry)).collect())
}

/// The same of everything that a fit knows, the plant's own parameters too: a tilt's sine that is held at zero would be taken up by a spring.
pub fn uncertainty_of_simplified(problem: &Problem, fit: &Fit) -> Result<Uncertainty, SimulationError> {
    let alone = Uncertainty::of(problem, fit)?;
    let open = released(fit);
    if open.layout.held.len() == fit.layout.held.len() {
        return Ok(alone);
    }
    Ok(alone.no_narrower_than(&Uncertainty::of(problem, &open)?))
}

/// The fit with all sizes free.
fn released(fit: &Fit) -> Fit {
    let mut layout = fit.layout.clone();
    let shapes = layout.shapes();
    layout.held.retain(|entry| shapes.contains(entry));
    Fit { layout, ..fit.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use model::Parameters;
    use model::effects::find;

    #[test]
    fn of_two_zeros_that_go_with_the_filling_one_is_held_and_the_interval_of_the_other_holds_the_truth() {
        let truth = Parameters::example();
        let drift = find("pressure_drift").unwrap();
        let zero1_bar = 0.08;
        let runs = [7, 8].map(|seed| dynamic(&truth, Some((drift, vec![zero1_bar, 0.0, 0.0, 0.0, 40.0])), 16.0, seed));
        let (problem, plain) = (problem(&runs), layout(&truth));
        let point = problem.point([plain.vector_of(&truth), vec![0.0, 0.0, -zero1_bar, 0.0, 40.0]].concat());
        let mut named = plain.with(drift);
        named.held.extend(named.shapes());
        let found = fit(&problem, &named, point, Effort::default()).unwrap();
        let simple = simplify(&problem, found).unwrap();
        let first = simple.layout.first_of(0);
        let (alone, beside) =
            (Uncertainty::of(&problem, &simple).unwrap(), errors_of_simplified(&problem, &simple).unwrap());
        let values = &simple.point.theta[first..];
        let free: Vec<usize> = [0, 2].into_iter().filter(|i| !simple.layout.held.contains(&(first + i))).collect();
        assert!((values[0] - values[2] - zero1_bar).abs() < 0.01, "their difference: {values:?}");
        assert_eq!(free.len(), 1, "one of the two is enough");
        let off = (values[free[0]] - [zero1_bar, 0.0, 0.0][free[0]]).abs();
        let entry = first + free[0];
        assert!(beside[entry].std > 10.0 * alone.of_entry(entry), "alone it would be known as well as the difference");
        assert!(off < beside[entry].half_interval, "{values:?}, {off} and {:?} bar", beside[entry]);
        let student = beside[entry].half_interval / beside[entry].std;
        assert!(student > 1.96 && student < 3.2, "half an interval is {student} standard errors");
        let mut base = beside.iter().take(first).enumerate().filter(|(i, _)| !simple.layout.held.contains(i));
        assert!(base.all(|(i, known)| known.std >= alone.of_entry(i)), "nothing is known better for it");
    }

    /// On a horizontal plane a tilt's sine is a spring, nearly: held at zero, it would make the plant's own spring seem known.
    #[test]
    fn what_a_size_that_is_held_could_take_up_is_no_better_known_for_it() {
        let truth = Parameters::example();
        let tilt = find("tilt").unwrap();
        let (problem, plain) = (problem(&[7, 8].map(|seed| dynamic(&truth, None, 16.0, seed))), layout(&truth));
        let sizes: Vec<usize> = (0..2).collect();
        let mut named = plain.with(tilt);
        named.held.insert(named.first_of(0) + sizes[0]);
        let start = problem.point([plain.vector_of(&truth), vec![0.0, 0.05]].concat());
        let found = fit(&problem, &named, start, Effort::default()).unwrap();
        let (alone, beside) =
            (Uncertainty::of(&problem, &found).unwrap(), uncertainty_of_simplified(&problem, &found).unwrap());
        let spring = model::parameters::index::M2;
        let (held, open) = (alone.of_parameter(spring).unwrap(), beside.of_parameter(spring).unwrap());
        assert!(open > 3.0 * held, "{open} and {held}");
        let all = |u: &Uncertainty| -> Vec<f64> { u.determined().into_iter().map(|(_, _, std)| std).collect() };
        let narrower = all(&beside).iter().zip(all(&alone)).any(|(open, held)| *open < held * (1.0 - 1e-9));
        assert!(!narrower && all(&alone).len() == all(&beside).len());
        let (_, correlation) = beside.correlation();
        assert!(correlation.iter().enumerate().all(|(i, row)| (row[i] - 1.0).abs() < 1e-9));
    }
}
