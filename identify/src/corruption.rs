//! Samples that no sensor can mean: spikes, dropouts, a value that stands still. They are found from the signal alone, before any
//! model is asked, so that what a model can't explain is never taken for corruption, and become missing values.
//!
//! | kind | found by |
//! |---|---|
//! | spike, short burst | far from the median of the samples around it, in units of the noise and of the scatter there (Hampel's filter). An edge of the signal, however steep, is its own median, and an oscillation scatters |
//! | value that stands still | equal to the last bit for longer than chance explains; on a sensor with coarse steps: while it moves before and behind, or beside a jump that the motion beyond it does not explain, for longer than chance explains there. Dropouts to a constant are found likewise, by their jumps at both ends |
//! | reading of the cylinder | far from the straight line of its segment (pump map), from the segment's median (clamp steps) |

use recordings::{Protocol, Recording};
use std::collections::{BTreeMap, BTreeSet};

use crate::noise::{median, step, white_std};
use crate::prepare::{Channel, segments};

/// Half of a spike's window, s, and in samples.
const WINDOW_S: f64 = 5e-3;
const WINDOW: std::ops::RangeInclusive<usize> = 3..=5;
/// A spike is this many noises and this many local scatters off.
const NOISES: f64 = 8.0;
const SCATTERS: f64 = 5.0;
/// A moving sensor with coarse steps that shows one value has moved on by a step and this many noises at most: both ends of such a
/// succession would have to be three noises off, each to its side, and all between them where they must be.
const STILL_NOISES: f64 = 6.0;
/// Expected number of chance repetitions in a run below which equal values are a sensor that stands still.
const BY_CHANCE: f64 = 1e-3;
/// Standard deviation of a normal distribution over its median deviation.
const OF_MEDIAN: f64 = 1.4826;

/// What was taken out of one run, by [`Channel`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Corruption {
    /// Spikes, short bursts, readings far off.
    pub spikes: [usize; 5],
    /// Samples of a value that stood still.
    pub still: [usize; 5],
}

impl Corruption {
    /// Samples of this channel.
    pub fn of(&self, channel: Channel) -> usize {
        self.spikes[channel.index()] + self.still[channel.index()]
    }
}

/// Makes corrupted samples missing ones (`NaN`).
pub fn clean(r: &mut Recording, protocol: Protocol) -> Corruption {
    let mut found = Corruption::default();
    let spacing_s = match r.len() {
        0 | 1 => return found,
        n => (r.time_s[n - 1] - r.time_s[0]) / (n - 1) as f64,
    };
    let half = ((WINDOW_S / spacing_s).round() as usize).clamp(*WINDOW.start(), *WINDOW.end());
    let segment = &r.segment;
    // a lever in a clamp stands still as it should, on one step of its encoder if it happens to
    let clamped =
        matches!(protocol, Protocol::TorqueMap | Protocol::VolumeMap | Protocol::PumpMap | Protocol::ClampSteps);
    for (channel, values) in [
        (Channel::Angle, &mut r.angle_deg),
        (Channel::Pressure1, &mut r.pressure1_bar),
        (Channel::Pressure2, &mut r.pressure2_bar),
        (Channel::Torque, &mut r.torque_nm),
    ] {
        let mut still = standing_still(values, segment);
        if channel == Channel::Angle && clamped {
            let rest = at_rest(values, &still, segment);
            still.retain(|&i| !rest.contains(&segment[i]));
        }
        found.still[channel.index()] = take_out(values, still);
        let spikes = spikes(values, half);
        found.spikes[channel.index()] = take_out(values, spikes);
    }
    let readings = match protocol {
        Protocol::PumpMap => off_the_line(r),
        Protocol::ClampSteps => off_the_median(r),
        _ => Vec::new(),
    };
    found.spikes[Channel::Volume.index()] = take_out(&mut r.volume_ml, readings);
    found
}

/// Segments of rows that stand still in which nothing moves: all that they show lies within two steps of the sensor. A lever in a clamp whose angle
/// lies near the edge of an encoder's step shows the next one now and then.
fn at_rest(values: &[f64], still: &[usize], segment: &[i64]) -> BTreeSet<i64> {
    let within = 2.0 * step(values);
    let mut ranges = BTreeMap::<i64, (f64, f64)>::new();
    for (v, s) in values.iter().zip(segment).filter(|(v, _)| v.is_finite()) {
        let (least, most) = ranges.entry(*s).or_insert((*v, *v));
        (*least, *most) = (least.min(*v), most.max(*v));
    }
    let held: BTreeSet<i64> = still.iter().map(|&i| segment[i]).collect();
    ranges.into_iter().filter(|(s, (least, most))| held.contains(s) && most - least <= within).map(|(s, _)| s).collect()
}

fn take_out(values: &mut [f64], rows: Vec<usize>) -> usize {
    rows.iter().for_each(|&i| values[i] = f64::NAN);
    rows.len()
}

/// Rows of the values that are there.
fn present(values: &[f64]) -> Vec<usize> {
    (0..values.len()).filter(|&i| values[i].is_finite()).collect()
}

fn spikes(values: &[f64], half: usize) -> Vec<usize> {
    let rows = present(values);
    let Some(noise) = white_std(values).map(|s| s.max(coarse(values, s))) else { return Vec::new() };
    let mut out = Vec::new();
    let mut window = Vec::with_capacity(2 * half + 1);
    // the first and the last sample have neighbours on one side only: what steps there can't be told from a spike
    for n in 1..rows.len().saturating_sub(1) {
        // at an end the window leans inwards
        let first = n.saturating_sub(half).min(rows.len().saturating_sub(2 * half + 1));
        let end = (first + 2 * half + 1).min(rows.len());
        let x = values[rows[n]];
        // cheap first: hardly a sample is far from its neighbour
        let beside = values[rows[if n > first { n - 1 } else { n + 1 }.min(rows.len() - 1)]];
        let beyond = values[rows[if n + 1 < end { n + 1 } else { n.saturating_sub(1) }]];
        if (x - beside).abs() <= NOISES * noise
            && (x - beyond).abs() <= NOISES * noise
            && !out.last().is_some_and(|l| n > 0 && *l == rows[n - 1])
        {
            continue;
        }
        window.clear();
        window.extend(rows[first..end].iter().map(|&i| values[i]));
        let middle = median(&mut window);
        window.iter_mut().for_each(|v| *v = (*v - middle).abs());
        let scatter = OF_MEDIAN * median(&mut window);
        if (x - middle).abs() > NOISES * noise + SCATTERS * scatter {
            out.push(rows[n]);
        }
    }
    out
}

/// The step of a sensor whose noise does not dither it, else 0.
fn coarse(values: &[f64], noise: f64) -> f64 {
    let step = step(values);
    if noise < 2.0 * step { step } else { 0.0 }
}

fn standing_still(values: &[f64], segment: &[i64]) -> Vec<usize> {
    let rows = present(values);
    if rows.len() < 20 {
        return Vec::new();
    }
    let noise = white_std(values).unwrap_or(0.0);
    let coarse = coarse(values, noise);
    let equal = rows.windows(2).filter(|w| values[w[0]] == values[w[1]]).count();
    let chance = equal as f64 / rows.len() as f64;
    // a channel that never changes has no noise to judge by
    if chance > 0.9 {
        return Vec::new();
    }
    // how many equal values are no chance where `places` could begin with them
    let beyond_chance = |places: usize| {
        let places = places.max(1) as f64;
        1.0 + ((BY_CHANCE / places).ln() / chance.max(1e-9).ln()).max(3.0)
    };
    let longest = beyond_chance(rows.len());
    let mut out = Vec::new();
    // runs of equal values on a coarse sensor with a jump at their end, or at both ends
    let mut leapt: Vec<(usize, usize, bool)> = Vec::new();
    let mut leaps = 0;
    let mut first = 0;
    for n in 1..=rows.len() {
        if n < rows.len() && values[rows[n]] == values[rows[first]] {
            continue;
        }
        let length = n - first;
        if coarse == 0.0 {
            if length as f64 > longest {
                out.extend_from_slice(&rows[first..n]);
            }
        } else {
            // a jump that the motion beyond it does not explain; between segments things happen that nobody recorded
            let leap = |from: usize, to: usize, beyond: &mut dyn Iterator<Item = usize>| {
                let jump = (values[rows[to]] - values[rows[from]]).abs();
                let mut moves: Vec<f64> = beyond.map(|i| (values[rows[i + 1]] - values[rows[i]]).abs()).collect();
                segment[rows[to]] == segment[rows[from]]
                    && jump > NOISES * noise.max(coarse) + SCATTERS * median(&mut moves)
            };
            let behind = n + 6 < rows.len() && leap(n - 1, n, &mut (n..n + 5));
            let before = first > 6 && leap(first - 1, first, &mut (first - 6..first - 1));
            let off = behind || leaves(values, &rows, n) > 2.0 * coarse + STILL_NOISES * noise / 5f64.sqrt();
            leaps += usize::from(off) + usize::from(before);
            if length >= 3 && moved_on(values, &rows, first, n) > coarse + STILL_NOISES * noise {
                out.extend_from_slice(&rows[first..n]);
            } else if length >= 3 && (off || before) {
                leapt.push((first, n, behind && before));
            }
        }
        first = n;
    }
    // a lever that is set elsewhere leaps too, and may have shown the same step a few times before
    let longest = beyond_chance(leaps);
    for (first, n, _) in leapt.into_iter().filter(|(first, n, both)| *both || (n - first) as f64 > longest) {
        out.extend_from_slice(&rows[first..n]);
    }
    out
}

/// How far the mean of the five present rows from `end` on lies from the value before, less what their own motion makes of that.
fn leaves(values: &[f64], rows: &[usize], end: usize) -> f64 {
    let Some(behind) = rows.get(end..end + 5) else { return 0.0 };
    let held = values[rows[end - 1]];
    let mean = behind.iter().map(|&i| values[i]).sum::<f64>() / 5.0;
    (mean - held).abs() - 3.0 * (values[behind[4]] - values[behind[0]]).abs() / 4.0
}

/// How far the signal went meanwhile while it seemed to show one value, in present rows `first..end`, if it moved on at the lesser of its
/// velocities before and behind; 0 where these have not one sign.
fn moved_on(values: &[f64], rows: &[usize], first: usize, end: usize) -> f64 {
    let over = (end - first).clamp(5, 40);
    if first <= over || end + over >= rows.len() {
        return 0.0;
    }
    let slope = |a: usize, b: usize| (values[rows[b]] - values[rows[a]]) / (rows[b] - rows[a]) as f64;
    let (before, behind) = (slope(first - 1 - over, first - 1), slope(end, end + over));
    if before * behind <= 0.0 {
        return 0.0;
    }
    before.abs().min(behind.abs()) * (rows[end - 1] - rows[first]) as f64
}

/// Readings of the pump map far from the straight line of their segment.
fn off_the_line(r: &Recording) -> Vec<usize> {
    let mut all: Vec<(usize, f64)> = Vec::new();
    for (first, end) in segments(r) {
        let rows: Vec<usize> = (first..end).filter(|&i| r.volume_ml[i].is_finite()).collect();
        if rows.len() < 6 {
            continue;
        }
        // Siegel's repeated medians: half of the readings may be wrong
        let some: Vec<usize> = rows.iter().copied().step_by(rows.len().div_ceil(40)).collect();
        let mut slopes: Vec<f64> = some
            .iter()
            .map(|&i| {
                let to = some.iter().filter(|&&j| j != i);
                median(
                    &mut to
                        .map(|&j| (r.volume_ml[j] - r.volume_ml[i]) / (r.time_s[j] - r.time_s[i]))
                        .collect::<Vec<_>>(),
                )
            })
            .collect();
        let slope = median(&mut slopes);
        let at = |i: usize| r.volume_ml[i] - slope * r.time_s[i];
        let level = median(&mut some.iter().map(|&i| at(i)).collect::<Vec<_>>());
        all.extend(rows.iter().map(|&i| (i, (at(i) - level).abs())));
    }
    let scatter = OF_MEDIAN * median(&mut all.iter().map(|a| a.1).collect::<Vec<_>>());
    all.into_iter().filter(|(_, off)| *off > NOISES * scatter).map(|(i, _)| i).collect()
}

/// Readings of the clamp steps that differ from those of the same rest.
fn off_the_median(r: &Recording) -> Vec<usize> {
    let mut out = Vec::new();
    for (first, end) in segments(r) {
        let rows: Vec<usize> = (first..end).filter(|&i| r.volume_ml[i].is_finite()).collect();
        let level = median(&mut rows.iter().map(|&i| r.volume_ml[i]).collect::<Vec<_>>());
        let off = |i: usize| (r.volume_ml[i] - level).abs();
        let scatter = OF_MEDIAN * median(&mut rows.iter().map(|&i| off(i)).collect::<Vec<_>>());
        out.extend(rows.iter().copied().filter(|&i| off(i) > NOISES * scatter));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// An oscillation of 12 Hz, edges of 30 ms, rests; noise 0.006, steps of a sensor where asked for.
    fn signal(rows: usize, rate_hz: f64, step: f64, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..rows)
            .map(|i| {
                let t = i as f64 / rate_hz;
                let part = t.rem_euclid(2.0);
                let rise = ((part - 0.5) / 0.03).clamp(0.0, 1.0);
                let fall = ((2.0 - part) / 0.03).clamp(0.0, 1.0);
                let y = 3.0 + rise * fall * (1.0 + (-part * 3.0).exp() * (part * 75.0).sin());
                let noise: f64 = StandardNormal.sample(&mut rng);
                let y: f64 = y + 0.006 * noise;
                if step > 0.0 { (y / step).round() * step } else { y }
            })
            .collect()
    }

    #[test]
    fn a_clean_signal_loses_nothing() {
        for (rate_hz, step) in [(1000.0, 0.0), (1000.0, 0.02), (1000.0, 0.1), (500.0, 0.02), (200.0, 0.0)] {
            for seed in 0..5 {
                let values = signal(30_000, rate_hz, step, seed);
                assert_eq!(standing_still(&values, &vec![0; values.len()]).len(), 0, "{rate_hz} Hz, steps of {step}");
                let half = if rate_hz > 500.0 { 5 } else { 3 };
                assert_eq!(spikes(&values, half).len(), 0, "{rate_hz} Hz, steps of {step}");
            }
        }
    }

    #[test]
    fn a_lever_in_a_clamp_may_stand_still() {
        // three angles; the second one lies in the middle of an encoder's step, so that the noise shows at the others alone; but for one sample, in which
        // it shows the next step
        let step = 0.02;
        let noise = |i: usize| ((i * 7919) % 13) as f64 - 6.0;
        let angle = |i: usize| match i / 1000 {
            1 if i == 1430 => step,
            1 => 0.0,
            n => 10.0 * (n as f64 - 1.0) + step * noise(i),
        };
        for (protocol, still) in [(Protocol::TorqueMap, 0), (Protocol::RandomSteps, 999)] {
            let rows = 3000;
            let mut r = Recording {
                time_s: (0..rows).map(|i| i as f64 * 1e-3).collect(),
                angle_deg: (0..rows).map(angle).collect(),
                pressure1_bar: vec![f64::NAN; rows],
                pressure2_bar: vec![f64::NAN; rows],
                torque_nm: vec![f64::NAN; rows],
                volume_ml: vec![f64::NAN; rows],
                segment: (0..rows).map(|i| (i / 1000) as i64).collect(),
                ..Recording::default()
            };
            assert_eq!(clean(&mut r, protocol).still[Channel::Angle.index()], still, "{protocol:?}");
        }
    }

    #[test]
    fn spikes_dropouts_and_a_value_that_stands_still_are_found() {
        for step in [0.0, 0.02] {
            let clean = signal(30_000, 1000.0, step, 7);
            let mut rng = ChaCha8Rng::seed_from_u64(8);
            let mut values = clean.clone();
            for _ in 0..150 {
                values[rng.random_range(0..30_000)] += if rng.random::<bool>() { 0.5 } else { -2.0 };
            }
            for _ in 0..10 {
                let at = rng.random_range(0..29_900);
                values[at..at + 20].fill(0.0);
                let at = rng.random_range(1..29_900);
                let held = values[at - 1];
                values[at..at + 30].fill(held);
            }
            let corrupted: Vec<usize> =
                (0..30_000).filter(|&i| (values[i] - clean[i]).abs() > 0.1 + 20.0 * step).collect();
            let still = standing_still(&values, &vec![0; values.len()]);
            take_out(&mut values, still);
            let spikes = spikes(&values, 5);
            take_out(&mut values, spikes);
            let missed = corrupted.iter().filter(|&&i| values[i].is_finite()).count();
            // on coarse steps a value that is held out of a rest into an edge may be chance
            let most = if step > 0.0 { 8 } else { 4 };
            assert!(missed <= most, "{missed} of {} with steps of {step}", corrupted.len());
            let lost = values.iter().filter(|v| v.is_nan()).count();
            // at rest a coarse sensor stands still anyway: losing some of that costs nothing
            assert!(lost < corrupted.len() + 1500, "{lost} for {}", corrupted.len());
        }
    }
}
