//! Derivatives carried on from a step to the next by what the simulation of that step showed (Broyden's update; C. G. Broyden, Math. Comp. 19, 1965).
//!
//! A simulation with derivatives takes five times as long as one without. Every stretch has rows and a change of its own, so that the update is of as many
//! ranks as there are stretches.

use crate::problem::{Piece, Point};

/// The derivatives of a linearisation at `from`, as a simulation at `to` with these residuals shows them. Nothing else is changed of them than what that
/// step can show, so entries that no longer move keep theirs.
pub fn carried_on(mut pieces: Vec<Piece>, from: &Point, to: &Point, residuals: Vec<Vec<f64>>) -> Vec<Piece> {
    let step: Vec<f64> = to.theta.iter().zip(&from.theta).map(|(b, a)| b - a).collect();
    for ((piece, after), (a, b)) in pieces.iter_mut().zip(residuals).zip(from.initial.iter().zip(&to.initial)) {
        let own = b.iter().zip(a).map(|(b, a)| b - a);
        let taken: Vec<f64> = step.iter().copied().chain(own).collect();
        let columns = taken.len();
        // in units of what each entry does here, so that the update does not depend on the entries' own units
        let mut weighted = vec![0.0; columns];
        for row in piece.slope.chunks(columns) {
            weighted.iter_mut().zip(row).for_each(|(w, s)| *w += s * s);
        }
        weighted.iter_mut().zip(&taken).for_each(|(w, d)| *w *= d);
        let square: f64 = weighted.iter().zip(&taken).map(|(w, d)| w * d).sum();
        if square > 0.0 {
            weighted.iter_mut().for_each(|w| *w /= square);
            for (row, (before, after)) in piece.slope.chunks_mut(columns).zip(piece.residual.iter().zip(&after)) {
                let promised: f64 = row.iter().zip(&taken).map(|(s, d)| s * d).sum();
                let off = before - after - promised;
                row.iter_mut().zip(&weighted).for_each(|(s, w)| *s += off * w);
            }
        }
        piece.residual = after;
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_step_showed_is_what_the_derivatives_say_of_it_and_other_directions_stay() {
        let piece = Piece { residual: vec![1.0, 2.0], slope: vec![1.0, 0.0, 0.5, 0.0, 2.0, 0.0] };
        let from = Point { theta: vec![3.0, 4.0], initial: vec![vec![0.0]] };
        let to = Point { theta: vec![3.5, 4.0], initial: vec![vec![0.2]] };
        let after = vec![0.2, 2.4];
        let carried = carried_on(vec![piece], &from, &to, vec![after.clone()]).remove(0);
        assert_eq!(carried.residual, after);
        let taken = [0.5, 0.0, 0.2];
        let says: Vec<f64> =
            carried.slope.chunks(3).map(|row| row.iter().zip(taken).map(|(s, d)| s * d).sum()).collect();
        for (says, showed) in says.iter().zip([0.8, -0.4]) {
            assert!((says - showed).abs() < 1e-12, "{says} {showed}");
        }
        assert_eq!((carried.slope[1], carried.slope[4]), (0.0, 2.0), "what did not move");
    }

    #[test]
    fn entries_without_influence_or_a_step_of_nothing_change_nothing() {
        let slope = vec![1.0, 0.0, 2.0, 0.0];
        let piece = || Piece { residual: vec![1.0, 2.0], slope: slope.clone() };
        let at = |theta: [f64; 2]| Point { theta: theta.to_vec(), initial: vec![vec![]] };
        let held = carried_on(vec![piece()], &at([1.0, 1.0]), &at([1.0, 9.0]), vec![vec![0.0, 0.0]]).remove(0);
        assert_eq!(held.slope, slope);
        let still = carried_on(vec![piece()], &at([1.0, 1.0]), &at([1.0, 1.0]), vec![vec![0.5, 0.0]]).remove(0);
        assert_eq!((still.slope, still.residual), (slope.clone(), vec![0.5, 0.0]));
    }
}
