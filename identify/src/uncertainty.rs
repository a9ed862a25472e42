//! What a fit knows of its parameters: standard errors, also of what follows from several of them.

use model::integrate::SimulationError;
use model::parameters::{COUNT, NAMES, index};
use nalgebra::DMatrix;

use crate::fit::Fit;
use crate::identification::covariance_of;
use crate::problem::Problem;

/// Covariance of a fit's entries, widened where the residuals are larger than the noise.
pub struct Uncertainty {
    covariance: DMatrix<f64>,
    /// Plant parameters that are entries, in the layout's order.
    base: Vec<usize>,
    /// By plant parameter: d l4 / d parameter, eq. (16) being continuous.
    l4_slope: [f64; COUNT],
}

impl Uncertainty {
    /// Of a fit at its end. Costs one linearisation of the problem.
    pub fn of(problem: &Problem, fit: &Fit) -> Result<Self, SimulationError> {
        let losses = fit.layout.parameters(&fit.point.theta).losses;
        let mut l4_slope = [0.0; COUNT];
        l4_slope[index::L1] = losses.a;
        l4_slope[index::L2] = 1.0;
        l4_slope[index::L3] = 1.0 / losses.a;
        l4_slope[index::A] = losses.l1 - losses.l3 / (losses.a * losses.a);
        Ok(Uncertainty { covariance: covariance_of(problem, fit)?, base: fit.layout.base.clone(), l4_slope })
    }

    /// Standard error of an entry of the fit, not finite where the data say nothing of it.
    pub fn of_entry(&self, entry: usize) -> f64 {
        self.covariance[(entry, entry)].sqrt()
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

    /// Every plant parameter that the data determine, with its standard error, in the order of [`NAMES`].
    pub fn determined(&self) -> Vec<(usize, &'static str, f64)> {
        (0..COUNT).filter_map(|p| self.of_parameter(p).map(|std| (p, NAMES[p], std))).collect()
    }
}
