//! Terms without a name: smooth functions of the signals of a port, one set per balance. They say how much of a residual
//! sits in a balance, and give a curve, where no effect of the library explains it. They claim no physics and are not part
//! of the library.

mod flow;
mod pump;
mod sensor;
mod torque;

use super::{Effect, Parameter};
use flow::EmpiricalFlow;
use pump::EmpiricalPump;
use sensor::EmpiricalSensor;
use torque::EmpiricalTorque;

/// One set of terms per balance, in the order of [`Balance::ALL`].
pub static EMPIRICAL: [&dyn Effect; 4] = [&EmpiricalTorque, &EmpiricalFlow, &EmpiricalPump, &EmpiricalSensor];

const fn term(name: &'static str, unit: &'static str, typical: f64) -> Parameter {
    Parameter { name, unit, lower: -1e3, upper: 1e3, typical, size: true }
}

/// The typical size of each term, the others at nothing.
const fn typical<const N: usize>(terms: &[Parameter; N]) -> [[f64; N]; N] {
    let mut out = [[0.0; N]; N];
    let mut i = 0;
    while i < N {
        out[i][i] = terms[i].typical;
        i += 1;
    }
    out
}

/// The rows as a header's starts.
const fn each_alone<const N: usize>(rows: &'static [[f64; N]; N]) -> [&'static [f64]; N] {
    let mut out: [&'static [f64]; N] = [&[]; N];
    let mut i = 0;
    while i < N {
        out[i] = &rows[i];
        i += 1;
    }
    out
}

const VALIDITY: &str = "the range of the data it was fitted to";
const MEASURE: &str = "not a physical effect: look at the curve for one";

/// Growth with running time, 1 - exp(-t/30 s).
fn grown(time_s: f64) -> f64 {
    1.0 - (-time_s / 30.0).exp()
}

#[cfg(test)]
mod tests {
    use super::super::Law;

    /// Values of a set's terms: this size of one of them, nothing of the others.
    pub fn alone<L: Law>(term: &str, size: f64) -> Vec<f64> {
        let terms = L::HEADER.parameters;
        assert!(terms.iter().any(|p| p.name == term), "{term} is a term");
        terms.iter().map(|p| if p.name == term { size } else { 0.0 }).collect()
    }
}
