//! Identification, free-run validation and diagnosis, offline, from recordings.
// what makes recordings for the tests in `tests/` names this crate from outside; unit tests use it too
#[cfg(test)]
extern crate self as identify;

pub mod analysis;
mod bend;
pub mod colour;
pub mod component;
pub mod consistency;
pub mod corruption;
pub mod declared;
pub mod design;
pub mod determined;
pub mod diagnose;
pub mod equations;
pub mod equivalence;
pub mod false_minimum;
pub mod figure;
pub mod figures;
pub mod findings;
pub mod fit;
pub mod forms;
pub mod guide;
pub mod guided;
pub mod identification;
pub mod judged;
pub mod kept;
pub mod layout;
pub mod loaded;
pub mod misfit;
pub mod model_file;
pub mod noise;
pub mod normal;
pub mod plant;
pub mod plants;
pub mod plausible;
pub mod predict;
pub mod prepare;
pub mod problem;
pub mod rank;
pub mod refit;
pub mod report;
pub mod sandwich;
pub mod score;
mod settle;
pub mod shapes;
pub mod significance;
pub mod simplify;
pub mod smoothing;
mod starts;
pub mod strokes;
pub mod surrogate;
pub mod torque_form;
pub mod uncertainty;
pub mod validate;
pub mod whiteness;

#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;
