//! Standard errors that hold under coloured residuals: a sandwich of cluster sums.
//!
//! The normal matrix alone says how certain the parameters are if every block's error is independent and of the size that was
//! estimated. Whatever makes neighbouring blocks err together (noise with a memory, an input that was measured, a
//! small misfit) makes the parameters less certain than that. Sums of score over clusters of several seconds feel it,
//! whatever its form. Each sum is corrected for the cluster's own pull on the fit, so that white noise gives the normal
//! matrix's answer on average (Bell and McCaffrey's CR2).

use nalgebra::{DMatrix, DVector};

use crate::fit::Fit;
use crate::normal::Normal;
use crate::normal::covariance;
use crate::problem::{Piece, Problem};
use crate::score::clusters;

/// A cluster's own pull beyond which it is not corrected further: nothing else speaks of that direction.
const MOST_PULL: f64 = 0.95;

/// See the module.
pub struct Sandwich {
    /// Covariance of the fit's entries out of the cluster sums.
    pub covariance: DMatrix<f64>,
    /// By entry: how many independent clusters its variance rests on, at least 1.
    pub freedom: Vec<f64>,
}

/// Of a fit at its minimum, given its linearisation.
pub fn sandwich(problem: &Problem, fit: &Fit, pieces: &[Piece], normal: &Normal) -> Sandwich {
    let n = fit.layout.len();
    // the covariance's root: cov = root root', so that root' score has variance 1 under white noise
    let plain = covariance(&normal.matrix);
    let known: Vec<usize> = (0..n).filter(|&i| plain[(i, i)].is_finite()).collect();
    let scale = DVector::from_iterator(known.len(), known.iter().map(|&i| plain[(i, i)].sqrt()));
    let correlation =
        DMatrix::from_fn(known.len(), known.len(), |i, j| plain[(known[i], known[j])] / (scale[i] * scale[j]));
    let eigen = correlation.symmetric_eigen();
    let root = DMatrix::from_fn(known.len(), known.len(), |i, j| {
        scale[i] * eigen.eigenvectors[(i, j)] * eigen.eigenvalues[j].max(0.0).sqrt()
    });

    let (members, count) = clusters(problem);
    let m = known.len();
    let mut scores = vec![DVector::zeros(m); count];
    let mut pulls = vec![DMatrix::zeros(m, m); count];
    for (s, piece) in pieces.iter().enumerate() {
        let std = &problem.stretches[s].initial_std;
        let (rows, prior) = normal.without_initial(s, piece, n, &fit.point.initial[s], std);
        let own = DMatrix::from_fn(piece.residual.len(), m, |t, i| rows[t * n + known[i]]);
        let white = own * &root;
        for (t, (r, c)) in piece.residual.iter().zip(&members[s]).enumerate() {
            for i in 0..m {
                scores[*c][i] += white[(t, i)] * r;
                for j in 0..=i {
                    pulls[*c][(i, j)] += white[(t, i)] * white[(t, j)];
                }
            }
        }
        if let Some(c) = members[s].first() {
            let prior = DVector::from_iterator(m, known.iter().map(|&i| prior[i]));
            scores[*c] += root.transpose() * prior;
        }
    }

    let mut meat = DMatrix::zeros(m, m);
    let mut expected = vec![(0.0, 0.0); m];
    for (score, mut pull) in scores.into_iter().zip(pulls) {
        pull.fill_upper_triangle_with_lower_triangle();
        let share = &root * &pull * root.transpose();
        for (i, (sum, square)) in expected.iter_mut().enumerate() {
            *sum += share[(i, i)];
            *square += share[(i, i)] * share[(i, i)];
        }
        let eigen = pull.symmetric_eigen();
        let mut along = eigen.eigenvectors.transpose() * score;
        for (a, pull) in along.iter_mut().zip(eigen.eigenvalues.iter()) {
            *a /= (1.0 - pull.clamp(0.0, MOST_PULL)).sqrt();
        }
        let corrected = eigen.eigenvectors * along;
        meat += &corrected * corrected.transpose();
    }
    let inner = &root * meat * root.transpose();
    let mut out = plain;
    let mut freedom = vec![1.0; n];
    for (i, &p) in known.iter().enumerate() {
        freedom[p] = if expected[i].1 > 0.0 { (expected[i].0 * expected[i].0 / expected[i].1).max(1.0) } else { 1.0 };
        for (j, &q) in known.iter().enumerate() {
            out[(p, q)] = inner[(i, j)];
        }
    }
    Sandwich { covariance: out, freedom }
}

/// Student's 97.5 % point for these degrees of freedom (series in 1/f; exact to 1 % from 3 on).
pub fn t_975(freedom: f64) -> f64 {
    let (z, f) = (1.959_964_f64, freedom.max(3.0));
    let z3 = z.powi(3);
    let z5 = z.powi(5);
    let z7 = z.powi(7);
    z + (z3 + z) / (4.0 * f)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * f * f)
        + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * f.powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_s_points_are_those_of_the_tables() {
        for (f, t) in [(3.0, 3.182), (5.0, 2.571), (10.0, 2.228), (30.0, 2.042), (1e9, 1.960)] {
            assert!((t_975(f) / t - 1.0).abs() < 0.01, "{f}: {} for {t}", t_975(f));
        }
    }
}
