//! Which base parameters a campaign determines.

use std::collections::{BTreeMap, BTreeSet};

use model::Parameters;
use model::parameters::{NAMES, index};

use crate::fit::Fit;
use crate::layout::Layout;
use crate::normal::covariance;
use crate::problem::{Piece, Point, Problem};

/// From this correlation on two parameters are told as a combination.
const BOUND: f64 = 0.95;

/// What a campaign says of the base parameters, by their places in the reference model's vector.
pub struct Determined {
    /// Those that it does not determine, with the reason.
    pub undetermined: BTreeMap<usize, String>,
    /// Those that it does, but not where the first fit has led them: a misfit may drive a capacity, say, to where nothing tells of it. They begin anew where
    /// the separate fits have them, together with all that belongs to the same equation.
    pub lost: BTreeSet<usize>,
}

/// What the runs determine, by the first fit and, where that says that something is not, by the separate fits as well.
pub fn determined(problem: &Problem, component: &Parameters, first: &Fit, pieces: &[Piece]) -> Determined {
    let misfit = (first.cost / problem.targets() as f64).max(1.0);
    let mut undetermined = at(problem, &first.layout, &first.point, pieces, misfit);
    let mut lost = BTreeSet::new();
    if !undetermined.is_empty() {
        let apart = problem.point(first.layout.vector_of(component));
        let there = problem.linearise(&first.layout, &apart);
        if let Ok(there) = there.map(|pieces| at(problem, &first.layout, &apart, &pieces, misfit)) {
            let found: Vec<usize> = undetermined.keys().copied().filter(|i| !there.contains_key(i)).collect();
            found.iter().for_each(|i| drop(undetermined.remove(i)));
            lost.extend(found.into_iter().flat_map(of_one_equation));
        }
    }
    Determined { undetermined, lost }
}

/// Parameters of the equation that one belongs to.
fn of_one_equation(parameter: usize) -> &'static [usize] {
    use index::*;
    const EQUATIONS: [&[usize]; 6] =
        [&[M1, M2, M3], &[H1, H2, H3, A1], &[V1, V2], &[F1, F2, F3, F4], &[L1, L2, L3, L4, A], &[K_B]];
    EQUATIONS.into_iter().find(|own| own.contains(&parameter)).unwrap_or_default()
}

/// Takes out what the data do not determine, by the derivatives in this point: one after the other, the worst first. `misfit`: cost over what noise makes of it.
fn at(problem: &Problem, layout: &Layout, point: &Point, pieces: &[Piece], misfit: f64) -> BTreeMap<usize, String> {
    let full = problem.normal(pieces, layout.len(), point).matrix;
    let mut left: Vec<usize> = (0..layout.base.len()).collect();
    let mut out = BTreeMap::new();
    loop {
        let m = full.select_rows(&left).select_columns(&left);
        let c = covariance(&m);
        let worst = (0..left.len())
            .map(|i| {
                let at = left[i];
                let size = point.theta[at].abs().max(scale(layout.base[at]));
                (i, (c[(i, i)] * misfit.min(100.0)).sqrt() / size)
            })
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((i, ratio)) if ratio > 1.0 => {
                let parameter = layout.base[left[i]];
                let of = |j: usize| c[(i, j)] / (c[(i, i)] * c[(j, j)]).sqrt();
                let bound: Vec<&str> = (0..left.len())
                    .filter(|&j| j != i && of(j).abs() > BOUND)
                    .map(|j| NAMES[layout.base[left[j]]])
                    .collect();
                let why = format!(
                    "its standard error is {} its size{}: {}",
                    if ratio > 1e4 { "far beyond".to_string() } else { format!("{ratio:.1} times") },
                    if bound.is_empty() {
                        String::new()
                    } else {
                        format!(", only a combination with {} shows", bound.join(", "))
                    },
                    needed_run(parameter)
                );
                out.insert(parameter, why);
                left.remove(i);
            }
            _ => return out,
        }
    }
}

/// A size below which a parameter is as good as zero, so that a well-known zero is not called undetermined.
pub(crate) fn scale(parameter: usize) -> f64 {
    use index::*;
    match parameter {
        M1 => 0.5,
        M2 => 1.0,
        H3 => 0.3,
        A1 => 0.003,
        V1 => 5.0,
        F2 => 0.002,
        F3 => 0.05,
        F4 => 0.2,
        L1 => 1.0,
        L2 => 1.0,
        _ => 0.0,
    }
}

/// The run that would determine a parameter.
fn needed_run(parameter: usize) -> &'static str {
    use index::*;
    match parameter {
        M1 | M2 | M3 => "a torque-map run would determine it",
        H1 | H2 | H3 | A1 => "a clamp-steps run over several angles would determine it",
        V1 | V2 => "a volume-map run would determine it",
        F1 | F2 | F3 | F4 => "a pump-map run in both directions would determine it",
        K_B => "a random-steps run with the bypass open would determine it",
        _ => "constant-flow strokes from slow to fast would determine it",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, problem};

    #[test]
    fn what_a_misfit_has_led_astray_is_determined_where_the_separate_fits_are() {
        let truth = Parameters::example();
        let problem = problem(&[7, 8, 9].map(|seed| dynamic(&truth, None, 20.0, seed)));
        let layout = Layout::base(&truth);
        // a capacity that hardly depends on pressure says nothing of how it would
        let mut astray = truth;
        (astray.capacity.h1, astray.capacity.h3) = (1e-6, 2.7);
        let told = |component: &Parameters| {
            let point = problem.point(layout.vector_of(&astray));
            let pieces = problem.linearise(&layout, &point).unwrap();
            let first = Fit { layout: layout.clone(), cost: problem.targets() as f64, point, converged: true };
            determined(&problem, component, &first, &pieces)
        };
        let found = told(&truth);
        assert!(!found.undetermined.contains_key(&index::H2), "{:?}", found.undetermined);
        assert_eq!(found.lost, [index::H1, index::H2, index::H3, index::A1].into());
        let nowhere = told(&astray);
        assert!(nowhere.undetermined[&index::H2].contains("clamp-steps"), "{:?}", nowhere.undetermined);
        assert!(nowhere.lost.is_empty());
    }
}
