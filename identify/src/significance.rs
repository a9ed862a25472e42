//! Null distributions by the wild bootstrap: the sign of each cluster's contribution is drawn anew.
//!
//! Under the null hypothesis a cluster's sum of secant times residual has mean zero, whatever the colour within it. Drawing
//! the signs of whole clusters keeps that colour and the dependence between candidates, so the maximum over all candidates
//! has its own null distribution and the selection pays for itself.

use crate::score::Evidence;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws of the null distribution.
const DRAWS: usize = 1999;

/// A candidate's cluster sums and cosines, each scaled so that a total is a t statistic. A misfit that sits in few clusters
/// leaves the mean of the sums uncertain; the cosines then still speak for the many.
struct Candidate {
    sums: Vec<f64>,
    cosines: Vec<f64>,
    one_sided: bool,
}

impl Candidate {
    fn new(evidence: &Evidence, one_sided: bool) -> Option<Self> {
        let scaled = |v: &[f64]| {
            let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            (norm > 0.0).then(|| v.iter().map(|x| x / norm).collect::<Vec<f64>>())
        };
        Some(Candidate { sums: scaled(&evidence.sums)?, cosines: scaled(&evidence.cosines)?, one_sided })
    }

    /// The larger of the two squared statistics under these signs.
    fn statistic(&self, signs: &[f64]) -> f64 {
        [&self.sums, &self.cosines]
            .into_iter()
            .map(|v| v.iter().zip(signs).map(|(a, b)| a * b).sum::<f64>())
            .filter(|t| *t > 0.0 || !self.one_sided)
            .map(|t| t * t)
            .fold(0.0, f64::max)
    }
}

/// p-value of the largest statistic of several candidates, given what each cluster says of each. `one_sided[i]`: only a
/// positive total counts.
pub fn p_of_largest(evidence: &[Evidence], one_sided: &[bool], seed: u64) -> f64 {
    let candidates: Vec<Candidate> =
        evidence.iter().zip(one_sided).filter_map(|(e, o)| Candidate::new(e, *o)).collect();
    let Some(first) = candidates.first() else { return 1.0 };
    let mut signs = vec![1.0; first.sums.len()];
    let largest = |signs: &[f64]| candidates.iter().map(|c| c.statistic(signs)).fold(0.0, f64::max);
    let observed = largest(&signs);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut exceeded = 0;
    for _ in 0..DRAWS {
        for s in &mut signs {
            *s = if rng.random::<bool>() { 1.0 } else { -1.0 };
        }
        if largest(&signs) >= observed {
            exceeded += 1;
        }
    }
    f64::from(exceeded + 1) / (DRAWS + 1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// Evidence of clusters with these sums, all norms of the residual and the secant being `norm`.
    fn evidence(sums: Vec<f64>, norm: impl Fn(usize) -> f64) -> Evidence {
        let cosines = sums.iter().enumerate().map(|(c, v)| v / norm(c)).collect();
        Evidence { sums, cosines }
    }

    #[test]
    fn keeps_its_level_over_twenty_candidates_with_heavy_clusters() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut rejected = 0;
        for trial in 0..300 {
            let size = |c: usize| if c.is_multiple_of(10) { 6.0 } else { 1.0 };
            let candidates: Vec<Evidence> = (0..20)
                .map(|_| {
                    let sums = (0..80)
                        .map(|c| {
                            let z: f64 = StandardNormal.sample(&mut rng);
                            z * size(c)
                        })
                        .collect();
                    evidence(sums, |c| 5.0 * size(c))
                })
                .collect();
            if p_of_largest(&candidates, &[false; 20], trial) <= 0.05 {
                rejected += 1;
            }
        }
        assert!((3..=27).contains(&rejected), "{rejected} of 300 at level 5 %");
    }

    /// Noise whose power falls as one over the frequency, from a step to the whole: sums of first-order noises whose memories
    /// stand one to four.
    fn one_over_f(count: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let mut out = vec![0.0; count];
        let mut memory = 1.0;
        while memory < count as f64 {
            let kept = (-1.0f64 / memory).exp();
            let mut last: f64 = StandardNormal.sample(rng);
            for v in &mut out {
                let z: f64 = StandardNormal.sample(rng);
                last = kept * last + (1.0 - kept * kept).sqrt() * z;
                *v += last;
            }
            memory *= 4.0;
        }
        out
    }

    /// Evidence of twelve candidates over five runs of eight clusters of 50 targets: secants like what a lever does, residual
    /// as given.
    fn runs(rng: &mut ChaCha8Rng, residual: impl Fn(&mut ChaCha8Rng) -> Vec<f64>, planted: f64) -> Vec<Evidence> {
        const CLUSTERS: usize = 8;
        const LENGTH: usize = 50;
        let mut out: Vec<Evidence> = (0..12).map(|_| Evidence { sums: Vec::new(), cosines: Vec::new() }).collect();
        for _ in 0..5 {
            let secants: Vec<Vec<f64>> = (0..12)
                .map(|_| {
                    let (rate, phase) = (rng.random_range(0.02..0.3), rng.random_range(0.0..6.0));
                    let mut sign = 1.0;
                    (0..CLUSTERS * LENGTH)
                        .map(|t| {
                            if rng.random_bool(0.03) {
                                sign = -sign;
                            }
                            sign + (rate * t as f64 + phase).sin()
                        })
                        .collect()
                })
                .collect();
            let mut r = residual(rng);
            for (r, s) in r.iter_mut().zip(&secants[3]) {
                *r += planted * s;
            }
            // what the initial state and the base parameters take up
            let mean = r.iter().sum::<f64>() / r.len() as f64;
            r.iter_mut().for_each(|v| *v -= mean);
            for (e, s) in out.iter_mut().zip(&secants) {
                for (s, r) in s.chunks(LENGTH).zip(r.chunks(LENGTH)) {
                    let sum: f64 = s.iter().zip(r).map(|(s, r)| s * r).sum();
                    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
                    e.sums.push(sum);
                    e.cosines.push(sum / (norm(s) * norm(r)));
                }
            }
        }
        out
    }

    #[test]
    fn keeps_its_level_under_noise_of_any_colour_and_finds_what_is_planted() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let white = |rng: &mut ChaCha8Rng| (0..400).map(|_| StandardNormal.sample(rng)).collect::<Vec<f64>>();
        let pink = |rng: &mut ChaCha8Rng| one_over_f(400, rng);
        let (mut of_white, mut of_pink, mut found) = (0, 0, 0);
        for trial in 0..150 {
            of_white += usize::from(p_of_largest(&runs(&mut rng, white, 0.0), &[false; 12], trial) <= 0.05);
            of_pink += usize::from(p_of_largest(&runs(&mut rng, pink, 0.0), &[false; 12], trial) <= 0.05);
            found += usize::from(p_of_largest(&runs(&mut rng, pink, 0.8), &[false; 12], trial) <= 0.005);
        }
        // 150 trials at 5 %: 7.5 with a standard deviation of 2.7
        assert!(of_white <= 15, "white noise: {of_white} of 150");
        assert!(of_pink <= 15, "1/f noise: {of_pink} of 150");
        assert!(found >= 130, "a third of the noise: {found} of 150");
    }

    #[test]
    fn sees_what_is_there_and_respects_the_sign() {
        let there = || vec![1.0; 60];
        assert!(p_of_largest(&[evidence(there(), |_| 2.0)], &[false], 1) < 0.002);
        let mut heavy = there();
        heavy[5] = 50.0;
        let of = |c: usize| if c == 5 { 100.0 } else { 2.0 };
        assert!(p_of_largest(&[evidence(heavy, of)], &[false], 1) < 0.002, "the many agree");
        let against = there().iter().map(|v| -v).collect();
        assert!(p_of_largest(&[evidence(against, |_| 2.0)], &[true], 1) > 0.3);
    }
}
