//! Rows of a recording that belong together.

use recordings::{Protocol, Recording};

use crate::noise::mean;

/// Protocols whose quantities change over seconds.
pub(super) fn slow(protocol: Protocol) -> bool {
    matches!(protocol, Protocol::TorqueMap | Protocol::VolumeMap | Protocol::PumpMap | Protocol::ClampSteps)
}

/// Voltage or valves are others in this row than in the one before.
pub(super) fn is_switched(r: &Recording, i: usize) -> bool {
    r.voltage_v[i] != r.voltage_v[i - 1]
        || r.brake_open[i] != r.brake_open[i - 1]
        || r.bypass_open[i] != r.bypass_open[i - 1]
}

/// Every row `spacing_s` apart, and those where an input or the segment changes or a sparse reading stands.
pub(super) fn thinned(r: &Recording, spacing_s: f64) -> Recording {
    let sparse = r.volume_ml.iter().filter(|v| v.is_finite()).count() * 5 < r.len();
    let mut keep = Vec::new();
    let mut last = f64::NEG_INFINITY;
    for i in 0..r.len() {
        let changed = i > 0 && (r.segment[i] != r.segment[i - 1] || is_switched(r, i));
        if changed || r.time_s[i] - last > spacing_s - 1e-6 || (sparse && r.volume_ml[i].is_finite()) {
            keep.push(i);
            last = r.time_s[i];
        }
    }
    if keep.len() == r.len() {
        return r.clone();
    }
    let pick = |v: &[f64]| keep.iter().map(|&i| v[i]).collect();
    Recording {
        time_s: pick(&r.time_s),
        voltage_v: pick(&r.voltage_v),
        angle_deg: pick(&r.angle_deg),
        pressure1_bar: pick(&r.pressure1_bar),
        pressure2_bar: pick(&r.pressure2_bar),
        torque_nm: pick(&r.torque_nm),
        volume_ml: pick(&r.volume_ml),
        brake_open: keep.iter().map(|&i| r.brake_open[i]).collect(),
        bypass_open: keep.iter().map(|&i| r.bypass_open[i]).collect(),
        segment: keep.iter().map(|&i| r.segment[i]).collect(),
    }
}

/// Rows `[first, end)` of each segment, in order.
pub fn segments(r: &Recording) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut first = 0;
    for i in 1..=r.len() {
        if i == r.len() || r.segment[i] != r.segment[first] {
            out.push((first, i));
            first = i;
        }
    }
    out
}

/// Rows of the initial rest: voltage 0 from the start on, at most until it first differs.
pub(super) fn rest_rows(r: &Recording) -> Option<usize> {
    let moved = r.voltage_v.iter().position(|u| *u != 0.0).unwrap_or(r.len());
    let rows = moved.min(r.time_s.partition_point(|t| *t < r.time_s[0] + 1.5));
    (rows >= 10 && r.time_s[rows - 1] - r.time_s[0] > 0.1).then_some(rows)
}

/// First rows of blocks that last `length_s`.
pub(super) fn block_starts(time_s: &[f64], length_s: f64) -> Vec<usize> {
    let mut out = vec![0];
    let mut start = time_s[0];
    for (i, t) in time_s.iter().enumerate() {
        if *t - start > length_s - 1e-6 {
            out.push(i);
            start = *t;
        }
    }
    out
}

/// Rows `[first, end)` of the torque map during which the lever is clamped at one angle: segments in a row whose torque is
/// read and whose mean angles agree.
pub(super) fn dwells(r: &Recording, segments: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut out: Vec<(usize, usize)> = Vec::new();
    let mut last_angle = f64::NAN;
    for &(first, end) in segments {
        let (_, readings) = mean(r.torque_nm[first..end].iter().copied());
        let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
        if readings * 2 > end - first {
            match out.last_mut() {
                Some(dwell) if dwell.1 == first && (angle - last_angle).abs() < 0.3 => dwell.1 = end,
                _ => out.push((first, end)),
            }
            last_angle = angle;
        }
    }
    out.retain(|(first, end)| end - first >= 20);
    out
}

/// Rows `[first, end)` of each filling of the clamp-steps protocol: the cylinder starts at 0 anew.
pub(super) fn fillings(r: &Recording, segments: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut starts = Vec::new();
    let mut last = f64::INFINITY;
    let mut last_angle = f64::NAN;
    for &(first, end) in segments {
        let (reading, n) = mean(r.volume_ml[first..end].iter().copied());
        let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
        if n > 0 && (reading < last - 0.5 || (angle - last_angle).abs() > 1.0) {
            starts.push(first);
        }
        if n > 0 {
            last = reading;
        }
        last_angle = angle;
    }
    starts.push(r.len());
    starts.windows(2).map(|w| (w[0], w[1])).collect()
}
