//! Sensors that saturate: plateaus at an extreme value that the signal does not come to rest at.

use recordings::{Protocol, Recording, RunEntry};

use super::sensors::{Fault, Sensor, SetAside, TOO_MUCH, free, missing, values_mut};
use crate::noise::{step, white_std_of_adjacent};

/// Smallest and largest value of a channel.
#[derive(Clone, Copy)]
pub(super) struct Reach {
    low: f64,
    high: f64,
}

impl Reach {
    /// Of no value.
    pub const NONE: Reach = Reach { low: f64::INFINITY, high: f64::NEG_INFINITY };

    /// Missing values are passed over.
    pub fn of(values: &[f64]) -> Reach {
        let known = values.iter().copied().filter(|v| v.is_finite());
        known.fold(Reach::NONE, |reach, v| reach.with(Reach { low: v, high: v }))
    }

    /// Of both.
    pub fn with(self, other: Reach) -> Reach {
        Reach { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// It goes on clearly where the other one ends, at the largest (`side` = 1) or smallest (-1) value; `step`: of the sensor.
    fn goes_beyond(self, other: Reach, side: f64, step: f64) -> bool {
        let beyond = if side > 0.0 { self.high - other.high } else { other.low - self.low };
        beyond > (2.0 * REACH * step).max(FURTHER * (other.high - other.low))
    }
}

/// Share of a run's range by which other runs go beyond it where its lever did not end at a stop.
const FURTHER: f64 = 0.1;

/// Plateaus at the extreme value that the signal runs into at full speed. `lever_deg`: where the lever was in other runs.
pub(super) fn saturated(entry: &RunEntry, r: &mut Recording, lever_deg: Reach) -> Vec<SetAside> {
    let channels: &[Sensor] = match entry.protocol {
        Protocol::PumpMap => &[],
        Protocol::ClampSteps => &[Sensor::Pressure1, Sensor::Torque],
        // a lever that is led stops where it is held
        Protocol::TorqueMap | Protocol::VolumeMap => &[Sensor::Pressure1, Sensor::Pressure2, Sensor::Torque],
        _ => &[Sensor::Angle, Sensor::Pressure1, Sensor::Pressure2],
    };
    let mut out = Vec::new();
    for &channel in channels {
        let values = channel.of(r);
        let (white, coarse) = (white_std_of_adjacent(&within(values)).unwrap_or(0.0), step(values));
        // a coarse encoder stands still at a stop of the lever, too, unless its noise shows that it sees (steps alone look like 0.3), or other runs went on there
        let blind = channel == Sensor::Angle && white < 0.5 * coarse;
        let own = Reach::of(values);
        let noise = white.max(coarse);
        let long = if coarse == 0.0 {
            PLATEAU
        } else if white >= 0.5 * coarse {
            DITHERED
        } else {
            usize::MAX
        };
        for (side, word) in [(1.0, "above"), (-1.0, "below")] {
            if blind && !lever_deg.goes_beyond(own, side, coarse) {
                continue;
            }
            let rows = clipped(channel.of(r), side, noise, long);
            if rows.is_empty() {
                continue;
            }
            let value = channel.of(r)[rows[0]];
            let count = rows.len();
            let target = values_mut(r, channel);
            rows.into_iter().for_each(|i| target[i] = f64::NAN);
            let share = missing(channel.of(r));
            out.push(SetAside {
                file: entry.file.clone(),
                fault: Fault::Saturated,
                channels: vec![channel],
                why: format!(
                    "expected values {word} {value:.4} where it stops dead at that value, got {count} samples of exactly {value:.4}, its extreme"
                ),
                whole_run: free(entry.protocol) && share > TOO_MUCH,
            });
        }
    }
    out
}

/// The values with those at either extreme missing: noise shows beside them alone, where a sensor is saturated most of the time.
fn within(values: &[f64]) -> Vec<f64> {
    let Reach { low, high } = Reach::of(values);
    values.iter().map(|&v| if v > low && v < high { v } else { f64::NAN }).collect()
}

/// A plateau has this many rows at least.
const PLATEAU: usize = 5;
/// So many equal values of a sensor whose noise dithers its steps are no chance: at its largest value it is in the tail of the noise.
const DITHERED: usize = 30;
/// The way into a plateau is judged over twice this many noises.
const REACH: f64 = 10.0;
/// The second half of that way may take this many times as long as the first: 1 for a signal that is cut off, 1.9 for one that turns
/// smoothly within one step of the sensor, more for one that comes to rest.
const SLOWER: f64 = 1.5;
/// By so many noises the signal would have gone on in half of the plateau; a sharp turn stands for a step or two.
const BEYOND: f64 = 8.0;

/// Rows of the plateaus at the largest (`side` = 1) or smallest (-1) value, where there are at least two, and they are `long`, or the
/// signal runs into them with a slope that does not end there.
fn clipped(values: &[f64], side: f64, noise: f64, long: usize) -> Vec<usize> {
    let extreme = values.iter().filter(|v| v.is_finite()).fold(f64::NEG_INFINITY, |m, v| m.max(side * v));
    let at = |i: usize| values[i].is_finite() && side * values[i] == extreme;
    let mut plateaus: Vec<(usize, usize)> = Vec::new();
    let mut i = 0;
    while i < values.len() {
        let end = (i..values.len()).find(|&j| !at(j)).unwrap_or(values.len());
        if end - i >= PLATEAU {
            plateaus.push((i, end));
        }
        i = end.max(i + 1);
    }
    let runs_on = |&(first, end): &(usize, usize)| {
        if end - first >= long {
            return true;
        }
        let below = |levels: f64, from: usize| {
            (0..from).rev().find(|&i| values[i].is_finite() && extreme - side * values[i] > levels * REACH * noise)
        };
        let Some(near) = below(1.0, first) else { return false };
        let Some(far) = below(2.0, near) else { return false };
        let (before, behind) = ((near - far) as f64, (first - near) as f64);
        let beyond = REACH / before * (end - first) as f64 / 2.0;
        behind + before >= 3.0 && behind <= SLOWER * before && beyond >= BEYOND
    };
    let hits = plateaus.iter().filter(|p| runs_on(p)).count();
    if hits < 2 || hits * 2 < plateaus.len() {
        return Vec::new();
    }
    // every sample at that value, also those that the noise let dip below it in between
    (0..values.len()).filter(|&i| at(i)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    fn wave(rows: usize, noise: f64, coarse: f64) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        (0..rows)
            .map(|i| {
                let y = 3.0 + 1.5 * (i as f64 * 0.01).sin() + noise * (rng.random::<f64>() - 0.5) * 3.4;
                if coarse > 0.0 { (y / coarse).round() * coarse } else { y }
            })
            .collect()
    }

    #[test]
    fn a_clipped_wave_is_found_and_a_smooth_one_is_not_whatever_its_steps() {
        for (noise, coarse) in [(0.006, 0.0), (0.006, 0.02), (0.0, 0.02), (0.0, 0.1), (0.02, 0.005)] {
            let values = wave(20_000, noise, coarse);
            assert!(clipped(&values, 1.0, noise.max(coarse), usize::MAX).is_empty(), "{noise} {coarse}");
            let cut: Vec<f64> = values.iter().map(|v| v.min(4.0)).collect();
            assert!(clipped(&cut, 1.0, noise.max(coarse), usize::MAX).len() > 3000, "{noise} {coarse}");
            assert!(clipped(&cut, -1.0, noise.max(coarse), usize::MAX).is_empty(), "{noise} {coarse}");
        }
    }

    #[test]
    fn where_other_runs_end_a_little_further_on_is_a_stop_that_gives_way() {
        let (own, step) = (Reach::of(&[-20.0, f64::NAN, 20.0]), 0.05);
        assert!(!Reach::of(&[-22.0, 22.0]).goes_beyond(own, 1.0, step));
        assert!(Reach::of(&[-22.0, 28.0]).goes_beyond(own, 1.0, step));
        assert!(!Reach::of(&[-22.0, 28.0]).goes_beyond(own, -1.0, step));
        assert!(Reach::of(&[-28.0]).goes_beyond(own, -1.0, step));
        assert!(!Reach::NONE.goes_beyond(own, 1.0, step), "the only run");
    }

    #[test]
    fn noise_free_rests_at_the_extreme_are_not_clipped() {
        // a pump that holds its pressure: it comes near slowly
        let values: Vec<f64> = (0..20_000)
            .map(|i| {
                let t = (i % 4000) as f64 * 1e-3;
                ((3.0 + (1.0 - (-t * 3.0).exp())) / 0.02).round() * 0.02
            })
            .collect();
        assert!(clipped(&values, 1.0, 0.02, usize::MAX).is_empty());
    }
}
