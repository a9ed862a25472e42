//! Measured series as inputs: gaps filled, noise smoothed.

use recordings::Recording;

use super::rows::segments;

/// Longest time before and behind a sample over which the angle of a led lever is averaged, s.
const LED_S: f64 = 0.05;

/// The same with an angle that the encoder's noise and steps hardly enter: the led lever is slow, and its angle is an input.
pub(super) fn led_angle(r: &Recording) -> Recording {
    let mut out = r.clone();
    for (first, end) in segments(r) {
        let smooth = smoothed(&filled(&r.angle_deg[first..end]), &r.time_s[first..end], LED_S);
        out.angle_deg[first..end].copy_from_slice(&smooth);
    }
    out
}

/// Row `i` of the clamp-steps protocol lies behind a release: the segment's cylinder was read by then.
pub(super) fn rests(r: &Recording, i: usize) -> bool {
    let same = (0..=i).rev().take_while(|&j| r.segment[j] == r.segment[i]);
    same.into_iter().any(|j| r.volume_ml[j].is_finite())
}

/// A pressure of the clamp-steps protocol as an input: smoothed at rest, straight during a release (where the volume is
/// empty): the oil that leaves depends on where the pressure ends, not on the way.
pub(super) fn drained_pressure(r: &Recording, values: &[f64], first: usize, end: usize) -> Vec<f64> {
    let time = &r.time_s[first..end];
    let mut out = filled(&values[first..end]);
    let resting: Vec<bool> = (first..end).map(|i| rests(r, i)).collect();
    let n = out.len();
    let mut i = 0;
    while i < n {
        let j = (i..n).find(|&j| resting[j] != resting[i]).unwrap_or(n);
        if resting[i] {
            let smooth = smoothed(&out[i..j], &time[i..j], 0.25);
            out[i..j].copy_from_slice(&smooth);
        }
        i = j;
    }
    let mut i = 0;
    while i < n {
        let j = (i..n).find(|&j| resting[j] != resting[i]).unwrap_or(n);
        if !resting[i] && i > 0 && j < n {
            let (a, b) = (out[i - 1], out[j]);
            for l in i..j {
                out[l] = a + (b - a) * (l + 1 - i) as f64 / (j + 1 - i) as f64;
            }
        }
        i = j;
    }
    out
}

/// Missing values replaced by the neighbours' straight line.
pub(super) fn filled(values: &[f64]) -> Vec<f64> {
    let mut out = values.to_vec();
    let known: Vec<usize> = (0..values.len()).filter(|&i| values[i].is_finite()).collect();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return out };
    out[..first].fill(values[first]);
    out[last..].fill(values[last]);
    for w in known.windows(2) {
        for i in w[0] + 1..w[1] {
            let f = (i - w[0]) as f64 / (w[1] - w[0]) as f64;
            out[i] = values[w[0]] + f * (values[w[1]] - values[w[0]]);
        }
    }
    out
}

/// Mean over a window of +- `half_s`.
pub(super) fn smoothed(values: &[f64], time_s: &[f64], half_s: f64) -> Vec<f64> {
    let mut sums = vec![0.0];
    for v in values {
        sums.push(sums[sums.len() - 1] + v);
    }
    let (mut a, mut b) = (0, 0);
    (0..values.len())
        .map(|i| {
            // symmetric, so that a slope stays where it is
            while time_s[a] < time_s[i] - half_s {
                a += 1;
            }
            while b < values.len() && time_s[b] <= time_s[i] + half_s {
                b += 1;
            }
            let reach = (i - a).min(b - 1 - i);
            (sums[i + reach + 1] - sums[i - reach]) / (2 * reach + 1) as f64
        })
        .collect()
}
