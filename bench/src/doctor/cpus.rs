//! The processors: how many, who shares them, how fast they run, how deeply they sleep.

use super::{Root, Surroundings, Verdict};
use rt_core::system::remedies;
use std::collections::{BTreeMap, BTreeSet};
use std::io;

const FOLDER: &str = "/sys/devices/system/cpu";
/// From here on one CPU can be spared for the loop.
const ENOUGH_TO_SPARE: usize = 4;
/// Idle states that wake up within this time do no harm, us.
const QUICK_US: i64 = 10;

/// Number of CPUs in a list such as `0-3,8`; `None` when it is none.
fn members(list: &str) -> Option<usize> {
    let size = |range: &str| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (first, last): (usize, usize) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        last.checked_sub(first)?.checked_add(1)
    };
    if list.is_empty() {
        return Some(0);
    }
    list.split(',').try_fold(0, |sum: usize, range| sum.checked_add(size(range)?))
}

fn online(root: &Root) -> Option<usize> {
    members(&root.text(format!("{FOLDER}/online"))?)
}

/// Names of the CPUs' folders.
fn folders(root: &Root) -> Vec<String> {
    let is_cpu = |name: &String| {
        name.strip_prefix("cpu").is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit()))
    };
    root.names(FOLDER).into_iter().filter(is_cpu).map(|name| format!("{FOLDER}/{name}")).collect()
}

/// The loop takes little of one; the loggers and monitors need another.
pub(super) fn count(surroundings: &Surroundings) -> Verdict {
    match online(&surroundings.root) {
        None => Verdict::absent("the kernel does not tell how many", "judge the machine by `bench latency`"),
        Some(0..=1) => Verdict::advice(
            "1: logger, monitor and loop share it",
            "give the machine a second one, and keep everything else off it during a run",
        ),
        Some(count) => Verdict::ok(count.to_string()),
    }
}

/// A CPU that the scheduler keeps free for the loop.
pub(super) fn isolation(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    let list = |name: &str| root.text(format!("{FOLDER}/{name}")).filter(|list| members(list).is_some_and(|n| n > 0));
    let no_ticks = list("nohz_full").map_or_else(String::new, |list| format!(", without ticks {list}"));
    if let Some(isolated) = list("isolated") {
        return Verdict::ok(format!("{isolated}{no_ticks}; to be named at the run: --cpu {isolated}"));
    }
    match online(root) {
        Some(count) if count >= ENOUGH_TO_SPARE => {
            let last = count - 1;
            Verdict::advice(
                format!("none of {count}"),
                format!(
                    "boot with isolcpus=managed_irq,domain,{last} nohz_full={last} rcu_nocbs={last} irqaffinity=0, and run with \
                     --cpu {last}"
                ),
            )
        }
        Some(count) => Verdict::ok(format!("none; with {count} none can be spared")),
        None => Verdict::absent("the kernel does not tell", "nothing to do"),
    }
}

/// Clock rates that follow the load make the loop's stages take several times as long after a quiet millisecond.
pub(super) fn governor(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    let governors: BTreeSet<String> =
        folders(root).iter().filter_map(|cpu| root.text(format!("{cpu}/cpufreq/scaling_governor"))).collect();
    let found = governors.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    if governors.is_empty() {
        Verdict::absent(
            "the kernel does not set the clock rate",
            "nothing to do here; see the firmware's energy settings",
        )
    } else if governors.iter().all(|name| name == "performance") {
        Verdict::ok(found)
    } else {
        Verdict::advice(
            found,
            "`cpupower frequency-set -g performance`, or `echo performance | tee \
             /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`",
        )
    }
}

/// How long the deepest sleep takes to end, and whether it can be forbidden for a run.
pub(super) fn idle_states(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    let mut latency_us_of = BTreeMap::new();
    for cpu in folders(root) {
        for state in root.names(format!("{cpu}/cpuidle")) {
            let folder = format!("{cpu}/cpuidle/{state}");
            if root.number(format!("{folder}/disable")).unwrap_or(0) != 0 {
                continue;
            }
            if let (Some(name), Some(us)) =
                (root.text(format!("{folder}/name")), root.number(format!("{folder}/latency")))
            {
                latency_us_of.insert(name, us);
            }
        }
    }
    let deepest = latency_us_of.into_iter().max_by_key(|&(_, us)| us);
    let found = match &deepest {
        Some((name, us)) => format!("deepest {name}, {us} us to wake"),
        None => "none named by the kernel".to_owned(),
    };
    match root.opens("/dev/cpu_dma_latency") {
        Ok(()) => Verdict::ok(format!("{found}; a run forbids them (/dev/cpu_dma_latency)")),
        Err(e) if e.kind() == io::ErrorKind::NotFound && deepest.is_some_and(|(_, us)| us <= QUICK_US) => {
            Verdict::ok(found)
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => Verdict::advice(
            format!("{found}; no /dev/cpu_dma_latency to forbid them"),
            "boot with processor.max_cstate=1 intel_idle.max_cstate=0 (or cpuidle.off=1), or take a kernel with CONFIG_CPU_IDLE=y",
        ),
        Err(e) => Verdict::advice(format!("{found}; /dev/cpu_dma_latency: {e}"), remedies::CPU_LATENCY),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_cpus() {
        let good = [("", 0), ("0", 1), ("0-3", 4), ("0-1,4,6-7", 5)];
        for (list, count) in good {
            assert_eq!(members(list), Some(count), "{list}");
        }
        for none in ["x", "3-1", "0-", ",", "0-18446744073709551615"] {
            assert_eq!(members(none), None, "{none}");
        }
    }
}
