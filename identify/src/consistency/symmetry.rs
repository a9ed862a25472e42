//! Chambers and pump directions that the paper takes for alike: what the data ask for if they may differ.

use model::effects::find;

use super::{Check, Material};

/// A relative difference below which it does not matter.
const MATTERS: f64 = 0.005;

pub(super) fn checks(m: &Material) -> Vec<Check> {
    let chambers = [
        "both chambers are alike",
        "chamber 2 differs from chamber 1, beyond what the paper assumes: offer the effect chamber_asymmetry; other flow effects \
         can look alike",
    ];
    let pump = [
        "the pump works alike in both directions",
        "the pump differs with its direction: offer the effect pump_asymmetry; other flow effects can look alike",
    ];
    vec![
        one(
            m,
            "symmetry_capacity",
            "capacity of chamber 2 over chamber 1, less 1",
            "chamber_asymmetry",
            &[0.02, 0.0],
            chambers,
        ),
        one(
            m,
            "symmetry_displacement",
            "displacement of chamber 2 over chamber 1, less 1",
            "chamber_asymmetry",
            &[0.0, 0.01],
            chambers,
        ),
        one(
            m,
            "symmetry_pump",
            "gain of the pump for u > 0 over u < 0, less 1",
            "pump_asymmetry",
            &[0.01, 0.0, 0.0],
            pump,
        ),
    ]
}

/// The size of an effect's first parameter other than 0 in `start`, by one step of a refit with everything else free.
fn one(m: &Material, id: &'static str, what: &str, effect: &str, start: &[f64], say: [&str; 2]) -> Check {
    let size = start.iter().copied().find(|v| *v != 0.0).unwrap_or(0.0);
    match find(effect).and_then(|e| m.scene.direction(e, start)) {
        None => Check::open(id, what, "1", "it does not show in this campaign"),
        Some(d) => {
            let (scale, std) = m.scene.asked_for(&d);
            Check::measured(id, what, (size * scale, size * std), "1", MATTERS, say)
        }
    }
}
