//! The paper's component experiments, each evaluated by itself as in the paper: data points for the figures, and the values
//! from which the joint fit starts.

use std::f64::consts::PI;

use model::Parameters;
use model::parameters::Capacity;
use nalgebra::{DMatrix, DVector};
use recordings::Recording;

use crate::noise::mean;
use crate::prepare::{Channel, Stand, Stretch, is_read, segments};
use crate::strokes::{Steady, strokes};

/// A clamped point of the torque map, fig. 2.
#[derive(Clone, Copy, Debug)]
pub struct TorquePoint {
    /// degrees
    pub angle_deg: f64,
    /// bar
    pub dp_bar: f64,
    /// Nm
    pub torque_nm: f64,
}

/// A segment of the pump map, fig. 5.
#[derive(Clone, Copy, Debug)]
pub struct PumpPoint {
    /// V
    pub voltage_v: f64,
    /// Across the ports, bar.
    pub dp_bar: f64,
    /// From port 2 to port 1, ml/s.
    pub flow_ml_s: f64,
}

/// A release of the clamp-steps, fig. 6.
#[derive(Clone, Copy, Debug)]
pub struct CapacityPoint {
    /// degrees
    pub angle_deg: f64,
    /// Middle of the step, bar absolute.
    pub pressure_bar: f64,
    /// ml/bar
    pub capacity_ml_bar: f64,
}

/// An interval of steady velocity, fig. 7.
#[derive(Clone, Copy, Debug)]
pub struct LossPoint {
    /// rad/s
    pub velocity_rad_s: f64,
    /// Mean pressure load p1 + p2 in the interval, bar absolute.
    pub load_bar: f64,
    /// Mean angle, degrees.
    pub angle_deg: f64,
    /// Mean pressure difference, bar.
    pub dp_bar: f64,
}

/// Torque-map points: the last third of each clamped segment.
pub fn torque_points(r: &Recording) -> Vec<TorquePoint> {
    let mut out = Vec::new();
    for (first, end) in segments(r) {
        let late = end - (end - first).div_ceil(3);
        let (torque_nm, _) = mean(r.torque_nm[late..end].iter().copied());
        if is_read(r, &r.torque_nm, late, end) && r.time_s[end - 1] - r.time_s[first] > 1.0 {
            let (angle_deg, _) = mean(r.angle_deg[late..end].iter().copied());
            let dp = (late..end).map(|i| r.pressure1_bar[i] - r.pressure2_bar[i]);
            out.push(TorquePoint { angle_deg, dp_bar: mean(dp).0, torque_nm });
        }
    }
    out
}

/// Pump-map points: the slope of the volume over time in each segment.
pub fn pump_points(r: &Recording) -> Vec<PumpPoint> {
    let mut out = Vec::new();
    for (first, end) in segments(r) {
        let rows: Vec<usize> = (first..end).filter(|&i| r.volume_ml[i].is_finite()).collect();
        if rows.len() < 3 {
            continue;
        }
        let (t, _) = mean(rows.iter().map(|&i| r.time_s[i]));
        let (v, _) = mean(rows.iter().map(|&i| r.volume_ml[i]));
        let (mut tt, mut tv) = (0.0, 0.0);
        for &i in &rows {
            tt += (r.time_s[i] - t).powi(2);
            tv += (r.time_s[i] - t) * (r.volume_ml[i] - v);
        }
        let (dp_bar, _) = mean((first..end).map(|i| r.pressure1_bar[i] - r.pressure2_bar[i]));
        let voltage_v = r.voltage_v[first];
        out.push(PumpPoint { voltage_v, dp_bar, flow_ml_s: tv / tt * if voltage_v < 0.0 { -1.0 } else { 1.0 } });
    }
    out
}

/// Clamp-steps points, eq. (12): released volume over the fall of the pressure.
pub fn capacity_points(stretches: &[&Stretch]) -> Vec<CapacityPoint> {
    let mut out = Vec::new();
    for s in stretches.iter().filter(|s| s.stand == Stand::Drained) {
        let mut last = (0.0, s.pressure_bar[0][0]);
        for t in s.targets.iter().filter(|t| t.channel == Channel::Volume) {
            let p = s.pressure_bar[0][t.middle];
            if (last.1 - p).abs() > 1e-3 {
                out.push(CapacityPoint {
                    angle_deg: s.angle_rad[0] * 180.0 / PI,
                    pressure_bar: 0.5 * (p + last.1),
                    capacity_ml_bar: (t.measured - last.0) / (last.1 - p),
                });
            }
            last = (t.measured, p);
        }
    }
    out
}

/// Intervals of steady velocity: one point for each stroke that has one.
pub fn loss_points(r: &Recording) -> Vec<LossPoint> {
    strokes(r)
        .into_iter()
        .filter_map(|stroke| stroke.steady)
        .map(|steady| {
            let Steady { rows, velocity_deg_s, .. } = steady;
            let pressures = |combined: fn(f64, f64) -> f64| {
                mean(rows.clone().map(|i| combined(r.pressure1_bar[i], r.pressure2_bar[i]))).0
            };
            LossPoint {
                velocity_rad_s: velocity_deg_s.to_radians(),
                load_bar: pressures(|p1, p2| p1 + p2),
                angle_deg: mean(r.angle_deg[rows.clone()].iter().copied()).0,
                dp_bar: pressures(|p1, p2| p1 - p2),
            }
        })
        .collect()
}

/// Torque (2) from its points: m1, m2, m3 by linear least squares.
pub fn fit_torque(points: &[TorquePoint], p: &mut Parameters) -> bool {
    let rows = points.iter().map(|q| {
        let phi = q.angle_deg.to_radians();
        (vec![q.dp_bar.abs() * phi, phi, q.dp_bar], q.torque_nm)
    });
    linear(rows).is_some_and(|(x, _)| {
        (p.torque.m1, p.torque.m2, p.torque.m3) = (x[0], x[1], x[2]);
        x[2] > 0.0
    })
}

/// Pump (10) from its points: those out of the dead zone give f1..f4, which shows which ones are.
pub fn fit_pump(points: &[PumpPoint], p: &mut Parameters) -> bool {
    let mut outside: Vec<bool> = points.iter().map(|q| q.voltage_v != 0.0).collect();
    let mut found = false;
    for _ in 0..5 {
        let rows = points.iter().zip(&outside).filter(|(_, o)| **o).map(|(q, _)| {
            let s = q.voltage_v.signum();
            (vec![q.voltage_v.abs() * s, q.voltage_v.abs() * q.dp_bar, q.dp_bar, s], q.flow_ml_s)
        });
        let Some((x, _)) = linear(rows) else { break };
        let pump = &mut p.pump;
        (pump.f1, pump.f2, pump.f3, pump.f4) = (x[0], x[1], x[2], x[3]);
        found = pump.f1 > 0.0;
        let again: Vec<bool> = points
            .iter()
            .map(|q| pump.f1 * q.voltage_v.abs() + pump.f4 + pump.f2 * q.voltage_v * q.dp_bar > 0.05)
            .collect();
        if again == outside {
            break;
        }
        outside = again;
    }
    found
}

/// Capacity (13) from the clamp-steps: h1, h3 linear for each (h2, a1) of a grid.
pub fn fit_capacity(stretches: &[&Stretch], p: &mut Parameters) -> bool {
    let mut readings = Vec::new();
    for s in stretches.iter().filter(|s| s.stand == Stand::Drained) {
        for t in s.targets.iter().filter(|t| t.channel == Channel::Volume) {
            readings.push((s.angle_rad[0] * 180.0 / PI, s.pressure_bar[0][0], s.pressure_bar[0][t.middle], t.measured));
        }
    }
    if readings.len() < 6 {
        return false;
    }
    let mut best = f64::INFINITY;
    for i in 0..=28 {
        let h2 = -4.0 + 0.2 * f64::from(i) + 1e-3;
        for j in -12..=12 {
            let a1 = 0.0015 * f64::from(j);
            let rows = readings.iter().map(|&(angle, from, to, volume)| {
                let bend = (-a1 * angle).exp();
                let n = h2 + 1.0;
                (vec![bend * (from.powf(n) - to.powf(n)) / n, bend * (from - to)], volume)
            });
            if let Some((x, sse)) = linear(rows)
                && sse < best
                && x[0] > 0.0
            {
                best = sse;
                let c = &mut p.capacity;
                (c.h1, c.h2, c.h3, c.a1, c.a2) = (x[0], h2, x[1], a1, 0.0);
            }
        }
    }
    best.is_finite()
}

/// Capacity (13) in the paper's two steps (4.2), from its points: over the pressure alone at the angle nearest to 0, then what
/// every angle scales that by, exponentially. `None` without three pressures there and another angle.
pub fn capacity_in_two_steps(points: &[CapacityPoint]) -> Option<Capacity> {
    let middle = points.iter().map(|p| p.angle_deg).min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let here: Vec<&CapacityPoint> = points.iter().filter(|p| (p.angle_deg - middle).abs() < SAME_ANGLE_DEG).collect();
    let mut best: Option<(f64, [f64; 3])> = None;
    for i in 0..=140 {
        let h2 = -4.0 + 0.025 * f64::from(i);
        let rows = here.iter().map(|p| (vec![p.pressure_bar.powf(h2), 1.0], p.capacity_ml_bar));
        if let Some((x, sse)) = linear(rows).filter(|_| here.len() > 2)
            && x[0] > 0.0
            && best.is_none_or(|(least, _)| sse < least)
        {
            best = Some((sse, [x[0], h2, x[1]]));
        }
    }
    let (_, [h1, h2, h3]) = best?;
    let rows = points.iter().map(|p| {
        let scaled = p.capacity_ml_bar / (h1 * p.pressure_bar.powf(h2) + h3);
        (vec![-p.angle_deg, -1.0], scaled.ln())
    });
    let (x, _) = linear(rows)?;
    Some(Capacity { h1, h2, h3, a1: x[0], a2: x[1] })
}

/// Clamped angles that are one, degrees.
const SAME_ANGLE_DEG: f64 = 2.0;

/// Displacement (14) from the volume map: what the capacity must take up while the lever sweeps.
pub fn fit_displacement(stretches: &[&Stretch], p: &mut Parameters) -> bool {
    let c = p.capacity;
    let mut rows = Vec::new();
    for s in stretches.iter().filter(|s| s.stand == Stand::LedShutOff) {
        for (channel, side) in [(Channel::Pressure1, 1.0), (Channel::Pressure2, -1.0)] {
            let mut stored = 0.0;
            let mut last: Option<(f64, f64)> = None;
            let mut first = None;
            for t in s.targets.iter().filter(|t| t.channel == channel) {
                let phi = mean(s.angle_rad[t.middle.saturating_sub(5)..(t.middle + 5).min(s.rows())].iter().copied()).0;
                if let Some((phi0, p0)) = last {
                    let middle = side * 0.5 * (phi + phi0) * 180.0 / PI;
                    let at = 0.5 * (t.measured + p0);
                    stored += (-c.a1 * middle).exp() * (c.h1 * at.powf(c.h2) + c.h3) * (t.measured - p0);
                }
                last = Some((phi, t.measured));
                let start = *first.get_or_insert(phi);
                rows.push((vec![0.5 * (phi * phi - start * start), side * (phi - start)], -stored));
            }
        }
    }
    linear(rows.into_iter()).is_some_and(|(x, _)| {
        (p.displacement.v1, p.displacement.v2) = (x[0], x[1]);
        x[1] > 0.0
    })
}

/// Losses (16) from the intervals of steady velocity, with the torque of eq. (2): a straight line l2*w + l3 for each
/// threshold of a grid. The quadratic term waits for the joint fit: the strokes' range of speed seldom carries it.
pub fn fit_losses(points: &[LossPoint], p: &mut Parameters) -> bool {
    let torque = p.torque;
    let at = |q: &LossPoint| {
        let phi = q.angle_deg.to_radians();
        let m = (torque.m1 * q.dp_bar.abs() + torque.m2) * phi + torque.m3 * q.dp_bar;
        (q.velocity_rad_s.abs(), m * q.velocity_rad_s.signum())
    };
    let mut best = f64::INFINITY;
    for i in 0..=26 {
        let a = 0.004 * 1.1f64.powi(i);
        let rows = points.iter().map(|q| {
            let (w, m) = at(q);
            (if w >= a { vec![w, 1.0] } else { vec![w, w / a] }, m)
        });
        if let Some((x, sse)) = linear(rows)
            && sse < best
            && x[0] >= 0.0
            && x[1] > 0.0
        {
            best = sse;
            let l = &mut p.losses;
            (l.l1, l.l2, l.l3, l.a) = (0.0, x[0], x[1], a);
            l.l4 = (l.l2 * a + l.l3) / a;
        }
    }
    best.is_finite()
}

/// Linear least squares: rows of (regressors, value); solution and sum of squares. `None` without full rank.
fn linear(rows: impl Iterator<Item = (Vec<f64>, f64)>) -> Option<(Vec<f64>, f64)> {
    let rows: Vec<(Vec<f64>, f64)> = rows.filter(|(x, y)| y.is_finite() && x.iter().all(|v| v.is_finite())).collect();
    let n = rows.first()?.0.len();
    if rows.len() < n {
        return None;
    }
    let a = DMatrix::from_fn(rows.len(), n, |i, j| rows[i].0[j]);
    let b = DVector::from_fn(rows.len(), |i, _| rows[i].1);
    let scale: Vec<f64> = (0..n).map(|j| a.column(j).norm().max(1e-300)).collect();
    let scaled = DMatrix::from_fn(rows.len(), n, |i, j| a[(i, j)] / scale[j]);
    let svd = scaled.svd(true, true);
    if svd.rank(1e-7) < n {
        return None;
    }
    let x = svd.solve(&b, 1e-12).ok()?;
    let x: Vec<f64> = (0..n).map(|j| x[j] / scale[j]).collect();
    let sse = (a * DVector::from_vec(x.clone()) - b).norm_squared();
    Some((x, sse))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_s_two_steps_give_the_capacity_that_made_the_points() {
        let capacity = Capacity { h1: 7.6, h2: -1.5, h3: 0.9, a1: 0.008, a2: 0.0 };
        let point = |angle_deg: f64, pressure_bar: f64| CapacityPoint {
            angle_deg,
            pressure_bar,
            capacity_ml_bar: (-capacity.a1 * angle_deg).exp()
                * (capacity.h1 * pressure_bar.powf(capacity.h2) + capacity.h3),
        };
        let points: Vec<CapacityPoint> =
            (-4..=4).flat_map(|n| (4..11).map(move |p| point(10.0 * f64::from(n), 0.5 * f64::from(p)))).collect();
        let found = capacity_in_two_steps(&points).unwrap();
        assert!((found.h1 - 7.6).abs() < 1e-9 && (found.h3 - 0.9).abs() < 1e-9, "{found:?}");
        assert!((found.a1 - 0.008).abs() < 1e-12 && found.a2.abs() < 1e-9, "{found:?}");
        assert!(capacity_in_two_steps(&points[..2]).is_none());
    }
}
