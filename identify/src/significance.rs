//! Null distributions by the wild bootstrap: the sign of each cluster's contribution is drawn anew.
//!
//! Under the null hypothesis a cluster's sum of secant times residual has mean zero, whatever the colour within it. Drawing
//! the signs of whole clusters keeps that colour and the dependence between candidates, so the maximum over all candidates
//! has its own null distribution and the selection pays for itself.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws of the null distribution.
const DRAWS: usize = 1999;

/// p-value of the largest of several squared t statistics, given each candidate's sums by cluster. `one_sided[i]`: only a
/// positive total counts.
pub fn p_of_largest(sums: &[Vec<f64>], one_sided: &[bool], seed: u64) -> f64 {
    let scaled: Vec<(Vec<f64>, bool)> = sums
        .iter()
        .zip(one_sided)
        .filter_map(|(s, o)| {
            let norm = s.iter().map(|v| v * v).sum::<f64>().sqrt();
            (norm > 0.0).then(|| (s.iter().map(|v| v / norm).collect(), *o))
        })
        .collect();
    if scaled.is_empty() {
        return 1.0;
    }
    let largest = |signs: Option<&[f64]>| {
        let mut most = 0.0f64;
        for (s, one) in &scaled {
            let t: f64 = match signs {
                None => s.iter().sum(),
                Some(signs) => s.iter().zip(signs).map(|(a, b)| a * b).sum(),
            };
            if t > 0.0 || !one {
                most = most.max(t * t);
            }
        }
        most
    };
    let observed = largest(None);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut signs = vec![1.0; scaled[0].0.len()];
    let mut exceeded = 0;
    for _ in 0..DRAWS {
        for s in &mut signs {
            *s = if rng.random::<bool>() { 1.0 } else { -1.0 };
        }
        if largest(Some(&signs)) >= observed {
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
        assert!(p_of_largest(&[there.clone()], &[false], 1) < 0.002);
        assert!(p_of_largest(&[there.iter().map(|v| -v).collect()], &[true], 1) > 0.3);
    }
}
