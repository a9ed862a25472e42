//! Durations of many ticks: their distribution, and what is said of several slices of one kind.

use hdrhistogram::Histogram;
use serde::Serialize;

/// A wake-up that comes later than this is counted as late: two periods of the loop, ns.
pub const LATE_NS: u64 = 2_000_000;

/// Digits that a duration keeps in a distribution.
const DIGITS: u8 = 3;
/// Longest duration in a distribution, ns: 18 minutes. A longer one counts as this.
const LONGEST_NS: u64 = 1 << 40;

/// A distribution of durations: ns in, us out.
#[derive(Clone, Debug)]
pub struct Distribution {
    histogram: Histogram<u64>,
    late: u64,
}

/// What is said of a distribution, us.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Half of the durations are at most this.
    pub p50: f64,
    /// 99 of 100.
    pub p99: f64,
    /// 999 of 1000.
    pub p999: f64,
    /// All.
    pub max: f64,
}

impl Default for Distribution {
    fn default() -> Self {
        let histogram =
            Histogram::new_with_max(LONGEST_NS, DIGITS).expect("3 digits and a maximum above 2 are allowed");
        Distribution { histogram, late: 0 }
    }
}

impl Distribution {
    /// Adds one duration.
    pub fn record_ns(&mut self, ns: u64) {
        self.record_times_ns(ns, 1);
    }

    /// Adds a duration that occurred `times` times.
    pub fn record_times_ns(&mut self, ns: u64, times: u64) {
        self.histogram.saturating_record_n(ns, times);
        self.late += if ns > LATE_NS { times } else { 0 };
    }

    /// Adds all of another one.
    pub fn add(&mut self, other: &Distribution) {
        self.histogram.add(&other.histogram).expect("both have the same range and digits");
        self.late += other.late;
    }

    /// How many durations there are.
    pub fn count(&self) -> u64 {
        self.histogram.len()
    }

    /// How many were longer than [`LATE_NS`].
    pub fn late(&self) -> u64 {
        self.late
    }

    /// The duration that a share of `quantile` (0..=1) does not exceed, us; 0 where there is none.
    pub fn quantile_us(&self, quantile: f64) -> f64 {
        us(self.histogram.value_at_quantile(quantile))
    }

    /// Quantiles and maximum.
    pub fn figures(&self) -> Figures {
        Figures {
            p50: self.quantile_us(0.5),
            p99: self.quantile_us(0.99),
            p999: self.quantile_us(0.999),
            max: us(self.histogram.max()),
        }
    }

    /// How many durations there are within `from_us..to_us`, to the digits that are kept.
    pub fn count_within(&self, from_us: f64, to_us: f64) -> u64 {
        let recorded = self.histogram.iter_recorded();
        let within = recorded.filter(|v| (from_us..to_us).contains(&us(v.value_iterated_to())));
        within.map(|v| v.count_at_value()).sum()
    }

    /// Its durations and how often each occurs, to the digits that are kept; [`record_times_ns`](Self::record_times_ns)
    /// builds the same again.
    pub fn pairs_ns(&self) -> Vec<(u64, u64)> {
        self.histogram.iter_recorded().map(|v| (v.value_iterated_to(), v.count_at_value())).collect()
    }
}

fn us(ns: u64) -> f64 {
    ns as f64 * 1e-3
}

/// All slices of one kind. The machine's own stalls hit single slices, so a tail is judged by the median over slices; the
/// middle of the distribution by all of them together.
#[derive(Clone, Debug, Default)]
pub struct Pool {
    all: Distribution,
    slice_p99_us: Vec<f64>,
}

impl Pool {
    /// Adds a slice; one in which nothing was measured does not count.
    pub fn add(&mut self, slice: &Distribution) {
        if slice.count() > 0 {
            self.all.add(slice);
            self.slice_p99_us.push(slice.quantile_us(0.99));
        }
    }

    /// Adds the slices of another pool.
    pub fn add_pool(&mut self, other: &Pool) {
        self.all.add(&other.all);
        self.slice_p99_us.extend(&other.slice_p99_us);
    }

    /// All slices together.
    pub fn all(&self) -> &Distribution {
        &self.all
    }

    /// How many slices there are.
    pub fn slices(&self) -> usize {
        self.slice_p99_us.len()
    }

    /// Median over the slices of their p99, us; `None` without slices.
    pub fn slice_p99_us(&self) -> Option<f64> {
        median(&self.slice_p99_us)
    }
}

/// A pool in proportion to another: p50 of all slices, median over slices of p99. `None` where either is empty or 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ratio {
    /// Of the medians of all slices together.
    pub p50: Option<f64>,
    /// Of the medians over slices of the slices' p99.
    pub p99: Option<f64>,
    /// Of the shares of wake-ups later than [`LATE_NS`].
    pub late: Option<f64>,
}

impl Ratio {
    /// `this` over `other`.
    pub fn of(this: &Pool, other: &Pool) -> Ratio {
        let p50 = |pool: &Pool| (pool.slices() > 0).then(|| pool.all.quantile_us(0.5));
        let late = |pool: &Pool| (pool.all.count() > 0).then(|| pool.all.late() as f64 / pool.all.count() as f64);
        Ratio {
            p50: quotient(p50(this), p50(other)),
            p99: quotient(this.slice_p99_us(), other.slice_p99_us()),
            late: quotient(late(this), late(other)),
        }
    }
}

fn quotient(this: Option<f64>, other: Option<f64>) -> Option<f64> {
    let (this, other) = (this?, other?);
    (other > 0.0).then(|| this / other)
}

/// The middle value; of an even number of values the mean of the two in the middle. `None` without values.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let half = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        n if n % 2 == 1 => Some(sorted[half]),
        _ => Some((sorted[half - 1] + sorted[half]) / 2.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_us(values: impl IntoIterator<Item = u64>) -> Distribution {
        let mut distribution = Distribution::default();
        values.into_iter().for_each(|us| distribution.record_ns(us * 1000));
        distribution
    }

    fn pool(slices: &[Distribution]) -> Pool {
        let mut pool = Pool::default();
        slices.iter().for_each(|slice| pool.add(slice));
        pool
    }

    #[track_caller]
    fn near(value: f64, expected: f64) {
        assert!((value - expected).abs() <= 2e-3 * expected, "expected {expected}, got {value}");
    }

    #[test]
    fn the_figures_of_1_to_1000_us() {
        let distribution = of_us(1..=1000);
        let Figures { p50, p99, p999, max } = distribution.figures();
        for (value, expected) in [(p50, 500.0), (p99, 990.0), (p999, 999.0), (max, 1000.0)] {
            near(value, expected);
        }
        assert_eq!((distribution.count(), distribution.late()), (1000, 0));
        assert_eq!(Distribution::default().figures(), Figures::default());
    }

    #[test]
    fn late_is_counted_to_the_nanosecond() {
        let mut distribution = Distribution::default();
        for ns in [LATE_NS - 1, LATE_NS, LATE_NS + 1, u64::MAX] {
            distribution.record_ns(ns);
        }
        assert_eq!((distribution.count(), distribution.late()), (4, 2));
        assert!(distribution.quantile_us(0.75) < 2_002.0 && distribution.quantile_us(1.0) > 1e9);
        let mut twice = distribution.clone();
        twice.add(&distribution);
        assert_eq!((twice.count(), twice.late()), (8, 4));
    }

    #[test]
    fn every_duration_is_in_one_bin() {
        let distribution = of_us((0..5000).map(|k| k * k % 7919));
        let edges: Vec<f64> = std::iter::once(0.0).chain((-2..24).map(|k| 2_f64.powf(f64::from(k) / 2.0))).collect();
        let binned: u64 = edges.windows(2).map(|e| distribution.count_within(e[0], e[1])).sum();
        assert_eq!(binned + distribution.count_within(edges[edges.len() - 1], f64::INFINITY), 5000);
        assert_eq!(
            distribution.count_within(0.0, 7.5),
            of_us((0..5000).map(|k| k * k % 7919).filter(|v| *v < 8)).count()
        );
    }

    #[test]
    fn a_distribution_survives_its_way_through_another_process() {
        let distribution = of_us((0..3000).map(|k| k * k));
        let mut again = Distribution::default();
        distribution.pairs_ns().into_iter().for_each(|(ns, times)| again.record_times_ns(ns, times));
        assert_eq!((again.figures(), again.count()), (distribution.figures(), 3000));
        assert_eq!(again.pairs_ns(), distribution.pairs_ns());
    }

    /// One slice in which the machine stalled must not decide on the tail, nor on the middle.
    #[test]
    fn a_stalled_slice_shows_in_the_maximum_alone() {
        let calm = || of_us((0..1000).map(|k| 1000 + k % 10));
        let stalled = || of_us((0..1000).map(|k| if k % 20 == 0 { 9000 } else { 1000 + k % 10 }));
        let (ours, bare) = (pool(&[calm(), stalled(), calm()]), pool(&[calm(), calm(), calm()]));
        let ratio = Ratio::of(&ours, &bare);
        near(ratio.p50.expect("both have slices"), 1.0);
        assert_eq!(ratio.p99, Some(1.0));
        assert_eq!((ratio.late, ours.all().late()), (None, 50), "none of the others is late: no ratio");
        near(ours.all().figures().max, 9000.0);
        near(Ratio::of(&pool(&[of_us([30])]), &pool(&[of_us([20])])).p50.expect("both have slices"), 1.5);
        assert_eq!(Ratio::of(&Pool::default(), &bare), Ratio { p50: None, p99: None, late: None });
        assert_eq!(Ratio::of(&pool(&[stalled(), stalled()]), &pool(&[stalled()])).late, Some(1.0));
    }

    #[test]
    fn the_median_of_odd_and_even_numbers_of_values() {
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[3.0, 1.0, 9.0]), Some(3.0));
        assert_eq!(median(&[3.0, 1.0, 9.0, 4.0]), Some(3.5));
    }
}
