//! The loops to compare with: one that does nothing but wait for its next period, and the program cyclictest, which is one.

use crate::latency::statistics::Distribution;
use rt_core::PERIOD_NS;
use rt_core::system::time::{monotonic_ns, sleep_until_ns};
use std::io;
use std::process::{Command, Stdio};

/// Lead before the first wait, ns: it is a wait like any other.
const LEAD_NS: u64 = 2_000_000;

/// Waits for `ticks` periods with the loop's own wait and its rule for skipping (periods that have passed are not
/// waited for); appends how late each wake-up was, ns. Allocates nothing where `into` has room.
pub fn wait_only(ticks: u64, into: &mut Vec<u64>) {
    let origin_ns = monotonic_ns() + LEAD_NS;
    let mut index = 0;
    while index < ticks {
        let due_ns = origin_ns + index * PERIOD_NS;
        sleep_until_ns(due_ns);
        let woken_ns = monotonic_ns();
        into.push(woken_ns - due_ns);
        index = (index + 1).max((woken_ns - origin_ns).div_ceil(PERIOD_NS));
    }
}

/// Longest lateness that cyclictest tells apart, us.
const CYCLICTEST_MAX_US: u64 = 100_000;

/// Why cyclictest gave no figures.
#[derive(Debug, thiserror::Error)]
pub enum CyclictestError {
    /// It could not be started.
    #[error(
        "cyclictest: expected the program on this machine (package rt-tests), got \"{0}\"; install it, or leave out --cyclictest"
    )]
    Start(#[source] io::Error),
    /// It ended without a histogram.
    #[error("cyclictest {arguments}: expected a histogram, got {what}")]
    Output {
        /// How it was called.
        arguments: String,
        /// What came instead.
        what: String,
    },
}

/// Runs cyclictest for `ticks` periods: its wake-ups' lateness. It skips periods that have passed, holds a latency
/// request and locks its memory by itself; `priority` (1..=99) is the loop's, `None` where it has none, `cpus` those that it may
/// run on.
pub fn cyclictest(ticks: u64, priority: Option<u8>, cpus: Option<&[usize]>) -> Result<Distribution, CyclictestError> {
    let mut arguments: Vec<String> =
        ["-m", "-q", "-i", "1000", "-l", &ticks.to_string(), "-h", &CYCLICTEST_MAX_US.to_string()]
            .map(str::to_owned)
            .into();
    arguments.extend(priority.map(|priority| format!("-p{priority}")));
    let list = |cpus: &[usize]| cpus.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
    arguments.extend(cpus.map(|cpus| format!("-a{}", list(cpus))));
    let output =
        Command::new("cyclictest").args(&arguments).stdin(Stdio::null()).output().map_err(CyclictestError::Start)?;
    let failed = |what: String| CyclictestError::Output { arguments: arguments.join(" "), what };
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(failed(format!("{}, {:?}", output.status, said.trim())));
    }
    let lateness = read_histogram(&String::from_utf8_lossy(&output.stdout)).map_err(&failed)?;
    if lateness.count() == 0 {
        return Err(failed("one without a wake-up".to_owned()));
    }
    Ok(lateness)
}

/// Reads `LATENCY COUNT` lines. A latency is cut off to whole us there, so it stands for the middle of its microsecond;
/// those beyond the histogram are as long as the longest one.
fn read_histogram(text: &str) -> Result<Distribution, String> {
    let mut lateness = Distribution::default();
    let (mut longest_us, mut beyond) = (0, 0);
    for (line, content) in text.lines().enumerate() {
        let number = |word: Option<&str>| {
            let word = word.unwrap_or_default();
            word.parse::<u64>().map_err(|_| format!("line {}: {content:?}", line + 1))
        };
        if let Some(value) = content.strip_prefix("# Max Latencies:") {
            longest_us = number(value.split_whitespace().next())?;
        } else if let Some(value) = content.strip_prefix("# Histogram Overflows:") {
            beyond = number(value.split_whitespace().next())?;
        } else if content.starts_with(|c: char| c.is_ascii_digit()) {
            let mut words = content.split_whitespace();
            let (us, times) = (number(words.next())?, number(words.next())?);
            if times > 0 {
                lateness.record_times_ns(us * 1000 + 500, times);
            }
        }
    }
    if beyond > 0 {
        lateness.record_times_ns(longest_us * 1000 + 500, beyond);
    }
    Ok(lateness)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAID: &str = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000000 000000\n000009 000002\n000017 000995\n\
                        002000 000001\n# Total: 000001000\n# Min Latencies: 00009\n# Avg Latencies: 00017\n\
                        # Max Latencies: 123456\n# Histogram Overflows: 00002\n# Histogram Overflow at cycle number:\n\
                        # Thread 0: 00017\n";

    #[test]
    fn the_histogram_of_cyclictest_is_read_to_the_last_wake_up() {
        let lateness = read_histogram(SAID).expect("as cyclictest prints it");
        assert_eq!((lateness.count(), lateness.late()), (1000, 3), "2000.5 us and two beyond the histogram are late");
        let figures = lateness.figures();
        assert!((figures.p50 - 17.5).abs() < 0.05, "{figures:?}");
        assert!((figures.max - 123_456.5).abs() < 100.0, "{figures:?}");
    }

    #[test]
    fn a_histogram_that_is_none_is_refused_with_its_line() {
        assert_eq!(read_histogram("# Histogram\n000001 many\n").expect_err("no number"), "line 2: \"000001 many\"");
        assert_eq!(read_histogram("").expect("nothing to read").count(), 0);
    }

    #[test]
    fn the_bare_loop_waits_for_each_period_that_has_not_passed() {
        let mut lateness_ns = Vec::with_capacity(50);
        let begin_ns = monotonic_ns();
        wait_only(50, &mut lateness_ns);
        assert!(monotonic_ns() - begin_ns >= 49 * PERIOD_NS);
        // A wake-up that was late by n periods stands for n + 1 of them.
        let periods: u64 = lateness_ns.iter().map(|ns| 1 + ns.saturating_sub(1) / PERIOD_NS).sum();
        assert!(lateness_ns.len() <= 50 && periods >= 50, "{lateness_ns:?}");
    }
}
