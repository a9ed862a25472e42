//! How late the loop woke up in a run, as a histogram for display.

use hdrhistogram::Histogram;

/// Lateness beyond this counts as this, ns.
const LATEST_NS: u64 = 10_000_000_000;

/// Between two counts of the display, us: three to six a decade.
const BOUNDS_US: [f64; 26] = [
    1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 70.0, 100.0, 150.0, 200.0, 300.0, 500.0, 700.0, 1000.0,
    1500.0, 2000.0, 3000.0, 5000.0, 7000.0, 10_000.0, 30_000.0, 100_000.0,
];

/// See the module.
#[derive(Clone, Debug)]
pub struct Lateness {
    histogram: Histogram<u64>,
    counts: [u64; BOUNDS_US.len() + 1],
}

impl Default for Lateness {
    fn default() -> Self {
        let histogram =
            Histogram::new_with_max(LATEST_NS, 3).expect("digits and highest value are within what it can hold");
        Lateness { histogram, counts: [0; BOUNDS_US.len() + 1] }
    }
}

/// What clients are told.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Timing {
    /// Number of the run.
    pub run: u32,
    /// Between the counts, us.
    pub bounds_us: &'static [f64],
    /// Below the first bound, between it and the second, ..., from the last one on.
    pub counts: Vec<u64>,
    /// Median, us.
    pub p50_us: f64,
    /// us
    pub p99_us: f64,
    /// us
    pub max_us: f64,
    /// Ticks that the loop passed over.
    pub skipped: u64,
}

impl Lateness {
    /// A wake-up was late by this.
    pub fn record_ns(&mut self, lateness_ns: u64) {
        self.histogram.saturating_record(lateness_ns);
        let us = lateness_ns as f64 * 1e-3;
        self.counts[BOUNDS_US.partition_point(|&bound| bound <= us)] += 1;
    }

    /// For display.
    pub fn timing(&self, run: u32, skipped: u64) -> Timing {
        let us = |quantile: f64| self.histogram.value_at_quantile(quantile) as f64 * 1e-3;
        Timing {
            run,
            bounds_us: &BOUNDS_US,
            counts: self.counts.to_vec(),
            p50_us: us(0.5),
            p99_us: us(0.99),
            max_us: us(1.0),
            skipped,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wake_up_is_counted_where_it_belongs() {
        let mut lateness = Lateness::default();
        for ns in [0, 999, 1000, 52_000, 99_999, 100_000, u64::MAX] {
            lateness.record_ns(ns);
        }
        let timing = lateness.timing(4, 2);
        assert_eq!(timing.counts.len(), timing.bounds_us.len() + 1);
        // 52 us lie below the bound of 70, 99.999 us below that of 100.
        let below = |bound: f64| timing.counts[timing.bounds_us.iter().position(|&b| b == bound).expect("a bound")];
        assert_eq!([50.0, 70.0, 100.0, 150.0].map(below), [0, 1, 1, 1]);
        assert_eq!(timing.counts.last(), Some(&1), "beyond the last bound");
        assert_eq!(timing.counts.iter().sum::<u64>(), 7);
        assert!((timing.p50_us - 52.0).abs() < 0.1 && timing.max_us >= 9.9e6, "{timing:?}");
        assert!(timing.bounds_us.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
