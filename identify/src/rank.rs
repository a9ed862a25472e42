//! How many directions in the space of the parameters the data determine, and which they leave open.

use model::integrate::SimulationError;
use model::parameters::{NAMES, index};
use nalgebra::DMatrix;

use crate::determined::scale;
use crate::fit::Fit;
use crate::layout::FREE;
use crate::normal::Normal;
use crate::problem::{Point, Problem};

/// See the module.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Rank {
    /// Every base parameter that could be free, `a2` among them.
    pub parameters: Vec<&'static str>,
    /// Directions that are known to better than their size.
    pub rank: usize,
    /// Largest over smallest standard error along the determined directions, each parameter in units of its size.
    pub condition: f64,
    /// The others: what may be added to the parameters, in units of their sizes, without any visible effect.
    pub open: Vec<Vec<(&'static str, f64)>>,
}

/// Parts of a direction below this are not named.
const NAMED: f64 = 0.15;

/// Of the base parameters of a fit, those that it held included, given its normal equations. Costs a linearisation where it held any.
///
/// # Errors
/// The fit can't be simulated.
pub fn rank(problem: &Problem, fit: &Fit, normal: &Normal) -> Result<Rank, SimulationError> {
    let mut layout = fit.layout.clone();
    layout.fixed = layout.parameters(&fit.point.theta).to_vector().to_vec();
    let fitted = fit.layout.base.len();
    let after = fit.point.theta[fitted..].to_vec();
    layout.base = FREE.to_vec();
    let theta: Vec<f64> = layout.base.iter().map(|&p| layout.fixed[p]).chain(after).collect();
    let point = Point { theta, initial: fit.point.initial.clone() };
    let base = FREE.len();
    let free = if fit.layout.base == FREE {
        normal.matrix.view((0, 0), (base, base)).into_owned()
    } else {
        // what stands beside the base is no direction of it
        layout.held = (layout.first_of(0)..layout.len()).collect();
        let pieces = problem.linearise(&layout, &point)?;
        problem.normal(&pieces, layout.len(), &point).matrix.view((0, 0), (base, base)).into_owned()
    };
    // eq. (13): a2 scales the whole capacity, so d/d a2 = -(h1 d/d h1 + h3 d/d h3)
    let mut widened = DMatrix::identity(base, base + 1);
    for p in [index::H1, index::H3] {
        let at = FREE.iter().position(|&f| f == p).expect("h1 and h3 are free parameters");
        widened[(at, base)] = -point.theta[at];
    }
    let matrix = widened.transpose() * free * widened;
    layout.base.push(index::A2);
    let misfit = (fit.cost / problem.targets() as f64).max(1.0);
    let n = layout.base.len();
    let size = |i: usize| match layout.base[i] {
        index::A2 => 1.0,
        p => point.theta[i].abs().max(scale(p)).max(1e-12),
    };
    let relative = DMatrix::from_fn(n, n, |i, j| size(i) * matrix[(i, j)] * size(j) / misfit);
    let eigen = relative.symmetric_eigen();
    let mut out =
        Rank { parameters: layout.base.iter().map(|&p| NAMES[p]).collect(), rank: 0, condition: 1.0, open: Vec::new() };
    let (mut least, mut most) = (f64::INFINITY, 0.0f64);
    for (k, value) in eigen.eigenvalues.iter().enumerate() {
        if *value > 1.0 {
            out.rank += 1;
            (least, most) = (least.min(*value), most.max(*value));
            continue;
        }
        let direction = eigen.eigenvectors.column(k);
        let largest = direction.iter().copied().fold(0.0f64, |m, v| if v.abs() > m.abs() { v } else { m });
        let mut parts: Vec<(&'static str, f64)> = (0..n)
            .map(|i| (out.parameters[i], direction[i] / largest))
            .filter(|(_, share)| share.abs() > NAMED)
            .collect();
        parts.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        out.open.push(parts);
    }
    if out.rank > 0 {
        out.condition = (most / least).sqrt();
    }
    Ok(out)
}
