//! The run that separates best for its time.

use super::Separation;

/// Separation that is enough, standard errors: the diagnosis prefers a model that is 3 better, and one more leaves it room for chance.
pub const ENOUGH: f64 = 4.0;
/// Runs that separate within this share of the best are told apart by their time.
const AS_GOOD: f64 = 0.95;
/// A run that is expected to separate by less than this is not worth its time.
const LEAST: f64 = 1.0;

/// A run on offer.
#[derive(Clone, Debug)]
pub struct Offer {
    /// Rig time with its preparation, s.
    pub seconds: f64,
    /// For each pair of rivals: how much the pair matters (any positive scale), and how the run separates it.
    pub pairs: Vec<(f64, Separation)>,
}

impl Offer {
    /// How much of the question it is expected to settle, 0 to 1. More than [`ENOUGH`] settles no more.
    pub fn settles(&self) -> f64 {
        let all: f64 = self.pairs.iter().map(|(w, _)| w).sum();
        let settled: f64 = self.pairs.iter().map(|(w, s)| w * (s.z / ENOUGH).clamp(0.0, 1.0)).sum();
        if all > 0.0 { settled / all } else { 0.0 }
    }

    /// Expected standard errors a minute, of the pair that it separates best.
    pub fn per_minute(&self) -> f64 {
        self.best() * 60.0 / self.seconds.max(1.0)
    }

    fn best(&self) -> f64 {
        self.pairs.iter().map(|(_, s)| s.z).fold(0.0, f64::max)
    }
}

/// Position of the offer to take: of those that settle nearly as much as any, the one with most standard errors a minute. `None` where none
/// is worth its time.
pub fn choose(offers: &[Offer]) -> Option<usize> {
    let most = offers.iter().map(Offer::settles).fold(0.0, f64::max);
    let good = (0..offers.len()).filter(|&i| offers[i].settles() >= AS_GOOD * most && offers[i].best() >= LEAST);
    good.max_by(|&a, &b| offers[a].per_minute().total_cmp(&offers[b].per_minute()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer(seconds: f64, z: &[f64]) -> Offer {
        let of = |z: &f64| (1.0, Separation { z: *z, noise_floors: 0.1, share: 0.5 });
        Offer { seconds, pairs: z.iter().map(of).collect() }
    }

    #[test]
    fn enough_is_enough_and_then_time_counts() {
        assert_eq!(choose(&[offer(300.0, &[9.0]), offer(60.0, &[4.1]), offer(30.0, &[2.0])]), Some(1));
        assert_eq!(
            choose(&[offer(300.0, &[3.0]), offer(60.0, &[2.0])]),
            Some(0),
            "not enough: the one that settles more"
        );
        assert_eq!(choose(&[offer(60.0, &[9.0, 0.1]), offer(60.0, &[4.0, 3.0])]), Some(1), "both pairs count");
        assert_eq!(choose(&[offer(60.0, &[0.3])]), None);
        assert_eq!(choose(&[]), None);
    }
}
