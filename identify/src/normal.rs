//! The normal equations of a linearised problem, the initial values of each stretch eliminated.

use nalgebra::{DMatrix, DVector};

use crate::predict::Initial;
use crate::problem::{Piece, Point, Problem};

/// J'J, J'r and what the initial values take of both.
pub struct Normal {
    /// J'J of the parameters after elimination.
    pub matrix: DMatrix<f64>,
    /// J'r likewise.
    pub gradient: DVector<f64>,
    /// By stretch: inverse of the initial values' block, their coupling to the parameters, and their gradient.
    eliminated: Vec<(DMatrix<f64>, DMatrix<f64>, DVector<f64>)>,
}

impl Problem {
    /// Normal equations of linearised pieces.
    pub fn normal(&self, pieces: &[Piece], columns: usize, point: &Point) -> Normal {
        let mut matrix = DMatrix::zeros(columns, columns);
        let mut gradient = DVector::zeros(columns);
        let mut eliminated = Vec::new();
        for (n, piece) in pieces.iter().enumerate() {
            let own = point.initial[n].len();
            let all = columns + own;
            let (mut h, mut g) = (vec![0.0; all * all], vec![0.0; all]);
            for (row, r) in piece.slope.chunks(all).zip(&piece.residual) {
                for i in 0..all {
                    let v = row[i];
                    if v != 0.0 {
                        g[i] += v * r;
                        for (x, w) in h[i * all..i * all + i + 1].iter_mut().zip(row) {
                            *x += v * w;
                        }
                    }
                }
            }
            let at = |i: usize, j: usize| if i >= j { h[i * all + j] } else { h[j * all + i] };
            let std = &self.stretches[n].initial_std;
            let mut inner = DMatrix::zeros(own, own);
            let mut inner_gradient = DVector::zeros(own);
            let mut free = vec![false; own];
            for i in 0..own {
                free[i] = std[i] > 0.0;
                inner_gradient[i] =
                    if free[i] { g[columns + i] - point.initial[n][i] / (std[i] * std[i]) } else { 0.0 };
                for j in 0..own {
                    inner[(i, j)] = at(columns + i, columns + j);
                }
            }
            for i in 0..own {
                for j in 0..own {
                    if !(free[i] && free[j]) {
                        inner[(i, j)] = if i == j { 1.0 } else { 0.0 };
                    }
                }
                if free[i] {
                    inner[(i, i)] += 1.0 / (std[i] * std[i]);
                }
            }
            let inverse = inner.try_inverse().unwrap_or_else(|| DMatrix::zeros(own, own));
            let mut coupling = DMatrix::zeros(own, columns);
            for i in (0..own).filter(|&i| free[i]) {
                for j in 0..columns {
                    coupling[(i, j)] = at(columns + i, j);
                }
            }
            let reduced = &inverse * &coupling;
            for i in 0..columns {
                gradient[i] += g[i];
                for j in 0..columns {
                    matrix[(i, j)] += at(i, j);
                }
            }
            matrix -= coupling.transpose() * &reduced;
            gradient -= reduced.transpose() * &inner_gradient;
            eliminated.push((inverse, coupling, inner_gradient));
        }
        Normal { matrix, gradient, eliminated }
    }
}

impl Normal {
    /// J'v of a vector of targets, stretch by stretch, reduced like the gradient; and the initial values' own part.
    pub(crate) fn gradient_of(&self, pieces: &[Piece], v: &[Vec<f64>]) -> (DVector<f64>, Vec<Vec<f64>>) {
        let columns = self.gradient.len();
        let mut out = DVector::zeros(columns);
        let mut inner = Vec::new();
        for (n, (piece, v)) in pieces.iter().zip(v).enumerate() {
            let all = columns + self.eliminated[n].2.len();
            let mut g = vec![0.0; all];
            for (row, x) in piece.slope.chunks(all).zip(v) {
                for (g, s) in g.iter_mut().zip(row) {
                    *g += s * x;
                }
            }
            let (direct, own) = self.eliminate(n, &g[columns..]);
            for j in 0..columns {
                out[j] += g[j] - direct[j];
            }
            inner.push(own);
        }
        (out, inner)
    }

    /// What a stretch's initial values take of a gradient: their part of the parameters' gradient, and their own gradient
    /// with fixed entries at 0.
    fn eliminate(&self, stretch: usize, own: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (inverse, coupling, _) = &self.eliminated[stretch];
        let free = |i: usize| coupling.row(i).iter().any(|v| *v != 0.0);
        let own: Vec<f64> = (0..own.len()).map(|i| if free(i) { own[i] } else { 0.0 }).collect();
        let direct = coupling.transpose() * (inverse * DVector::from_column_slice(&own));
        (direct.iter().copied().collect(), own)
    }

    /// The initial values' step for a parameter step and their own gradients.
    pub(crate) fn back(&self, step: &DVector<f64>, own: &[Vec<f64>]) -> Vec<Initial> {
        self.eliminated
            .iter()
            .zip(own)
            .map(|((inverse, coupling, _), own)| {
                let moved = coupling * step;
                let d = inverse * (DVector::from_column_slice(own) - moved);
                d.iter().copied().collect()
            })
            .collect()
    }

    /// A stretch's rows of derivatives with what its initial values take up left out: `columns` entries a row. The second part is
    /// what the initial values' priors, off by `initial` (with standard errors `std`), add to the gradient.
    pub(crate) fn without_initial(
        &self,
        stretch: usize,
        piece: &Piece,
        columns: usize,
        initial: &[f64],
        std: &[f64],
    ) -> (Vec<f64>, Vec<f64>) {
        let (inverse, coupling, _) = &self.eliminated[stretch];
        let taken = inverse * coupling;
        let mut rows = Vec::with_capacity(piece.residual.len() * columns);
        let count = initial.len();
        for row in piece.slope.chunks(columns + count) {
            let own = &row[columns..];
            rows.extend((0..columns).map(|j| row[j] - (0..count).map(|i| own[i] * taken[(i, j)]).sum::<f64>()));
        }
        let pull: Vec<f64> =
            (0..count).map(|i| if std[i] > 0.0 { initial[i] / (std[i] * std[i]) } else { 0.0 }).collect();
        let prior = (0..columns).map(|j| (0..count).map(|i| pull[i] * taken[(i, j)]).sum()).collect();
        (rows, prior)
    }

    /// By stretch: what its initial values' own step promises to take off the cost.
    pub(crate) fn promised_by_initial(&self) -> Vec<f64> {
        self.eliminated.iter().map(|(inverse, _, own)| own.dot(&(inverse * own))).collect()
    }

    /// What the initial values do when the parameters move by `step`.
    pub fn initial_step(&self, step: &DVector<f64>) -> Vec<Initial> {
        self.eliminated
            .iter()
            .map(|(inverse, coupling, gradient)| {
                let moved = coupling * step;
                let d = inverse * (gradient - moved);
                d.iter().copied().collect()
            })
            .collect()
    }
}

/// Takes from a vector of targets, stretch by stretch, what the predictions do, linearly, when parameters and initial values move by so much.
pub(crate) fn take_moved(v: &mut [Vec<f64>], pieces: &[Piece], step: &DVector<f64>, initial: &[Initial]) {
    let columns = step.len();
    for ((p, v), d) in pieces.iter().zip(v).zip(initial) {
        for (row, x) in p.slope.chunks(columns + d.len()).zip(v.iter_mut()) {
            let moved: f64 = row[..columns].iter().zip(step.iter()).map(|(a, b)| a * b).sum();
            *x -= row[columns..].iter().zip(d).fold(moved, |sum, (a, b)| sum + a * b);
        }
    }
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
