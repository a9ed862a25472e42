//! Measured series as inputs: gaps filled, noise smoothed.

use recordings::Recording;

use super::rows::segments;
use crate::noise::{mean, median, step, white_std};

/// Longest time before and behind a sample over which the angle of a led lever is averaged, s.
const LED_S: f64 = 0.05;

/// A sample is no noise if it is this many noises off.
const FAR: f64 = 8.0;
/// A slope changes if it does so by this many standard errors.
const KINK: f64 = 3.0;
/// A pressure is another one from this many noises on, and a release may end so slowly that its last part, s, lies within them.
const OTHER: f64 = 5.0;
const END_S: f64 = 0.15;

/// The same with an angle that the encoder's noise and steps hardly enter: the led lever is slow, and its angle is an input.
/// A segment whose angle is missing for longer than [`BRIDGED_S`] stays as it is.
pub(super) fn led_angle(r: &Recording) -> Recording {
    let noise = white_std(&r.angle_deg).unwrap_or(0.0).max(step(&r.angle_deg) / 12f64.sqrt());
    let mut out = r.clone();
    for (first, end) in segments(r) {
        if is_torn((first..end).map(|i| (r.time_s[i], r.angle_deg[i]))) {
            continue;
        }
        let values = filled(&r.angle_deg[first..end]);
        let smooth = smoothed_along_kinks(&values, &r.time_s[first..end], LED_S, noise);
        out.angle_deg[first..end].copy_from_slice(&smooth);
    }
    out
}

/// As [`smoothed`], where the series is straight. A mean over a kink cuts the corner: the lever that turns back would seem to
/// turn a little too early in every sweep, always to the same side, and what the chambers take up at the ends of their
/// range would be misread. Where the slope changes within the window by more than `noise` explains, the straight lines on
/// both sides are continued: below a peak the lower one holds, above a trough the upper one.
fn smoothed_along_kinks(values: &[f64], time_s: &[f64], half_s: f64, noise: f64) -> Vec<f64> {
    let means = smoothed(values, time_s, half_s);
    let reaches = reaches(time_s, half_s);
    let last = values.len().saturating_sub(1);
    // > 0: a trough, < 0: a peak, 0: straight within the noise
    let kink = |i: usize, reach: usize| {
        let mean_distance = (reach * (reach + 1)) as f64 / (2 * reach + 1) as f64;
        let (mut along, mut square) = (0.0, 0.0);
        for (j, v) in (i - reach..=i + reach).zip(&values[i - reach..=i + reach]) {
            let w = i.abs_diff(j) as f64 - mean_distance;
            // the middle's value taken off: sums of large numbers that cancel
            along += w * (v - values[i]);
            square += w * w;
        }
        if along.abs() > KINK * noise * f64::sqrt(square) { along } else { 0.0 }
    };
    (0..values.len())
        .map(|i| {
            let reach = reaches[i];
            let kink = if reach < 2 { 0.0 } else { kink(i, reach) };
            if kink == 0.0 {
                return means[i];
            }
            let before = line_at(values, time_s, i.saturating_sub(2 * reach), i, i);
            let after = line_at(values, time_s, i, (i + 2 * reach).min(last), i);
            if kink < 0.0 { before.min(after) } else { before.max(after) }
        })
        .collect()
}

/// The straight line through rows `first..=last` at row `at`.
fn line_at(values: &[f64], time_s: &[f64], first: usize, last: usize, at: usize) -> f64 {
    let n = (last - first + 1) as f64;
    let (mut t1, mut y1) = (0.0, 0.0);
    for i in first..=last {
        t1 += (time_s[i] - time_s[at]) / n;
        y1 += values[i] / n;
    }
    let (mut tt, mut ty) = (0.0, 0.0);
    for i in first..=last {
        let (t, y) = (time_s[i] - time_s[at] - t1, values[i] - y1);
        tt += t * t;
        ty += t * y;
    }
    if tt > 0.0 { y1 - ty / tt * t1 } else { y1 }
}

/// Mean of what a clamped lever's encoder shows; what is further from the median than `noise` explains is passed over: a
/// few samples that no filter found would turn the whole dwell.
pub(super) fn level(values: &[f64], noise: f64) -> f64 {
    let mut present: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let middle = median(&mut present);
    mean(present.into_iter().filter(|v| (v - middle).abs() <= FAR * noise)).0
}

/// By row of the clamp-steps protocol: it lies behind a release. The segment's cylinder was read by then; where it was read only once, which
/// may be long after the release, the rest began when pressure 1 came to what it is at that reading.
pub(super) fn resting(r: &Recording) -> Vec<bool> {
    // at least what rounding makes
    let noise = white_std(&r.pressure1_bar).unwrap_or(0.0).max(step(&r.pressure1_bar)).max(1e-6);
    let mut out = vec![false; r.len()];
    for (first, end) in segments(r) {
        let mut read = (first..end).filter(|&i| r.volume_ml[i].is_finite());
        let Some(earliest) = read.next() else { continue };
        let from = if read.next().is_none() { settled(r, first, earliest, noise) } else { earliest };
        out[from..end].fill(true);
    }
    out
}

/// The row of `first..=last` from which on pressure 1 stays at what it is in the last one, as far as `noise` tells; missing values are passed over.
fn settled(r: &Recording, first: usize, last: usize, noise: f64) -> usize {
    let (mut sum, mut count) = (0.0, 0.0);
    for i in (first..=last).rev().filter(|&i| r.pressure1_bar[i].is_finite()) {
        let pressure_bar = r.pressure1_bar[i];
        if count > 0.0 && (pressure_bar - sum / count).abs() > OTHER * noise {
            return (i..last).find(|&j| r.time_s[j] - r.time_s[i] > END_S).unwrap_or(last);
        }
        sum += pressure_bar;
        count += 1.0;
    }
    first
}

/// A pressure of the clamp-steps protocol as an input: smoothed at rest (`resting`, by row of the recording), straight during a release: the oil
/// that leaves depends on where the pressure ends, not on the way.
pub(super) fn drained_pressure(
    r: &Recording,
    values: &[f64],
    resting: &[bool],
    (first, end): (usize, usize),
) -> Vec<f64> {
    let time = &r.time_s[first..end];
    let mut out = filled(&values[first..end]);
    let resting = &resting[first..end];
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

/// Longest gap in an input that a straight line bridges, s. Longer ones are of a sensor that saturates or is silent, and nobody knows what drove the plant meanwhile.
pub(super) const BRIDGED_S: f64 = 0.5;

/// An input is missing for longer than [`BRIDGED_S`] at a time, of rows (time, value) in their order.
pub(super) fn is_torn(rows: impl Iterator<Item = (f64, f64)>) -> bool {
    let mut since = None;
    rows.into_iter().any(|(time_s, value)| {
        if value.is_finite() {
            since = None;
            return false;
        }
        time_s - *since.get_or_insert(time_s) > BRIDGED_S
    })
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
    let mean = |(i, reach): (usize, usize)| (sums[i + reach + 1] - sums[i - reach]) / (2 * reach + 1) as f64;
    reaches(time_s, half_s).into_iter().enumerate().map(mean).collect()
}

/// By row: how many rows a window of +- `half_s` reaches to either side; symmetric, so that a slope stays where it is.
fn reaches(time_s: &[f64], half_s: f64) -> Vec<usize> {
    let (mut a, mut b) = (0, 0);
    (0..time_s.len())
        .map(|i| {
            while time_s[a] < time_s[i] - half_s {
                a += 1;
            }
            while b < time_s.len() && time_s[b] <= time_s[i] + half_s {
                b += 1;
            }
            (i - a).min(b - 1 - i)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn a_lever_that_turns_back_turns_where_it_does() {
        let encoder = 360.0 / 16384.0;
        for (rate_hz, most) in [(1000.0, 0.0015), (200.0, 0.003)] {
            let rows = (4.0 * rate_hz) as usize;
            let time: Vec<f64> = (0..rows).map(|i| i as f64 / rate_hz).collect();
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let (mut corner, mut cut, mut straight, mut count) = (0.0, 0.0, 0.0, 0);
            for repeat in 0..60 {
                let turn = 2.0 + 0.0037 * f64::from(repeat);
                let angle = |t: f64| 3.0 - 0.75 * (t - turn).abs();
                let shown: Vec<f64> = time
                    .iter()
                    .map(|t| {
                        let noise: f64 = StandardNormal.sample(&mut rng);
                        ((angle(*t) + 0.01 * noise) / encoder).round() * encoder
                    })
                    .collect();
                let found = smoothed_along_kinks(&shown, &time, LED_S, 0.012);
                let plain = smoothed(&shown, &time, LED_S);
                for (i, t) in time.iter().enumerate() {
                    if (t - turn).abs() < LED_S {
                        corner += found[i] - angle(*t);
                        cut += plain[i] - angle(*t);
                        count += 1;
                    } else if (1.0..1.5).contains(t) {
                        straight += (found[i] - angle(*t)).powi(2) / (60.0 * 0.5 * rate_hz);
                    }
                }
            }
            let (corner, cut) = (corner / f64::from(count), cut / f64::from(count));
            assert!(corner.abs() < most && cut < -0.005, "{rate_hz} Hz: {corner} deg, cut {cut}");
            assert!(straight.sqrt() < 1.2 * 0.012 / (2.0 * LED_S * rate_hz).sqrt(), "{}", straight.sqrt());
        }
    }
}
