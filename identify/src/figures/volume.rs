//! Fig. 3: the volume characteristic of chamber 1.

use nalgebra::{DMatrix, DVector};
use recordings::{Protocol, Role};

use crate::figure::{Figure, Mark};
use crate::figures::plant::Plant;
use crate::figures::text::number;
use crate::figures::{Subject, grid, range, section, series};
use crate::fit::Fit;
use crate::noise::mean;
use crate::predict::predict_rows;
use crate::prepare::{Channel, Stand, segments};

/// Points kept of one sweep.
const POINTS_PER_SWEEP: usize = 150;
/// Pressures at which the volume is read off the sweeps, bar absolute.
const LEVELS_BAR: [f64; 5] = [2.0, 2.5, 3.0, 3.5, 4.0];

/// One amount of oil: angle (deg) and pressure 1 (bar) along the sweep, in the order of the angle.
struct Sweep {
    volume_ml: f64,
    points: Vec<(f64, f64)>,
}

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let sweeps = sweeps(subject);
    vec![volume_over_angle(subject, &sweeps), pressure_over_angle(subject, &sweeps)]
}

fn sweeps(subject: &Subject) -> Vec<Sweep> {
    let runs = subject.loaded.runs.iter();
    let runs = runs.filter(|r| r.entry.role == Role::Identify && r.entry.protocol == Protocol::VolumeMap);
    let mut out = Vec::new();
    for r in runs.map(|r| &r.recording) {
        for (first, end) in segments(r) {
            let (volume_ml, readings) = mean(r.volume_ml[first..end].iter().copied());
            let step = (end - first).div_ceil(POINTS_PER_SWEEP);
            if readings == 0 || end - first < 20 {
                continue;
            }
            let points = (first..end).step_by(step).map(|i| {
                let rows = i..(i + step).min(end);
                (mean(r.angle_deg[rows.clone()].iter().copied()).0, mean(r.pressure1_bar[rows].iter().copied()).0)
            });
            out.push(Sweep { volume_ml, points: points.filter(|p| p.0.is_finite() && p.1.is_finite()).collect() });
        }
    }
    out.sort_by(|a, b| a.volume_ml.total_cmp(&b.volume_ml));
    out
}

/// V(phi) at constant pressure: where each sweep passes the pressure.
fn volume_over_angle(subject: &Subject, sweeps: &[Sweep]) -> Figure {
    let plant = Plant::of(subject.last());
    let mut figure = Figure {
        id: "volume_map".into(),
        section: section::IDENTIFICATION.into(),
        title: "Volume characteristic of chamber 1".into(),
        caption: "Counterpart of fig. 3: the amounts of oil of the volume map at the angles where each sweep passes a pressure, \
                  and the integral of eq. (14), placed at each pressure's mean: eq. (14) knows no pressure, so where the points of one \
                  pressure are steeper than those of another the displacement depends on it."
            .into(),
        x_label: "angle / deg".into(),
        y_label: "volume / ml".into(),
        series: Vec::new(),
    };
    let (v1, v2) = (plant.parameters()[model::parameters::index::V1], plant.parameters()[model::parameters::index::V2]);
    let displaced = |angle_deg: f64| {
        let phi = angle_deg.to_radians();
        (0.5 * v1 * phi + v2) * phi
    };
    let mut polynomials = Vec::new();
    for (group, level) in LEVELS_BAR.iter().enumerate() {
        let points: Vec<(f64, f64)> =
            sweeps.iter().filter_map(|s| Some((angle_at(&s.points, *level)?, s.volume_ml))).collect();
        if points.len() < 2 {
            continue;
        }
        polynomials.extend(
            polynomial(&points).map(|(v1, v2)| format!("{level} bar: {} and {}", number(v1, 3), number(v2, 4))),
        );
        let (shift, _) = mean(points.iter().map(|(a, v)| v - displaced(*a)));
        let Some((low, high)) = range(points.iter().map(|p| p.0)) else { continue };
        figure.series.push(series(format!("{level} bar measured"), Mark::Points, group, points));
        let curve = grid(low, high, 61).map(|a| (a, shift + displaced(a)));
        figure.series.push(series(format!("{level} bar eq. (14)"), Mark::Line, group, curve));
    }
    if !polynomials.is_empty() {
        figure.caption.push_str(&format!(
            " A polynomial of second order for each pressure has v1 (ml/rad2) and v2 (ml/rad) of {}. Eq. (14) is to be the one of a middle \
             pressure; the joint fit weighs all of them, {} and {}.",
            polynomials.join(", "),
            number(v1, 3),
            number(v2, 4)
        ));
    }
    figure
}

/// v1 and v2 of a polynomial of second order through points of angle (deg) and volume (ml); `None` with fewer than four points.
fn polynomial(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let a = DMatrix::from_fn(points.len(), 3, |i, j| points[i].0.to_radians().powi(j as i32));
    let b = DVector::from_iterator(points.len(), points.iter().map(|p| p.1));
    let x = a.svd(true, true).solve(&b, 1e-9).ok().filter(|_| points.len() > 3)?;
    Some((2.0 * x[2], x[1]))
}

/// Mean angle at which a sweep passes a pressure, back and forth.
fn angle_at(points: &[(f64, f64)], pressure_bar: f64) -> Option<f64> {
    let crossings = points.windows(2).filter_map(|w| {
        let (a, b) = (w[0], w[1]);
        let passes = (a.1 - pressure_bar) * (b.1 - pressure_bar) <= 0.0 && a.1 != b.1;
        passes.then(|| a.0 + (b.0 - a.0) * (pressure_bar - a.1) / (b.1 - a.1))
    });
    let (angle, n) = mean(crossings);
    (n > 0).then_some(angle)
}

/// p(phi) at constant amounts of oil, with the models in free run.
fn pressure_over_angle(subject: &Subject, sweeps: &[Sweep]) -> Figure {
    let mut figure = Figure {
        id: "volume_map_pressure".into(),
        section: section::IDENTIFICATION.into(),
        title: "Pressure of chamber 1 at constant amounts of oil".into(),
        caption:
            "What the volume map measures: both chambers shut off, the lever led slowly. The models run free from each \
                  sweep's start with the measured angle; eqs. (13) and (14)."
                .into(),
        x_label: "angle / deg".into(),
        y_label: "pressure 1 / bar".into(),
        series: Vec::new(),
    };
    for (group, s) in sweeps.iter().enumerate() {
        figure.series.push(series(
            format!("{:.0} ml measured", s.volume_ml),
            Mark::Points,
            group,
            s.points.iter().copied(),
        ));
    }
    let (reference, last) = (curves(subject, &subject.identified.fit), curves(subject, subject.last()));
    for (volume_ml, curve) in last {
        let distance = |n: &usize| (sweeps[*n].volume_ml - volume_ml).abs();
        let group = (0..sweeps.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
        figure.series.push(series(format!("{volume_ml:.0} ml model"), Mark::Line, group, curve));
    }
    if subject.after().is_some() {
        let gap = |curve: Vec<(f64, f64)>| curve.into_iter().chain([(f64::NAN, f64::NAN)]);
        let joined = reference.into_iter().flat_map(|(_, curve)| gap(curve));
        figure.series.push(series("reference model", Mark::Dashed, sweeps.len(), joined));
        figure.caption.push_str(&format!(" Full lines: the model {}.", subject.last_name()));
    }
    figure
}

/// Amount of oil, angle (deg) and pressure 1 (bar) of each sweep of the fitted volume maps, as a model says them.
fn curves(subject: &Subject, fit: &Fit) -> Vec<(f64, Vec<(f64, f64)>)> {
    let stretches = subject.identified.problem.stretches.iter().enumerate();
    let swept = stretches.filter(|(_, s)| s.stand == Stand::LedShutOff);
    swept
        .filter_map(|(n, s)| {
            let initial = fit.point.initial.get(n).cloned().unwrap_or_else(|| vec![0.0; s.initial.len()]);
            let rows = predict_rows(s, &fit.layout, &fit.point.theta, &initial).ok()?;
            let shown = (0..s.rows()).step_by(s.rows().div_ceil(POINTS_PER_SWEEP));
            let curve = shown.map(|i| (s.angle_rad[i].to_degrees(), rows[i][Channel::Pressure1.index()]));
            Some((volume_of(subject, s.run, s.time_s[0]), curve.collect()))
        })
        .collect()
}

/// The amount of oil that a run's segment at this time holds.
fn volume_of(subject: &Subject, run: usize, time_s: f64) -> f64 {
    let r = &subject.loaded.runs[run].recording;
    let row = r.time_s.partition_point(|t| *t < time_s).min(r.len() - 1);
    let segment = r.segment[row];
    mean((0..r.len()).filter(|&i| r.segment[i] == segment).map(|i| r.volume_ml[i])).0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_volume_s_polynomial_is_that_of_eq_14() {
        let of = |a: f64| (a, 100.0 + (0.5 * -9.0 * a.to_radians() + 68.0) * a.to_radians());
        let (v1, v2) = polynomial(&[-40.0, -10.0, 0.0, 15.0, 35.0].map(of)).unwrap();
        assert!((v1 + 9.0).abs() < 1e-9 && (v2 - 68.0).abs() < 1e-9, "{v1} {v2}");
        assert_eq!(polynomial(&[of(1.0), of(2.0), of(3.0)]), None);
    }

    #[test]
    fn a_sweep_back_and_forth_gives_the_angle_in_the_middle() {
        let points = [(0.0, 4.0), (1.0, 3.0), (2.0, 2.0), (1.2, 3.0), (0.2, 4.0)];
        assert!((angle_at(&points, 3.5).unwrap() - 0.6).abs() < 1e-12);
        assert_eq!(angle_at(&points, 5.0), None);
    }
}
