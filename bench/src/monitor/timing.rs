//! Lateness and work of the last ticks, and the worst of the run.

use rt_core::Sample;
use std::collections::VecDeque;

/// Ticks that percentiles are of: 10 s.
pub const WINDOW_TICKS: usize = 10_000;

/// See the module. Of one run.
#[derive(Clone, Debug, Default)]
pub struct Timing {
    lateness_ns: VecDeque<u64>,
    work_ns: VecDeque<u64>,
    lateness_max_ns: u64,
    overruns: u64,
    /// The loop has told a wake-up: it runs by the wall's time.
    real: bool,
}

/// What [`Timing::summary`] says. All times in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Summary {
    /// Ticks that the percentiles are of.
    pub ticks: usize,
    /// Median lateness of the wake-ups.
    pub lateness_p50_ns: u64,
    /// 99th percentile of it.
    pub lateness_p99_ns: u64,
    /// Largest of these ticks.
    pub lateness_max_ns: u64,
    /// Largest since the monitor follows the run.
    pub lateness_run_max_ns: u64,
    /// 99th percentile of the time from the wake-up to the outputs.
    pub work_p99_ns: u64,
    /// Ticks that ended too late since the monitor follows the run.
    pub overruns: u64,
}

impl Timing {
    /// Takes a sample.
    pub fn push(&mut self, sample: &Sample) {
        self.real |= sample.woken_ns > 0;
        self.overruns += u64::from(sample.overrun());
        self.lateness_max_ns = self.lateness_max_ns.max(sample.lateness_ns);
        for (kept, value) in [(&mut self.lateness_ns, sample.lateness_ns), (&mut self.work_ns, sample.execution_ns())] {
            if kept.len() == WINDOW_TICKS {
                kept.pop_front();
            }
            kept.push_back(value);
        }
    }

    /// The numbers; `None` in virtual time, where nothing is late, and before the first sample.
    pub fn summary(&self) -> Option<Summary> {
        if !self.real {
            return None;
        }
        let mut lateness: Vec<u64> = self.lateness_ns.iter().copied().collect();
        let mut work: Vec<u64> = self.work_ns.iter().copied().collect();
        Some(Summary {
            ticks: lateness.len(),
            lateness_max_ns: lateness.iter().copied().max()?,
            lateness_p50_ns: percentile(&mut lateness, 50)?,
            lateness_p99_ns: percentile(&mut lateness, 99)?,
            lateness_run_max_ns: self.lateness_max_ns,
            work_p99_ns: percentile(&mut work, 99)?,
            overruns: self.overruns,
        })
    }
}

/// The value that so many per cent of the values do not exceed.
fn percentile(values: &mut [u64], percent: usize) -> Option<u64> {
    let rank = (values.len() * percent).div_ceil(100).max(1) - 1;
    (rank < values.len()).then(|| *values.select_nth_unstable(rank).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::flags;

    #[test]
    fn percentiles_are_of_the_window_and_the_maximum_of_the_run() {
        let mut timing = Timing::default();
        let sample =
            |lateness_ns: u64| Sample { woken_ns: 1, lateness_ns, write_ns: 700, read_ns: 300, ..Sample::BLANK };
        timing.push(&Sample { flags: flags::OVERRUN, ..sample(9_000_000) });
        for lateness_ns in 1..=WINDOW_TICKS as u64 {
            timing.push(&sample(lateness_ns));
        }
        let expected = Summary {
            ticks: WINDOW_TICKS,
            lateness_p50_ns: 5_000,
            lateness_p99_ns: 9_900,
            lateness_max_ns: 10_000,
            lateness_run_max_ns: 9_000_000,
            work_p99_ns: 1_000,
            overruns: 1,
        };
        assert_eq!(timing.summary(), Some(expected));
    }

    #[test]
    fn in_virtual_time_there_is_nothing_to_say() {
        let mut timing = Timing::default();
        assert_eq!(timing.summary(), None);
        timing.push(&Sample::BLANK);
        assert_eq!(timing.summary(), None);
        timing.push(&Sample { woken_ns: 5, lateness_ns: 4, ..Sample::BLANK });
        assert_eq!(timing.summary().map(|summary| summary.lateness_max_ns), Some(4));
    }
}
