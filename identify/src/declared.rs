//! A model that carries effects already: they are part of what is identified, and what the diagnosis starts from.

use model::Parameters;
use model::effects::{Effect, LIBRARY};
use model::integrate::SimulationError;

use crate::fit::{Effort, Fit, fit};
use crate::problem::Problem;

/// The declared model: `model.toml` with its `[[effect]]`.
#[derive(Clone, Debug)]
pub struct Declared {
    /// Base parameters: one of the two places where the refit begins.
    pub parameters: Parameters,
    /// Effects with values in the order of their headers.
    pub effects: Vec<(&'static dyn Effect, Vec<f64>)>,
}

impl Declared {
    /// The effects that a diagnosis may still propose.
    pub fn open(&self) -> Vec<&'static dyn Effect> {
        let carried = |id: &str| self.effects.iter().any(|(e, _)| e.header().id == id);
        LIBRARY.iter().copied().filter(|e| !carried(e.header().id)).collect()
    }

    /// The joint fit of base parameters and declared effects: from the values of `base`, the reference model's fit, and from those of the
    /// declared model, whichever is nearer to the data. The effects begin at their declared values.
    ///
    /// # Errors
    /// Neither can be simulated.
    pub fn refit(&self, problem: &Problem, base: &Fit, effort: Effort) -> Result<Fit, SimulationError> {
        let mut layout = base.layout.clone();
        let mut values = Vec::new();
        for (effect, own) in &self.effects {
            layout.effects.push(*effect);
            let bounds = effect.header().parameters.iter().map(|p| (p.lower, p.upper));
            values.extend(own.iter().zip(bounds).map(|(v, (low, high))| v.clamp(low, high)));
        }
        let start = |theta: &[f64]| {
            let mut point = base.point.clone();
            point.theta = theta.iter().chain(&values).copied().collect();
            point
        };
        let from = [start(&base.point.theta), start(&base.layout.vector_of(&self.parameters))];
        let [first, second] = &from;
        let nearer = if problem.cost(&layout, second) < problem.cost(&layout, first) { second } else { first };
        fit(problem, &layout, nearer.clone(), effort)
    }
}
