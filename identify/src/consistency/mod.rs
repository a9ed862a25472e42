//! Checks that the identified values allow of the model itself: what must agree if its physics holds.
//!
//! Each check is a value that should be zero, its standard error, and a verdict. A check that fails says where the reference model and
//! the rig part ways; it is no diagnosis.

mod agreement;
mod closure;
mod oil;
mod symmetry;
mod work;

pub use closure::closure_defect_ml;

use crate::figures::text::number;
use crate::identification::{Identified, Loaded};
use crate::score::Scene;
use crate::uncertainty::Uncertainty;

/// What a check says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Zero within what the data can tell, or too small to matter.
    Holds,
    /// Not zero, and large enough to matter.
    Fails,
    /// This campaign has not the runs for it.
    Open,
}

impl Outcome {
    /// A word for a table.
    pub fn as_str(self) -> &'static str {
        match self {
            Outcome::Holds => "holds",
            Outcome::Fails => "fails",
            Outcome::Open => "open",
        }
    }
}

/// One line.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Check {
    /// For programs: `virtual_work`.
    pub id: &'static str,
    /// What is compared.
    pub what: String,
    /// Should be 0; `None` where it could not be computed.
    pub value: Option<f64>,
    /// Its standard error, where there is one.
    pub std: Option<f64>,
    /// Unit of both.
    pub unit: &'static str,
    /// The verdict.
    pub outcome: Outcome,
    /// The verdict in words: what it means, and what to do.
    pub meaning: String,
}

/// Standard errors beyond which a value is not zero. Of some thirty checks one in ten campaigns fails one by chance.
const STANDARD_ERRORS: f64 = 3.0;

impl Check {
    /// A check that could not be made: says which run it needs.
    fn open(id: &'static str, what: impl Into<String>, unit: &'static str, needs: &str) -> Self {
        let meaning = format!("can't be judged: {needs}");
        Check { id, what: what.into(), value: None, std: None, unit, outcome: Outcome::Open, meaning }
    }

    /// A value with its standard error. Below `matters` (in the value's unit) it holds however well it is known.
    fn measured(
        id: &'static str,
        what: impl Into<String>,
        (value, std): (f64, f64),
        unit: &'static str,
        matters: f64,
        [holds, fails]: [&str; 2],
    ) -> Self {
        if !(value.is_finite() && std.is_finite()) {
            return Check::open(id, what, unit, "the data do not determine it");
        }
        let z = if std > 0.0 { value.abs() / std } else { f64::INFINITY };
        let known = z > STANDARD_ERRORS;
        let outcome = if known && value.abs() > matters { Outcome::Fails } else { Outcome::Holds };
        let size = format!("{} standard errors", number(z, 2));
        let meaning = match (outcome, known) {
            (Outcome::Fails, _) => format!("{fails} ({size})"),
            (_, true) => format!("{holds} (known not to be 0, {size}, but too small to matter)"),
            _ => format!("{holds} ({size})"),
        };
        Check { id, what: what.into(), value: Some(value), std: Some(std), unit, outcome, meaning }
    }
}

/// Everything that the checks are made of.
pub(crate) struct Material<'a> {
    pub loaded: &'a Loaded,
    pub identified: &'a Identified,
    pub uncertainty: &'a Uncertainty,
    pub scene: &'a Scene<'a>,
}

/// All checks of the reference model.
pub(crate) fn checks(material: &Material) -> Vec<Check> {
    let mut out = work::checks(material);
    out.extend(closure::checks(material));
    out.extend(oil::checks(material));
    out.extend(symmetry::checks(material));
    out.extend(agreement::checks(material));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_fails_only_where_it_is_known_and_matters() {
        let of = |value, std, matters| Check::measured("x", "x", (value, std), "1", matters, ["fine", "not"]).outcome;
        assert_eq!(of(1.0, 0.5, 0.0), Outcome::Holds);
        assert_eq!(of(2.0, 0.5, 0.0), Outcome::Fails);
        assert_eq!(of(2.0, 0.5, 3.0), Outcome::Holds);
        assert_eq!(of(f64::NAN, 0.5, 0.0), Outcome::Open);
    }
}
