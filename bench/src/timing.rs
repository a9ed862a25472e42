//! How well a run kept its time, from its recording.

use crate::failure::{Failure, Kind};
use recordings::{Item, McapReader};
use std::fmt;
use std::path::Path;

/// Quantiles of a duration over the ticks of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantiles {
    /// Median, us.
    pub p50_us: f64,
    /// us.
    pub p99_us: f64,
    /// us.
    pub p999_us: f64,
    /// us.
    pub max_us: f64,
}

impl Quantiles {
    /// Of these durations, ns; all zero where there are none.
    pub fn of(mut durations_ns: Vec<u64>) -> Self {
        durations_ns.sort_unstable();
        let at = |share: f64| {
            let rank = (share * durations_ns.len() as f64).ceil() as usize;
            durations_ns.get(rank.saturating_sub(1)).map_or(0.0, |&ns| ns as f64 * 1e-3)
        };
        Quantiles { p50_us: at(0.5), p99_us: at(0.99), p999_us: at(0.999), max_us: at(1.0) }
    }
}

impl fmt::Display for Quantiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Quantiles { p50_us, p99_us, p999_us, max_us } = self;
        write!(f, "p50 {p50_us:.1} us, p99 {p99_us:.1} us, p99.9 {p999_us:.1} us, max {max_us:.1} us")
    }
}

/// The timing of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// Wake-up later than scheduled.
    pub lateness: Quantiles,
    /// From wake-up to the outputs written.
    pub execution: Quantiles,
    /// Hand-over to the publication.
    pub publication: Quantiles,
}

impl Timing {
    /// Of the run that this file holds.
    pub fn of_recording(path: &Path) -> Result<Self, Failure> {
        let input = |e| Failure::of(Kind::Input, &e);
        let (mut lateness, mut execution, mut publication) = (Vec::new(), Vec::new(), Vec::new());
        for item in McapReader::open(path).map_err(input)? {
            if let Item::Sample(sample) = item.map_err(input)? {
                lateness.push(sample.lateness_ns);
                execution.push(sample.execution_ns());
                publication.push(u64::from(sample.publish_ns));
            }
        }
        Ok(Timing {
            lateness: Quantiles::of(lateness),
            execution: Quantiles::of(execution),
            publication: Quantiles::of(publication),
        })
    }
}

impl fmt::Display for Timing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Timing { lateness, execution, publication } = self;
        write!(f, "wake-up late by {lateness}\nread to write      {execution}\nhand-over          {publication}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occurred() {
        let q = Quantiles::of((1..=1000).rev().map(|k| k * 1000).collect());
        assert_eq!((q.p50_us, q.p99_us, q.p999_us, q.max_us), (500.0, 990.0, 999.0, 1000.0));
        assert_eq!(Quantiles::of(vec![7000]).p50_us, 7.0);
        assert_eq!(Quantiles::of(Vec::new()).max_us, 0.0);
    }
}
