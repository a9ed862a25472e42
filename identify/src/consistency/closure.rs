//! Eqs. (13) and (14) have no common volume V(p, phi) unless a1 = 0: oil that the model gains or loses each cycle.

use model::effects::find;
use model::rec;
use recordings::{Protocol, Recording};

use super::{Check, Material, Outcome};
use crate::figures::text::{number, run_name};
use crate::prepare::segments;

/// Oil (ml a cycle) below which the defect does not matter.
const MATTERS_ML: f64 = 0.02;

pub(super) fn checks(m: &Material) -> Vec<Check> {
    let fit = &m.identified.fit;
    let k = fit.layout.parameters(&fit.point.theta).to_vector();
    let mut out = Vec::new();
    let cycle = m.loaded.runs.iter().filter(|r| r.entry.protocol == Protocol::SquareWave).find_map(|r| {
        let rows = one_period(&r.recording)?;
        Some((run_name(&r.entry.file), path(&r.recording, rows)))
    });
    match cycle {
        None => out.push(Check::open(
            "closure_defect",
            "closure defect of eqs. (13), (14)",
            "ml a cycle",
            "a square-wave run with both signs is needed",
        )),
        Some((name, path)) => {
            for (chamber, defect) in (1..).zip(closure_defect_ml(&k, &path)) {
                let outcome = if defect.abs() > MATTERS_ML { Outcome::Fails } else { Outcome::Holds };
                let meaning = format!(
                    "loop integral of C_h dp + C_v dphi over one period of {name}. {}",
                    match outcome {
                        Outcome::Fails =>
                            "The model gains or loses this oil each cycle though every flow balances; the effect \
                             displacement_pressure with closure = 1 closes it",
                        _ => "Too little to matter",
                    }
                );
                let what = format!("closure defect of chamber {chamber}, eqs. (13), (14)");
                let (value, unit) = (Some(defect), "ml a cycle");
                out.push(Check { id: "closure_defect", what, value, std: None, unit, outcome, meaning });
            }
        }
    }
    out.push(asked_for(m));
    out
}

/// Whether the data ask for the form that closes.
fn asked_for(m: &Material) -> Check {
    let (id, what) =
        ("closing_form", "share of the closing form (displacement_pressure, closure) that the data ask for");
    let direction = find("displacement_pressure").and_then(|e| m.scene.direction(e, &[0.3, 0.0, 0.0]));
    match direction {
        None => Check::open(id, what, "1", "angle and pressure hardly change in this campaign"),
        Some(d) => {
            let (scale, std) = m.scene.asked_for(&d);
            let (value, std) = (0.3 * scale, 0.3 * std);
            let against = (1.0 - value) / std;
            let say = [
                "the data do not ask for it: the rig behaves as eqs. (13), (14) say, defect included".to_string(),
                format!(
                    "the flow balance is better with it: offer the effect displacement_pressure (bench diagnose does); the full form, \
                     1, is {} standard errors away",
                    number(against.abs(), 2)
                ),
            ];
            Check::measured(id, what, (value, std), "1", 0.05, [&say[0], &say[1]])
        }
    }
}

/// Rows `[first, end)` of two half waves of opposite sign in the middle of the run.
fn one_period(r: &Recording) -> Option<(usize, usize)> {
    let halves: Vec<(usize, usize)> = segments(r).into_iter().filter(|s| r.voltage_v[s.0] != 0.0).collect();
    let middle = halves.len() / 2;
    let (a, b) = (*halves.get(middle.checked_sub(1)?)?, *halves.get(middle)?);
    (a.1 == b.0 && r.voltage_v[a.0] * r.voltage_v[b.0] < 0.0).then_some((a.0, b.1))
}

/// Angle (rad) and pressures (bar absolute) along these rows, missing samples left out.
fn path(r: &Recording, (first, end): (usize, usize)) -> Vec<[f64; 3]> {
    let rows = (first..end).map(|i| [r.angle_deg[i].to_radians(), r.pressure1_bar[i], r.pressure2_bar[i]]);
    rows.filter(|x| x.iter().all(|v| v.is_finite())).collect()
}

/// Loop integral of C_h dp + C_v dphi for both chambers, ml, along a path that is closed by a straight line.
pub fn closure_defect_ml(k: &[f64], path: &[[f64; 3]]) -> [f64; 2] {
    let mut sum = taken_up_ml(k, path);
    if let (Some(first), Some(last)) = (path.first(), path.last()) {
        // the straight line is long: in small pieces
        let at = |i: i32| std::array::from_fn(|j| last[j] + (first[j] - last[j]) * f64::from(i) / 100.0);
        let line: Vec<[f64; 3]> = (0..=100).map(at).collect();
        let back = taken_up_ml(k, &line);
        sum = [0, 1].map(|i| sum[i] + back[i]);
    }
    sum
}

/// Integral of C_h dp + C_v dphi, eqs. (13), (14), for both chambers along a path of angles (rad) and pressures (bar absolute), ml:
/// the oil that flowed into each. The middle of each piece counts, so that noise has no drift.
pub(super) fn taken_up_ml(k: &[f64], path: &[[f64; 3]]) -> [f64; 2] {
    let mut sum = [0.0; 2];
    for w in path.windows(2) {
        let (a, b) = (&w[0], &w[1]);
        let middle: [f64; 3] = std::array::from_fn(|i| 0.5 * (a[i] + b[i]));
        let capacity = rec::capacity(k, middle[0], [middle[1], middle[2]]);
        let displacement = rec::displacement(k, middle[0]);
        for j in 0..2 {
            sum[j] += capacity[j] * (b[j + 1] - a[j + 1]) + displacement[j] * (b[0] - a[0]);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Parameters;

    fn rectangle() -> Vec<[f64; 3]> {
        let corners = [[-0.4, 2.0, 4.0], [0.4, 2.0, 4.0], [0.4, 4.0, 2.0], [-0.4, 4.0, 2.0], [-0.4, 2.0, 4.0]];
        let mut out = Vec::new();
        for w in corners.windows(2) {
            out.extend((0..2000).map(|i| {
                let f = f64::from(i) / 2000.0;
                std::array::from_fn(|j| w[0][j] + (w[1][j] - w[0][j]) * f)
            }));
        }
        out
    }

    #[test]
    fn the_defect_of_a_rectangle_is_the_capacity_s_change_over_it() {
        let p = Parameters::example();
        let defect = closure_defect_ml(&p.to_vector(), &rectangle());
        let c = p.capacity;
        let n = c.h2 + 1.0;
        let stored = c.h1 * (4f64.powf(n) - 2f64.powf(n)) / n + c.h3 * 2.0;
        let degrees = 0.4f64.to_degrees();
        let theory = ((-c.a1 * degrees).exp() - (c.a1 * degrees).exp()) * stored;
        assert!((defect[0] - theory).abs() < 1e-5 * theory.abs(), "{defect:?} {theory}");
        assert!((defect[1] - theory).abs() < 1e-5 * theory.abs(), "mirrored chamber, mirrored path");
        assert!(theory.abs() > 0.5);
    }

    #[test]
    fn without_a1_there_is_none() {
        let mut p = Parameters::example();
        p.capacity.a1 = 0.0;
        let defect = closure_defect_ml(&p.to_vector(), &rectangle());
        assert!(defect.iter().all(|d| d.abs() < 1e-5), "{defect:?}");
    }
}
