//! Colour of the sensors' noise, from the residual that every stretch of a free lever has alike, whether it moves or not.
//!
//! Windows of somewhat more than half a second are freed of their parabola, which takes out what is slow, and those of middling
//! size count, which leaves out what a wrong model does after each step of the input. The autocovariance of what is left
//! is the sensors' own: their filters, their converters' steps; where it is far more than they show at rest it is not, and the rest is
//! taken. It is described as noise of a first-order filter beside white noise, corrected for what the parabola took.

use std::sync::LazyLock;

use nalgebra::{DMatrix, DVector};

use crate::noise::median;
use crate::prepare::{Channel, Stand};
use crate::problem::Problem;

/// Targets in a window, 10 ms apart; fewer where the rows themselves are further apart, so that a window lasts no longer, but no fewer than the
/// least, of which too little would be left beside a parabola.
const WINDOW: usize = 64;
const LEAST_WINDOW: usize = 16;
/// Distance of the rows, s, up to which their targets are as many as they may be.
const FULL_S: f64 = 0.0105;
/// Longest lag that is looked at, targets of a full window. Filters of sensors that a rig is controlled by forget within a quarter of a second.
const LAGS: usize = 24;
/// Noise that keeps more of itself than this from each target of a full window to the next is not told from what is slow.
const KEPT: f64 = 0.96;
/// Fewer windows than this say nothing.
const FEWEST: usize = 12;
/// So many targets in windows at rest tell the noise's variance within a factor of three, whatever its colour within reason: one full window does.
const FEWEST_AT_REST: usize = 32;
/// Times the variance at rest from which what moves shows more than noise. Where the model is right the two are within a third of each other; a sensor
/// may well be noisier where it moves, and to take its noise for an effect would be worse than to take a gross effect for noise.
const LOUDER: f64 = 10.0;
/// Noise counts as forgotten where its correlation has fallen to this share.
const FORGOTTEN: f64 = 0.03;

/// Autocovariance of one channel's noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Colour {
    /// By lag in targets, from 0 on, in units of the variance that white noise of the estimated size would have.
    pub covariance: Vec<f64>,
}

impl Colour {
    /// White noise of the estimated size.
    pub fn white() -> Self {
        Colour { covariance: vec![1.0] }
    }

    /// At a lag.
    pub fn at(&self, lag: usize) -> f64 {
        self.covariance.get(lag).copied().unwrap_or(0.0)
    }

    /// The first lag at which the noise has forgotten itself, at least 1.
    pub fn forgotten(&self) -> usize {
        (1..self.covariance.len())
            .find(|&k| self.at(k) <= FORGOTTEN * self.at(0))
            .unwrap_or(self.covariance.len().max(1))
    }

    /// Standard deviation of one product of neighbours `lag` apart in a sum of many: the square root of Bartlett's sum.
    pub fn spread(&self, lag: usize) -> f64 {
        let reach = (self.covariance.len() + lag) as isize;
        let at = |k: isize| self.at(k.unsigned_abs());
        let sum: f64 = (-reach..=reach).map(|k| at(k) * at(k) + at(k + lag as isize) * at(k - lag as isize)).sum();
        sum.max(self.at(0) * self.at(0)).sqrt()
    }
}

/// By [`Channel`]: the noise's colour as these residuals show it where the lever is free.
pub fn colours(problem: &Problem, residuals: &[Vec<f64>]) -> Vec<Colour> {
    let other = Windows::for_rows(problem);
    let shape = other.as_ref().unwrap_or(&FULL);
    let of = |channel: Channel| {
        let (mut windows, mut resting): (Vec<Vec<f64>>, Vec<Vec<f64>>) = Default::default();
        for (s, r) in problem.stretches.iter().zip(residuals).filter(|(s, _)| s.stand == Stand::Free) {
            let own = || s.targets.iter().zip(r).filter(|(t, _)| t.channel == channel);
            let series: Vec<f64> = own().map(|(_, r)| *r).collect();
            windows.extend(series.chunks_exact(shape.size).map(|w| shape.products(w)));
            let rest = own().take_while(|(t, _)| t.middle < problem.plant.rest_rows(s)).count();
            resting.extend(series[..rest].chunks_exact(shape.size).map(|w| shape.products(w)));
        }
        of_windows(shape, windows, resting)
    };
    // a plant that never rests shows no noise apart from what the model misses, which must not pass for noise
    let rests = problem.stretches.iter().any(|s| problem.plant.rest_rows(s) > 0);
    problem.channels().map(|c| if rests { of(c) } else { Colour::white() }).collect()
}

/// `resting`: windows in which the plant rests. Noise is no larger where the plant moves; what is, all over, is a wrong model.
fn of_windows(shape: &Windows, mut windows: Vec<Vec<f64>>, mut resting: Vec<Vec<f64>>) -> Colour {
    for windows in [&mut windows, &mut resting] {
        windows.retain(|w| w.iter().all(|v| v.is_finite()));
    }
    if windows.len() < FEWEST {
        return Colour::white();
    }
    windows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let windows = &windows[windows.len() * 3 / 10..(windows.len() * 6).div_ceil(10)];
    let count = windows.len() as f64;
    let mut seen = DVector::from_fn(shape.lags + 1, |k, _| windows.iter().map(|w| w[k]).sum::<f64>() / count);
    if resting.len() * shape.size >= FEWEST_AT_REST {
        let at_rest =
            DVector::from_fn(shape.lags + 1, |k, _| resting.iter().map(|w| w[k]).sum::<f64>() / resting.len() as f64);
        tracing::debug!(moving = seen[0], rest = at_rest[0], windows = resting.len(), "variance of the noise");
        if seen[0] > LOUDER * at_rest[0].max(shape.share[(0, 0)]) {
            seen = at_rest;
        }
    }
    let covariance = first_order(shape, &seen);
    // where there is hardly any noise, steps of the sensor are all that it shows
    if covariance[0] < 0.05 || !covariance.iter().all(|v| v.is_finite()) {
        return Colour::white();
    }
    let mut out = Colour { covariance };
    // behind the lag at which it is forgotten there is nothing but chance
    out.covariance.truncate(out.forgotten() + 1);
    out
}

/// Autocovariance of first-order noise, averaged over targets, beside white noise that the windows show like this: `A r^k` from lag 1 on, and at 0
/// what fits. What a window's parabola took can't be had back lag by lag, only by such a form: taken as they are, the longer lags
/// would be off by a tenth of the variance.
fn first_order(shape: &Windows, seen: &DVector<f64>) -> Vec<f64> {
    let at_zero = shape.share.column(0);
    let alone = at_zero.dot(seen) / at_zero.dot(&at_zero);
    let misfit = |model: &DVector<f64>| (seen - model).norm_squared();
    let mut best = (misfit(&(at_zero * alone)), alone, 0.0, 0.0);
    for (kept, decaying) in &shape.decaying {
        let (aa, ab, bb) = (decaying.dot(decaying), decaying.dot(&at_zero), at_zero.dot(&at_zero));
        let (a, b) = (decaying.dot(seen), at_zero.dot(seen));
        let determinant = aa * bb - ab * ab;
        let (mut coloured, mut white) = ((a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant);
        // no series is more like its neighbour than like itself
        if coloured * kept > coloured + white {
            let together = decaying + at_zero * (kept - 1.0);
            coloured = together.dot(seen) / together.dot(&together);
            white = coloured * (kept - 1.0);
        }
        let left = misfit(&(decaying * coloured + at_zero * white));
        if coloured > 0.0 && left < best.0 {
            best = (left, coloured + white, coloured, *kept);
        }
    }
    let (_, variance, coloured, kept) = best;
    (0..=shape.lags).map(|k| if k == 0 { variance } else { coloured * kept.powi(k as i32) }).collect()
}

/// Windows of one size, and what their products show of noise.
struct Windows {
    /// Targets in each.
    size: usize,
    /// Longest lag, targets.
    lags: usize,
    /// Takes a window's parabola off.
    freed: DMatrix<f64>,
    /// What the products by lag are on average for noise whose covariance is 1 at one lag and 0 at the others.
    share: DMatrix<f64>,
    /// What windows show of noise that keeps a share of itself from each target to the next, by that share.
    decaying: Vec<(f64, DVector<f64>)>,
}

/// Those of rows that are no further apart than targets need be.
static FULL: LazyLock<Windows> = LazyLock::new(|| Windows::of(WINDOW));

impl Windows {
    /// Those for the usual distance of the rows of a free lever; `None`: the full ones. Of another plant's times nothing is known.
    fn for_rows(problem: &Problem) -> Option<Windows> {
        let free = problem.stretches.iter().filter(|s| s.stand == Stand::Free && s.protocol.is_some());
        let distances = |time_s: &[f64]| median(&mut time_s.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>());
        let distance_s = median(&mut free.map(|s| distances(&s.time_s)).collect::<Vec<_>>());
        (distance_s > FULL_S).then(|| Windows::of(size_of(distance_s)))
    }

    fn of(size: usize) -> Windows {
        let lags = LAGS * size / WINDOW;
        let at = |t: usize| 2.0 * t as f64 / (size - 1) as f64 - 1.0;
        let basis = DMatrix::from_fn(size, 3, |t, j| at(t).powi(j as i32));
        let q = basis.qr().q();
        let freed = DMatrix::identity(size, size) - &q * q.transpose();
        let mut share = DMatrix::zeros(lags + 1, lags + 1);
        for j in 0..=lags {
            let own = DMatrix::from_fn(size, size, |a, b| if a.abs_diff(b) == j { 1.0 } else { 0.0 });
            let left = &freed * own * &freed;
            for k in 0..=lags {
                share[(k, j)] = (k..size).map(|t| left[(t, t - k)]).sum::<f64>() / (size - k) as f64;
            }
        }
        // as long a memory, in windows, as in full ones
        let most = KEPT.powf(WINDOW as f64 / size as f64);
        let shares = (10..=96).map(|hundredths| hundredths as f64 / 100.0).filter(|kept| *kept <= most);
        let decaying =
            shares.map(|kept| (kept, &share * DVector::from_fn(lags + 1, |k, _| kept.powi(k as i32)))).collect();
        Windows { size, lags, freed, share, decaying }
    }

    /// Mean products by lag of a window freed of its parabola.
    fn products(&self, window: &[f64]) -> Vec<f64> {
        let left = &self.freed * DVector::from_column_slice(window);
        let mean = |k: usize| (k..self.size).map(|t| left[t] * left[t - k]).sum::<f64>() / (self.size - k) as f64;
        (0..=self.lags).map(mean).collect()
    }
}

/// Targets in a window where rows so far apart are targets each.
fn size_of(distance_s: f64) -> usize {
    let full_s = 0.01 * WINDOW as f64;
    // rounding of the times makes no target less
    ((full_s / distance_s + 1e-6) as usize).clamp(LEAST_WINDOW, WINDOW)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// First-order noise of variance 1 that keeps this share of itself from one target to the next.
    fn noise(kept: f64, count: usize, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut last = 0.0;
        let fresh = (1.0 - kept * kept).sqrt();
        (0..count)
            .map(|_| {
                let z: f64 = StandardNormal.sample(&mut rng);
                last = kept * last + fresh * z;
                last
            })
            .collect()
    }

    fn colour_of(series: &[f64]) -> Colour {
        of_windows(&FULL, series.chunks_exact(WINDOW).map(|w| FULL.products(w)).collect(), Vec::new())
    }

    #[test]
    fn a_misfit_that_is_everywhere_is_no_noise_where_the_rest_is_quiet() {
        let quiet = noise(0.4, 6 * WINDOW, 3);
        // wherever it moves the model swings along with something that the plant does not do
        let wrong: Vec<f64> =
            noise(0.0, 40_000, 4).iter().enumerate().map(|(t, v)| v + 9.0 * (t as f64 * 0.3).sin()).collect();
        let windows = |series: &[f64]| series.chunks_exact(WINDOW).map(|w| FULL.products(w)).collect::<Vec<_>>();
        assert!(of_windows(&FULL, windows(&wrong), Vec::new()).at(0) > 10.0);
        let c = of_windows(&FULL, windows(&wrong), windows(&quiet));
        assert!((0.6..1.5).contains(&c.at(0)), "{c:?}");
        // which the rest of one run alone tells
        let c = of_windows(&FULL, windows(&wrong), windows(&quiet[..WINDOW]));
        assert!((0.3..3.0).contains(&c.at(0)), "{c:?}");
        // and a rest that is quieter by chance, or behind a coarse step, changes nothing
        let rest: Vec<f64> = quiet.iter().map(|v| 0.7 * v).collect();
        let moving = noise(0.4, 40_000, 6);
        assert_eq!(of_windows(&FULL, windows(&moving), windows(&rest)), colour_of(&moving));
        assert_eq!(of_windows(&FULL, windows(&moving), windows(&[0.0; 6 * WINDOW])), colour_of(&moving));
    }

    #[test]
    fn colour_is_found_beside_a_slow_motion_and_jumps() {
        for kept in [0.0f64, 0.4, 0.7] {
            let mut series = noise(kept, 40_000, 5);
            for (t, v) in series.iter_mut().enumerate() {
                // a misfit: slow, and a decaying peak of a quarter of a second every four seconds
                *v += 3.0 * (t as f64 * 0.004).sin() + 8.0 * (-((t % 400) as f64) / 12.0).exp();
            }
            let c = colour_of(&series);
            assert!((c.at(0) - 1.0).abs() < 0.25, "{kept}: {c:?}");
            for k in 1..c.forgotten() {
                assert!((c.at(k) / c.at(0) - kept.powi(k as i32)).abs() < 0.06, "{kept}, lag {k}: {c:?}");
            }
            // what is taken for forgotten is: of the noise's own size less than a fifth is left
            let left = kept.powi(c.forgotten() as i32) - c.at(c.forgotten()).max(0.0);
            assert!(left.abs() < 0.04, "{kept}: {left} at lag {}", c.forgotten());
            let expected = if kept > 0.0 { (FORGOTTEN.ln() / kept.ln()).ceil() as usize } else { 1 };
            assert!(
                (expected.saturating_sub(1)..=expected + 4).contains(&c.forgotten()),
                "{kept}: {} for {expected}",
                c.forgotten()
            );
        }
    }

    #[test]
    fn the_spread_is_that_of_sums_of_products() {
        for kept in [0.0f64, 0.6] {
            let series = noise(kept, 400_000, 9);
            let c = colour_of(&series);
            let lag = c.forgotten();
            let sums: Vec<f64> = series
                .chunks_exact(2000)
                .map(|s| {
                    (lag..s.len()).map(|t| s[t] * s[t - lag] - kept.powi(lag as i32)).sum::<f64>()
                        / (2000.0f64 - lag as f64).sqrt()
                })
                .collect();
            let seen = (sums.iter().map(|s| s * s).sum::<f64>() / sums.len() as f64).sqrt();
            assert!((c.spread(lag) / seen - 1.0).abs() < 0.2, "{kept}: {} for {seen}", c.spread(lag));
        }
    }

    #[test]
    fn without_noise_it_is_white() {
        assert_eq!(colour_of(&vec![0.0; 4000]), Colour::white());
        assert_eq!(colour_of(&[1.0; 100]), Colour::white());
    }

    #[test]
    fn windows_of_slow_rows_are_as_long_in_time_and_a_rest_holds_one() {
        assert_eq!([0.011, 0.016, 0.02, 0.05, 0.064, 0.25].map(size_of), [58, 40, 32, 16, 16, 16]);
        for size in [40, 20, 16] {
            let shape = Windows::of(size);
            let windows = |series: &[f64]| series.chunks_exact(size).map(|w| shape.products(w)).collect::<Vec<_>>();
            let quiet = noise(0.0, 40_000, 8);
            let c = of_windows(&shape, windows(&quiet), Vec::new());
            assert!((0.6..1.3).contains(&c.at(0)), "{size}: {c:?}");
            // wherever it moves the model swings along with something that the plant does not do
            let wrong: Vec<f64> =
                quiet.iter().enumerate().map(|(t, v)| v + 30.0 * (t as f64 * 19.2 / size as f64).sin()).collect();
            assert!(of_windows(&shape, windows(&wrong), Vec::new()).at(0) > 30.0, "{size}");
            // of which the rests of eight runs, a window each, know nothing
            let c = of_windows(&shape, windows(&wrong), windows(&quiet[..8 * size]));
            assert!((0.3..4.0).contains(&c.at(0)), "{size}: {c:?}");
        }
    }
}
