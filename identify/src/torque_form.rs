//! The torque characteristic: eq. (2), or the third order that follows from eq. (1).

use model::effects::{Effect, find};
use model::integrate::SimulationError;

use crate::fit::{Effort, Fit, fit};
use crate::problem::Problem;

/// Which polynomial of the angle the torque is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TorqueForm {
    /// Eq. (2).
    #[default]
    SecondEquation,
    /// Eq. (2) with the terms of third order that eq. (1) has and eq. (2) drops: c1 phi^3 + c2 |dp| phi^3 + c3 dp phi^2.
    ThirdOrder,
}

/// The effect that holds the terms of third order.
pub const THIRD_ORDER: &str = "torque_cubic";

impl std::str::FromStr for TorqueForm {
    type Err = String;
    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            "eq2" => Ok(TorqueForm::SecondEquation),
            "third-order" => Ok(TorqueForm::ThirdOrder),
            other => Err(format!("expected eq2 or third-order, got {other}")),
        }
    }
}

/// The terms of third order.
pub fn third_order() -> &'static dyn Effect {
    find(THIRD_ORDER).expect("the library holds the terms of eq. (1)")
}

/// Refits everything with the terms of third order beside eq. (2).
///
/// # Errors
/// The fit can't be simulated.
pub fn refit_third_order(problem: &Problem, second: &Fit, effort: Effort) -> Result<Fit, SimulationError> {
    let effect = third_order();
    let layout = second.layout.with(effect);
    let mut point = second.point.clone();
    point.theta.extend(effect.header().parameters.iter().map(|_| 0.0));
    fit(problem, &layout, point, effort)
}
