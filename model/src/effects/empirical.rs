//! Terms without a name: smooth functions of the signals of a port, one set per balance. They say how much of a residual
//! sits in a balance, and give a curve, where no effect of the library explains it. They claim no physics and are not part
//! of the library.

mod flow;
mod pump;
mod sensor;
mod torque;

use super::{Effect, Parameter};
use crate::scalar::Scalar;
use flow::EmpiricalFlow;
use pump::EmpiricalPump;
use sensor::EmpiricalSensor;
use torque::EmpiricalTorque;

/// One set of terms per balance, in the order of [`Balance::ALL`].
pub static EMPIRICAL: [&dyn Effect; 4] = [&EmpiricalTorque, &EmpiricalFlow, &EmpiricalPump, &EmpiricalSensor];

/// The effect is one of these sets: a sum of terms, each of which is one parameter's and has its start at the parameter's place.
pub fn is_nameless(effect: &dyn Effect) -> bool {
    EMPIRICAL.iter().any(|set| set.header().id == effect.header().id)
}

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

/// What an orifice passes at a pressure difference, ml/s for one ml/(s sqrt(bar)); laminar within 0.05 bar.
fn through_orifice<S: Scalar>(dp_bar: S) -> S {
    dp_bar / (dp_bar * dp_bar + S::constant(0.05 * 0.05)).sqrt().sqrt()
}

/// Growth with running time, 1 - exp(-t/30 s).
fn grown(time_s: f64) -> f64 {
    1.0 - (-time_s / 30.0).exp()
}

/// Phase by angle (rad/rad) of the terms that repeat within the stroke: apart by about what a stroke of two radians can tell apart, above what the powers of
/// the angle bend to.
const WAVES: [f64; 7] = [6.0, 9.0, 12.0, 15.0, 18.0, 21.0, 24.0];
/// Between two of them, and half of the first, rad/rad.
const BETWEEN_WAVES: f64 = 3.0;

/// Sum of a sine and a cosine of each wave; `k`: their sizes, in this order.
fn waves<S: Scalar>(k: &[S], angle_rad: S) -> S {
    let (step_sine, step_cosine) = (BETWEEN_WAVES * angle_rad.value()).sin_cos();
    let (mut sine, mut cosine) = (step_sine, step_cosine);
    let (mut sum, mut slope) = (S::constant(0.0), 0.0);
    for (wave, k) in WAVES.into_iter().zip(k.chunks_exact(2)) {
        // each phase is the one before and a step: their sines follow from the step's, which costs far less than to ask for each
        (sine, cosine) = (sine * step_cosine + cosine * step_sine, cosine * step_cosine - sine * step_sine);
        sum += k[0] * sine + k[1] * cosine;
        slope += wave * (k[0].value() * cosine - k[1].value() * sine);
    }
    sum + angle_rad.chain(0.0, slope)
}

#[cfg(test)]
mod tests {
    use super::super::Law;
    use super::through_orifice;

    #[test]
    fn an_orifice_passes_the_root_of_the_pressure_and_a_gap_s_flow_where_there_is_little() {
        assert!((through_orifice(9.0) - 3.0f64).abs() < 1e-4 && (through_orifice(-9.0) + 3.0f64).abs() < 1e-4);
        assert_eq!(through_orifice(0.0), 0.0f64);
        let slope: f64 = through_orifice(1e-6) / 1e-6;
        assert!((slope - 1.0 / 0.05f64.sqrt()).abs() < 1e-3, "{slope}");
    }

    /// Values of a set's terms: this size of one of them, nothing of the others.
    pub fn alone<L: Law>(term: &str, size: f64) -> Vec<f64> {
        let terms = L::HEADER.parameters;
        assert!(terms.iter().any(|p| p.name == term), "{term} is a term");
        terms.iter().map(|p| if p.name == term { size } else { 0.0 }).collect()
    }
}
