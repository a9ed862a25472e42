//! What the identified values say of the model itself: virtual work, and the defect of eqs. (13) and (14).

use model::parameters::{COUNT, index};
use model::rec;
use recordings::{Protocol, Recording};

use crate::figure::Table;
use crate::figures::plant::Plant;
use crate::figures::text::{measured, number, run_name};
use crate::figures::{Subject, section};
use crate::prepare::segments;

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let mut rows = Vec::new();
    let last = Plant::of(subject.last());
    let k = last.parameters();
    let uncertainty = subject.uncertainty_after.unwrap_or(subject.uncertainty);
    let mut slope = [0.0; COUNT];
    slope[index::M3] = 1.0;
    slope[index::V2] = -0.1;
    if let Some(std) = uncertainty.of_combination(&slope) {
        let difference = k[index::M3] - 0.1 * k[index::V2];
        rows.push(vec![
            "m3 - 0.1 v2 / Nm/bar".into(),
            measured(difference, std),
            number(std, 2),
            "virtual work: 0 as far as the chamber wall stores no energy of its own".into(),
        ]);
    }
    let cycle = subject.loaded.runs.iter().filter(|r| r.entry.protocol == Protocol::SquareWave).find_map(|r| {
        let rows = one_period(&r.recording)?;
        Some((run_name(&r.entry.file), path(&r.recording, rows)))
    });
    if let Some((name, path)) = cycle {
        for (chamber, defect) in (1..).zip(closure_defect_ml(k, &path)) {
            rows.push(vec![
                format!("closure defect of chamber {chamber} / ml a cycle"),
                number(defect, 3),
                String::new(),
                format!(
                    "loop integral of C_h dp + C_v dphi, eqs. (13), (14), over one period of {name}: 0 for a chamber that has a \
                     volume V(p, phi); what is not 0 is oil that the model gains or loses each cycle though every flow balances"
                ),
            ]);
        }
    }
    vec![Table {
        section: section::IDENTIFICATION.into(),
        title: "Consistency checks".into(),
        caption: "Of the model's equations with the identified values.".into(),
        columns: ["check", "value", "std. error", "meaning"].map(String::from).to_vec(),
        rows,
    }]
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

/// Loop integral of C_h dp + C_v dphi for both chambers, ml, along a path that is closed by a straight line. The middle of
/// each piece counts, so that noise has no drift.
fn closure_defect_ml(k: &[f64], path: &[[f64; 3]]) -> [f64; 2] {
    let mut sum = [0.0; 2];
    let mut add = |a: &[f64; 3], b: &[f64; 3]| {
        let middle: [f64; 3] = std::array::from_fn(|i| 0.5 * (a[i] + b[i]));
        let capacity = rec::capacity(k, middle[0], [middle[1], middle[2]]);
        let displacement = rec::displacement(k, middle[0]);
        for j in 0..2 {
            sum[j] += capacity[j] * (b[j + 1] - a[j + 1]) + displacement[j] * (b[0] - a[0]);
        }
    };
    for w in path.windows(2) {
        add(&w[0], &w[1]);
    }
    if let (Some(first), Some(last)) = (path.first(), path.last()) {
        // the straight line is long: in small pieces
        for i in 0..100 {
            let at = |f: f64| std::array::from_fn(|j| last[j] + (first[j] - last[j]) * f);
            add(&at(f64::from(i) / 100.0), &at(f64::from(i + 1) / 100.0));
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
