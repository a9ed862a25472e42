//! Null distributions by the wild bootstrap: the sign of each cluster's contribution is drawn anew.
//!
//! Under the null hypothesis a cluster's sum of secant times residual has mean zero, whatever the colour within it. Drawing
//! the signs of whole clusters keeps that colour and the dependence between candidates, so the maximum over all candidates
//! has its own null distribution and the selection pays for itself.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws of the null distribution.
const DRAWS: usize = 1999;

/// A candidate's cluster sums, scaled so that a total is a t statistic; and their signed ranks, likewise. A misfit that sits
/// in few clusters leaves the mean uncertain; the ranks then still speak for the many.
struct Candidate {
    sums: Vec<f64>,
    ranks: Vec<f64>,
    one_sided: bool,
}

impl Candidate {
    fn new(sums: &[f64], one_sided: bool) -> Option<Self> {
        let scaled = |v: Vec<f64>| {
            let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            v.into_iter().map(|x| x / norm).collect()
        };
        if sums.iter().all(|v| *v == 0.0) {
            return None;
        }
        let mut order: Vec<usize> = (0..sums.len()).collect();
        order.sort_by(|a, b| sums[*a].abs().total_cmp(&sums[*b].abs()));
        let mut ranks = vec![0.0; sums.len()];
        for (rank, &i) in order.iter().enumerate().filter(|(_, i)| sums[**i] != 0.0) {
            ranks[i] = (rank as f64 + 1.0) * sums[i].signum();
        }
        Some(Candidate { sums: scaled(sums.to_vec()), ranks: scaled(ranks), one_sided })
    }

    /// The larger of the two squared statistics under these signs.
    fn statistic(&self, signs: &[f64]) -> f64 {
        [&self.sums, &self.ranks]
            .into_iter()
            .map(|v| v.iter().zip(signs).map(|(a, b)| a * b).sum::<f64>())
            .filter(|t| *t > 0.0 || !self.one_sided)
            .map(|t| t * t)
            .fold(0.0, f64::max)
    }
}

/// p-value of the largest statistic of several candidates, given each one's sums by cluster. `one_sided[i]`: only a positive
/// total counts.
pub fn p_of_largest(sums: &[Vec<f64>], one_sided: &[bool], seed: u64) -> f64 {
    let candidates: Vec<Candidate> = sums.iter().zip(one_sided).filter_map(|(s, o)| Candidate::new(s, *o)).collect();
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

    #[test]
    fn keeps_its_level_over_twenty_candidates_with_heavy_clusters() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut rejected = 0;
        for trial in 0..300 {
            let sums: Vec<Vec<f64>> = (0..20)
                .map(|_| {
                    (0..80)
                        .map(|c| {
                            let z: f64 = StandardNormal.sample(&mut rng);
                            z * if c % 10 == 0 { 6.0 } else { 1.0 }
                        })
                        .collect()
                })
                .collect();
            if p_of_largest(&sums, &[false; 20], trial) <= 0.05 {
                rejected += 1;
            }
        }
        assert!((3..=27).contains(&rejected), "{rejected} of 300 at level 5 %");
    }

    #[test]
    fn sees_what_is_there_and_respects_the_sign() {
        let there = vec![1.0; 60];
        assert!(p_of_largest(std::slice::from_ref(&there), &[false], 1) < 0.002);
        let mut heavy = there.clone();
        heavy[5] = 50.0;
        assert!(p_of_largest(&[heavy], &[false], 1) < 0.002, "the many agree");
        assert!(p_of_largest(&[there.iter().map(|v| -v).collect()], &[true], 1) > 0.3);
    }
}
