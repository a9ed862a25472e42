//! The same parameter from two experiments: its own, and all others together.

use model::parameters::{NAMES, UNITS, index};
use nalgebra::{DMatrix, DVector};
use recordings::Protocol;

use super::{Check, Material};
use crate::prepare::Stretch;

/// Relative difference below which it does not matter.
const MATTERS: f64 = 0.01;

/// Parameters with the experiment that is made for them.
const OWN: [(Protocol, &[usize]); 4] = {
    use index::*;
    [
        (Protocol::TorqueMap, &[M1, M2, M3]),
        (Protocol::PumpMap, &[F1, F2, F3, F4]),
        (Protocol::ClampSteps, &[H1, H2, H3, A1]),
        (Protocol::VolumeMap, &[V1, V2]),
    ]
};

pub(super) fn checks(m: &Material) -> Vec<Check> {
    let mut out = Vec::new();
    for (protocol, parameters) in OWN {
        let own = alone(m, parameters, |s| s.protocol == Some(protocol));
        let others = alone(m, &[], |s| s.protocol != Some(protocol));
        for &p in parameters {
            let what = format!("{} from {} less that from all other runs", NAMES[p], protocol.as_str());
            let of = |set: &[(usize, f64, f64)]| set.iter().find(|(q, _, _)| *q == p).map(|(_, v, s)| (*v, *s));
            let (Some((a, sa)), Some((b, sb))) = (of(&own), of(&others)) else {
                out.push(Check::open("agreement", what, UNITS[p], "one of the two does not determine it"));
                continue;
            };
            let say = [
                "both experiments agree",
                "two experiments contradict each other: the model lacks something that acts in one of them, or a sensor is off in one",
            ];
            let matters = MATTERS * a.abs().max(b.abs());
            out.push(Check::measured("agreement", what, (a - b, sa.hypot(sb)), UNITS[p], matters, say));
        }
    }
    out
}

/// Plant parameters (position, value, standard error) as these stretches alone have them: one step from the joint fit. `only`: the
/// parameters that may move, the others as in the joint fit; empty: all.
fn alone(m: &Material, only: &[usize], keep: impl Fn(&Stretch) -> bool) -> Vec<(usize, f64, f64)> {
    let fit = &m.identified.fit;
    let problem = &m.identified.problem;
    let columns = fit.layout.len();
    let may = |i: &usize| *i < fit.layout.base.len() && (only.is_empty() || only.contains(&fit.layout.base[*i]));
    let entries: Vec<usize> = (0..columns).filter(may).collect();
    let n = entries.len();
    let (mut matrix, mut gradient) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
    let (mut targets, mut square) = (0usize, 0.0);
    for (s, piece) in m.scene.pieces.iter().enumerate().filter(|(s, _)| keep(&problem.stretches[*s])) {
        let std = &problem.stretches[s].initial_std;
        let (rows, prior) = m.scene.normal.without_initial(s, piece, columns, &fit.point.initial[s], std);
        for (row, r) in rows.chunks(columns).zip(&piece.residual) {
            for (i, &a) in entries.iter().enumerate() {
                gradient[i] += row[a] * r;
                for (j, &b) in entries.iter().enumerate().take(i + 1) {
                    matrix[(i, j)] += row[a] * row[b];
                }
            }
            square += r * r;
        }
        for (i, &a) in entries.iter().enumerate() {
            gradient[i] += prior[a];
        }
        targets += piece.residual.len();
    }
    if targets <= n {
        return Vec::new();
    }
    matrix.fill_upper_triangle_with_lower_triangle();
    let misfit = (square / targets as f64).max(1.0);
    let covariance = crate::normal::covariance(&matrix);
    let step = covariance.map(|v| if v.is_finite() { v } else { 0.0 }) * gradient;
    let known = |i: usize| {
        let p = fit.layout.base[entries[i]];
        let value = fit.point.theta[entries[i]];
        // colour widens it as it does in the joint fit
        let std = (covariance[(i, i)] * misfit).sqrt() * m.uncertainty.widening(p).unwrap_or(1.0);
        let size = value.abs().max(crate::determined::scale(p));
        // a step beyond this is none of a linear model
        (std.is_finite() && std < 0.3 * size && step[i].abs() < 0.5 * size).then(|| (p, value + step[i], std))
    };
    (0..n).filter_map(known).collect()
}
