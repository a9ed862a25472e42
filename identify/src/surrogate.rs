//! Null distributions by surrogates: a candidate must explain more than what has its spectrum, but phases drawn anew (Theiler et al.,
//! Testing for nonlinearity in time series: the method of surrogate data, Physica D 58, 1992).
//!
//! Signs of whole clusters keep the colour within a cluster. Where excitation and misfit share a few frequencies over the whole
//! recording, as under a periodic reference, clusters agree about anything at these frequencies, and only surrogates keep the level.

use std::sync::Arc;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use crate::score::{Direction, Scene};
use crate::significance::p_of_largest;

/// Draws of the null distribution: a p-value of 0.01 leaves room for one surrogate that explains as much.
const DRAWS: u64 = 199;
/// A direction whose mean holds more of its power than this has hardly any phases to draw.
const CONSTANT: f64 = 0.5;

/// A series taken apart into its frequencies.
pub struct Spectrum {
    mean: f64,
    bins: Vec<Complex<f64>>,
    back: Arc<dyn Fft<f64>>,
}

impl Spectrum {
    /// Of a series of finite values.
    pub fn of(series: &[f64]) -> Spectrum {
        let n = series.len().max(1);
        let mean = series.iter().sum::<f64>() / n as f64;
        let mut bins: Vec<Complex<f64>> = series.iter().map(|v| Complex::new(v - mean, 0.0)).collect();
        let mut planner = FftPlanner::new();
        planner.plan_fft_forward(n).process(&mut bins);
        Spectrum { mean, bins, back: planner.plan_fft_inverse(n) }
    }

    /// A series with this mean and power at every frequency, and random phases.
    pub fn surrogate(&self, rng: &mut impl Rng) -> Vec<f64> {
        let n = self.bins.len();
        let mut bins = vec![Complex::new(0.0, 0.0); n];
        for k in 1..n.div_ceil(2) {
            bins[k] = Complex::from_polar(self.bins[k].norm(), rng.random_range(0.0..std::f64::consts::TAU));
            bins[n - k] = bins[k].conj();
        }
        if n > 0 && n.is_multiple_of(2) {
            bins[n / 2] = if rng.random::<bool>() { self.bins[n / 2] } else { -self.bins[n / 2] };
        }
        self.back.process(&mut bins);
        bins.iter().map(|v| self.mean + v.re / n as f64).collect()
    }
}

/// Share of a direction's power that the means of its stretches hold.
pub fn constant_share(d: &Direction) -> f64 {
    let held: f64 = d.secant.iter().map(|s| s.iter().sum::<f64>().powi(2) / s.len().max(1) as f64).sum();
    held / d.square
}

/// What a direction explains, of whatever sign.
fn gain(d: &Direction) -> f64 {
    d.with_residual * d.with_residual / d.square
}

/// p-value of one direction: how often the best surrogate of any candidate explains as much as it does. The maximum over
/// the candidates makes the selection pay for itself; `candidates` holds what the direction was selected from, itself included.
///
/// A direction that is constant for the most part has no phases; it is judged by the signs of clusters, as
/// [`p_of_largest`] does.
pub fn p_of_selected(scene: &Scene, tested: &Direction, candidates: &[&Direction], seed: u64) -> f64 {
    if constant_share(tested) > CONSTANT {
        return p_of_largest(&[scene.by_cluster(tested)], &[false], seed);
    }
    let spectra: Vec<(&Direction, Vec<Spectrum>)> = candidates
        .iter()
        .filter(|d| constant_share(d) <= CONSTANT)
        .map(|d| (*d, d.raw.iter().map(|s| Spectrum::of(s)).collect()))
        .collect();
    let observed = gain(tested);
    let exceeded: u64 = (0..DRAWS)
        .into_par_iter()
        .map(|draw| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(draw));
            let most = spectra.iter().map(|(d, spectrum)| {
                let secant = spectrum.iter().map(|s| s.surrogate(&mut rng)).collect();
                scene.along(d.effect, &d.start, secant).map_or(0.0, |s| gain(&s))
            });
            u64::from(most.fold(0.0, f64::max) >= observed)
        })
        .sum();
    (exceeded + 1) as f64 / (DRAWS + 1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surrogate_keeps_mean_power_and_colour_and_nothing_else() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for n in [501, 500] {
            let mut last = 0.0;
            let series: Vec<f64> = (0..n)
                .map(|_| {
                    last = 0.9 * last + rng.random_range(-1.0..1.0);
                    3.0 + last
                })
                .collect();
            let other = Spectrum::of(&series).surrogate(&mut rng);
            let moments = |v: &[f64]| {
                let mean = v.iter().sum::<f64>() / v.len() as f64;
                let square = v.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
                // circular, as the spectrum is
                let lagged: f64 = (0..v.len()).map(|i| (v[i] - mean) * (v[(i + 1) % v.len()] - mean)).sum();
                (mean, square, lagged / square)
            };
            let (a, b) = (moments(&series), moments(&other));
            assert!(
                (a.0 - b.0).abs() < 1e-9 && (a.1 / b.1 - 1.0).abs() < 1e-9 && (a.2 - b.2).abs() < 1e-9,
                "{a:?} {b:?}"
            );
            let cross: f64 = series.iter().zip(&other).map(|(x, y)| (x - a.0) * (y - b.0)).sum();
            assert!(cross.abs() < 0.6 * a.1, "{cross} of {}", a.1);
        }
    }
}
