//! How much a channel moves, beside what its noise makes it move.

use crate::noise::{mean, step, white_std_of_adjacent};

/// Blocks that a run is cut into at most, and rows of a block at least.
const BLOCKS: usize = 300;
const LEAST_ROWS: usize = 8;
/// The range of some hundred block means of noise alone is 5..6 of their standard deviations.
const FLAT: f64 = 9.0;
/// A channel moves clearly whose range is this many.
const MOVES: f64 = 50.0;

/// A channel's block means over some rows.
pub(super) struct Motion {
    /// Largest less smallest block mean, in the channel's unit.
    pub range: f64,
    /// Standard deviation that noise and steps give a block mean.
    pub noise: f64,
    /// Blocks with values.
    pub blocks: usize,
}

impl Motion {
    /// Of the rows that `keep` selects; rows without a value are passed over.
    pub fn of(values: &[f64], keep: impl Fn(usize) -> bool) -> Motion {
        let rows: Vec<f64> = (0..values.len()).filter(|&i| keep(i)).map(|i| values[i]).collect();
        let size = (rows.len() / BLOCKS).max(LEAST_ROWS);
        let means: Vec<f64> =
            rows.chunks(size).map(|c| mean(c.iter().copied())).filter(|m| m.1 > 0).map(|m| m.0).collect();
        let (low, high) = means.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        // values that come too seldom to follow one another have no noise to be judged by: between them the signal moves
        let white = white_std_of_adjacent(values).unwrap_or(0.0);
        let coarse = step(values);
        // steps that the noise does not dither are no noise: their mean may be half a step off
        let noise = (white / (size as f64).sqrt()).max(if white < coarse { 0.5 * coarse } else { 0.0 });
        Motion { range: if means.is_empty() { 0.0 } else { high - low }, noise, blocks: means.len() }
    }

    /// It shows nothing but noise.
    pub fn is_flat(&self) -> bool {
        self.blocks >= 4 && self.range <= FLAT * self.noise
    }

    /// It moves clearly.
    pub fn is_clear(&self) -> bool {
        self.blocks >= 4 && self.range > 0.0 && self.range >= MOVES * self.noise
    }
}

/// Rows `[first, end)` of the longest stretch of one value; missing values are passed over.
pub(super) fn longest_constant(values: &[f64]) -> (usize, usize) {
    let mut best = (0, 0);
    let mut first: Option<usize> = None;
    let mut end = 0;
    for (i, v) in values.iter().enumerate().filter(|(_, v)| v.is_finite()) {
        if first.is_none_or(|f| values[f] != *v) {
            first = Some(i);
        }
        end = end.max(i + 1);
        if let Some(f) = first
            && i + 1 - f > best.1 - best.0
        {
            best = (f, i + 1);
        }
    }
    best
}

/// The `share` quantile of the finite values; `NaN` where there is none.
pub(super) fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut finite: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    if finite.is_empty() {
        return f64::NAN;
    }
    let at = ((finite.len() - 1) as f64 * share).round() as usize;
    let (_, v, _) = finite.select_nth_unstable_by(at, f64::total_cmp);
    *v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_flat_and_a_slow_motion_is_not() {
        let noise = |i: usize| ((i as f64 * 12.9898).sin() * 43758.5453).fract() - 0.5;
        let quiet: Vec<f64> = (0..5000).map(|i| 2.0 + 0.01 * noise(i)).collect();
        assert!(Motion::of(&quiet, |_| true).is_flat());
        let moving: Vec<f64> = (0..5000).map(|i| 2.0 + 0.01 * noise(i) + 0.3 * (i as f64 * 2e-3).sin()).collect();
        assert!(Motion::of(&moving, |_| true).is_clear());
        assert!(Motion::of(&[1.0; 500], |_| true).is_flat(), "a constant");
        assert!(!Motion::of(&[f64::NAN; 500], |_| true).is_flat(), "no value at all is no constant");
        // a coarse sensor at rest
        let coarse: Vec<f64> = quiet.iter().map(|v| (v / 0.1).round() * 0.1).collect();
        assert!(!Motion::of(&coarse, |_| true).is_clear());
    }

    #[test]
    fn the_longest_constant_stretch_passes_over_missing_values() {
        assert_eq!(longest_constant(&[1.0, 2.0, 2.0, f64::NAN, 2.0, 3.0, 3.0]), (1, 5));
        assert_eq!(longest_constant(&[]), (0, 0));
        assert_eq!(quantile([3.0, 1.0, f64::NAN, 2.0].into_iter(), 0.5), 2.0);
    }
}
