//! Rows of a recording that belong together.

use recordings::{Protocol, Recording};

use super::inputs::BRIDGED_S;
use crate::noise::mean;

/// What is read from a segment of a slow protocol takes this long at least, s, which is 20 rows of those that are kept of fast ones, and as many rows of slow ones.
const LEAST_S: f64 = 0.19;
const FEWEST_ROWS: usize = 5;

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

/// Every row `spacing_s` apart, and those where an input or the segment changes or a sparse reading stands. Of a sensor that is slower than the
/// rows one value is kept for each row so far apart.
pub(super) fn thinned(r: &Recording, spacing_s: f64) -> Recording {
    let sparse = r.volume_ml.iter().filter(|v| v.is_finite()).count() * 5 < r.len();
    let columns = [&r.angle_deg, &r.pressure1_bar, &r.pressure2_bar, &r.torque_nm, &r.volume_ml];
    let slower: Vec<&Vec<f64>> = columns.into_iter().filter(|values| is_slower_than_rows(values)).collect();
    let mut keep = Vec::new();
    let mut last = f64::NEG_INFINITY;
    // by slower sensor: none of its values was kept since then
    let mut due = vec![true; slower.len()];
    for i in 0..r.len() {
        let changed = i > 0 && (r.segment[i] != r.segment[i - 1] || is_switched(r, i));
        let regular = changed || r.time_s[i] - last > spacing_s - 1e-6 || (sparse && r.volume_ml[i].is_finite());
        if regular {
            last = r.time_s[i];
            due.fill(true);
        }
        let mut awaited = false;
        for (due, values) in due.iter_mut().zip(&slower) {
            if *due && values[i].is_finite() {
                *due = false;
                awaited = true;
            }
        }
        if regular || awaited {
            keep.push(i);
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

/// Most of the values stand alone: the row before has none.
fn is_slower_than_rows(values: &[f64]) -> bool {
    let present = values.iter().filter(|v| v.is_finite()).count();
    let alone = values.windows(2).filter(|w| w[1].is_finite() && !w[0].is_finite()).count();
    2 * alone > present
}

/// Values stand in rows `[first, end)` for at least half of the time: each until the next one, which comes in the next row or within a gap that is
/// bridged. A sensor may be slower than the file's rows.
pub(crate) fn is_read(r: &Recording, values: &[f64], first: usize, end: usize) -> bool {
    let rows: Vec<usize> = (first..end).filter(|&i| values[i].is_finite()).collect();
    let until_next_s = rows.windows(2).filter_map(|w| {
        let s = r.time_s[w[1]] - r.time_s[w[0]];
        (w[1] - w[0] == 1 || s <= BRIDGED_S).then_some(s)
    });
    // rounding of the times makes no half less than one
    !rows.is_empty() && 2.0 * until_next_s.sum::<f64>() + 1e-6 >= r.time_s[end - 1] - r.time_s[first]
}

/// Rows `[first, end)` are enough for something to be read from them.
pub(super) fn is_long_enough(r: &Recording, first: usize, end: usize) -> bool {
    end - first >= FEWEST_ROWS && r.time_s[end - 1] - r.time_s[first] > LEAST_S - 1e-6
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
/// read and whose mean angles agree. `file`: where those are said that are passed over.
pub(super) fn dwells(file: &str, r: &Recording, segments: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut out: Vec<(usize, usize)> = Vec::new();
    let mut last_angle = f64::NAN;
    for &(first, end) in segments {
        let (_, readings) = mean(r.torque_nm[first..end].iter().copied());
        let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
        if is_read(r, &r.torque_nm, first, end) {
            match out.last_mut() {
                Some(dwell) if dwell.1 == first && (angle - last_angle).abs() < 0.3 => dwell.1 = end,
                _ => out.push((first, end)),
            }
            last_angle = angle;
        } else if readings >= FEWEST_ROWS {
            // fewer are the edges of a move
            tracing::warn!(
                file,
                from_s = r.time_s[first],
                "the torque is missing for more than half of this segment, or comes more than half a second apart: the segment is passed over"
            );
        }
    }
    out.retain(|&(first, end)| {
        let enough = is_long_enough(r, first, end);
        if !enough {
            tracing::warn!(
                file,
                from_s = r.time_s[first],
                "a dwell of too short a time, or of too few rows: it is passed over"
            );
        }
        enough
    });
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
