//! What a fit knows of its parameters: standard errors, also of what follows from several of them.

use model::integrate::SimulationError;
use model::parameters::{COUNT, NAMES, index};
use nalgebra::DMatrix;

use crate::fit::Fit;
use crate::normal::Normal;
use crate::normal::covariance;
use crate::problem::{Piece, Problem};
use crate::sandwich::{sandwich, t_975};

/// Covariance of a fit's entries. Each variance is the larger of what the normal matrix says (widened where the residuals are
/// larger than the noise) and of what the residuals' sums over clusters say, which feel colour.
pub struct Uncertainty {
    covariance: DMatrix<f64>,
    /// What the normal matrix alone says.
    plain: DMatrix<f64>,
    /// By entry: independent clusters that the variance rests on.
    freedom: Vec<f64>,
    /// Plant parameters that are entries, in the layout's order.
    base: Vec<usize>,
    /// By plant parameter: d l4 / d parameter, eq. (16) being continuous.
    l4_slope: [f64; COUNT],
}

/// How well an entry of a fit is known, in its unit; not finite where the data say nothing of it.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// Standard error.
    pub std: f64,
    /// Half of the 95 % interval.
    pub half_interval: f64,
}

impl Uncertainty {
    /// Of a fit at its end. Costs one linearisation of the problem, unless that is kept.
    pub fn of(problem: &Problem, fit: &Fit) -> Result<Self, SimulationError> {
        let pieces = problem.linearised(&fit.layout, &fit.point)?;
        let normal = problem.normal(&pieces, fit.layout.len(), &fit.point);
        Ok(Self::of_linear(problem, fit, &pieces, &normal))
    }

    /// Of a fit that is linearised already.
    pub fn of_linear(problem: &Problem, fit: &Fit, pieces: &[Piece], normal: &Normal) -> Self {
        let mut l4_slope = [0.0; COUNT];
        if fit.layout.is_of_the_rig() {
            let losses = fit.layout.parameters(&fit.point.theta).losses;
            l4_slope[index::L1] = losses.a;
            l4_slope[index::L2] = 1.0;
            l4_slope[index::L3] = 1.0 / losses.a;
            l4_slope[index::A] = losses.l1 - losses.l3 / (losses.a * losses.a);
        }
        let misfit = (fit.cost / problem.targets() as f64).max(1.0);
        let plain = covariance(&normal.matrix) * misfit;
        let robust = sandwich(problem, fit, pieces, normal);
        let wider: Vec<f64> = (0..fit.layout.len())
            .map(|i| {
                let ratio = robust.covariance[(i, i)] / plain[(i, i)];
                if ratio > 1.0 && ratio.is_finite() { ratio.sqrt() } else { 1.0 }
            })
            .collect();
        let covariance = DMatrix::from_fn(plain.nrows(), plain.ncols(), |i, j| plain[(i, j)] * wider[i] * wider[j]);
        Uncertainty { covariance, plain, freedom: robust.freedom, base: fit.layout.base.clone(), l4_slope }
    }

    /// Each variance at least that of another fit's same entry: what that one leaves more open is no better known here. Of a plant parameter that it does not
    /// determine at all nothing is said.
    pub fn no_narrower_than(mut self, other: &Uncertainty) -> Self {
        let entries = self.covariance.nrows();
        let wider: Vec<f64> = (0..entries)
            .map(|i| {
                let ratio = other.covariance[(i, i)] / self.covariance[(i, i)];
                let is_known = ratio.is_finite() || i >= self.base.len();
                if ratio > 1.0 && is_known { ratio.sqrt() } else { 1.0 }
            })
            .collect();
        for i in (0..entries).filter(|&i| wider[i] > 1.0) {
            self.freedom[i] = other.freedom[i];
        }
        let scaled = |i: usize, j: usize| self.covariance[(i, j)] * wider[i] * wider[j];
        self.covariance = DMatrix::from_fn(entries, entries, scaled);
        self
    }

    /// Standard error of an entry of the fit, not finite where the data say nothing of it.
    pub fn of_entry(&self, entry: usize) -> f64 {
        self.covariance[(entry, entry)].sqrt()
    }

    /// The same with half of its 95 % interval, which is Student's for the clusters that the standard error rests on.
    pub fn known(&self, entry: usize) -> Known {
        let std = self.of_entry(entry);
        Known { std, half_interval: t_975(self.freedom[entry]) * std }
    }

    /// Standard error of a plant parameter (position in [`NAMES`]); `None` where the data do not determine it, or where it is
    /// given (J, G, a2).
    pub fn of_parameter(&self, parameter: usize) -> Option<f64> {
        let mut slope = [0.0; COUNT];
        if parameter == index::L4 {
            slope = self.l4_slope;
        } else {
            slope[parameter] = 1.0;
        }
        self.of_combination(&slope)
    }

    /// Standard error of a combination of plant parameters with these slopes; `None` where one of them is not determined.
    pub fn of_combination(&self, slope: &[f64; COUNT]) -> Option<f64> {
        let entry = |p: usize| self.base.iter().position(|&b| b == p);
        let mut terms = Vec::new();
        for p in (0..COUNT).filter(|&p| slope[p] != 0.0) {
            terms.push((entry(p)?, slope[p]));
        }
        let mut variance = 0.0;
        for (i, a) in &terms {
            for (j, b) in &terms {
                variance += a * b * self.covariance[(*i, *j)];
            }
        }
        let std = variance.sqrt();
        std.is_finite().then_some(std)
    }

    /// Degrees of freedom of a plant parameter's standard error: the independent clusters of data that it rests on. `None` as
    /// for [`Self::of_parameter`].
    pub fn freedom(&self, parameter: usize) -> Option<f64> {
        let entry = |p: usize| self.base.iter().position(|&b| b == p).map(|i| self.freedom[i]);
        match parameter {
            index::L4 => [index::L1, index::L2, index::L3, index::A]
                .into_iter()
                .map(entry)
                .try_fold(f64::INFINITY, |least, own| Some(least.min(own?))),
            p => entry(p),
        }
    }

    /// Half of a plant parameter's 95 % interval: Student's point for its degrees of freedom times its standard error.
    pub fn half_interval(&self, parameter: usize) -> Option<f64> {
        Some(t_975(self.freedom(parameter)?) * self.of_parameter(parameter)?)
    }

    /// By how much the standard error of a plant parameter that is an entry of the fit is larger than what independent
    /// residuals would give: 1 where they are independent.
    pub fn widening(&self, parameter: usize) -> Option<f64> {
        let entry = self.base.iter().position(|&b| b == parameter)?;
        let ratio = (self.covariance[(entry, entry)] / self.plain[(entry, entry)]).sqrt();
        ratio.is_finite().then_some(ratio)
    }

    /// Correlation of the plant parameters that are determined, in the order of [`Self::determined`] without l4, which follows
    /// from others: their positions, and the matrix row by row.
    pub fn correlation(&self) -> (Vec<usize>, Vec<Vec<f64>>) {
        let known: Vec<usize> = (0..self.base.len()).filter(|&i| self.of_entry(i).is_finite()).collect();
        let of = |i: usize, j: usize| self.covariance[(i, j)] / (self.of_entry(i) * self.of_entry(j));
        let rows = known.iter().map(|&i| known.iter().map(|&j| of(i, j).clamp(-1.0, 1.0)).collect()).collect();
        (known.iter().map(|&i| self.base[i]).collect(), rows)
    }

    /// Every plant parameter that the data determine, with its standard error, in the order of [`NAMES`].
    pub fn determined(&self) -> Vec<(usize, &'static str, f64)> {
        (0..COUNT).filter_map(|p| self.of_parameter(p).map(|std| (p, NAMES[p], std))).collect()
    }
}
