//! What the process may ask for, and what it gets.

use super::{Root, State, Surroundings, Verdict};
use rt_core::system::{Outcome, Request, remedies};

/// Bits of the capability sets in /proc/self/status (linux/capability.h).
const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;
const UNREADABLE: &str = "/proc/self/limits can't be read";
const SEE_TRIAL: &str = "see the check `trial`, which asks for it";

/// The soft limit of a row of /proc/self/limits.
fn limit(root: &Root, row: &str) -> Option<Option<u64>> {
    let text = root.text("/proc/self/limits")?;
    match text.lines().find_map(|line| line.strip_prefix(row))?.split_whitespace().next()? {
        "unlimited" => Some(None),
        number => number.parse().ok().map(Some),
    }
}

fn has(root: &Root, capability: u32) -> bool {
    let status = root.text("/proc/self/status").unwrap_or_default();
    let set = status.lines().find_map(|line| line.strip_prefix("CapEff:")).map(str::trim);
    set.and_then(|bits| u64::from_str_radix(bits, 16).ok()).is_some_and(|bits| bits >> capability & 1 == 1)
}

/// Locked memory can't be paged out; a limit on it lets later allocations fail.
pub(super) fn memory_lock(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    match limit(root, "Max locked memory") {
        _ if has(root, CAP_IPC_LOCK) => Verdict::ok("without limit by CAP_IPC_LOCK"),
        Some(None) => Verdict::ok("without limit"),
        Some(Some(bytes)) => Verdict::problem(format!("at most {} KiB", bytes >> 10), remedies::MEMORY),
        None => Verdict::absent(UNREADABLE, SEE_TRIAL),
    }
}

/// SCHED_FIFO, without which the loop waits until the others have had their share.
pub(super) fn priority(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    let wanted = u64::from(Request::PRIORITY);
    match limit(root, "Max realtime priority") {
        _ if has(root, CAP_SYS_NICE) => Verdict::ok("any by CAP_SYS_NICE"),
        Some(None) => Verdict::ok("any"),
        Some(Some(highest)) if highest >= wanted => Verdict::ok(format!("up to {highest}")),
        Some(Some(0)) => Verdict::problem("none permitted", remedies::PRIORITY),
        Some(Some(highest)) => Verdict::problem(format!("up to {highest}, the loop's is {wanted}"), remedies::PRIORITY),
        None => Verdict::absent(UNREADABLE, SEE_TRIAL),
    }
}

/// Rights are one thing, control groups and sandboxes another: what came of asking.
pub(super) fn trial(surroundings: &Surroundings) -> Verdict {
    let grants = surroundings.trial.grants();
    let verdicts = grants.iter().filter_map(|grant| match &grant.outcome {
        Outcome::Granted(_) | Outcome::Absent(_) => None,
        Outcome::Refused { cause, remedy } => {
            let remedy = match remedy.as_str() {
                remedies::MEMORY => "see the check `memory lock`",
                remedies::PRIORITY => "see the check `priority`",
                remedies::CPU_LATENCY => "see the check `idle states`",
                other => other,
            };
            let state = if matches!(grant.what, "sched" | "memory") { State::Problem } else { State::Advice };
            Some(Verdict { state, found: format!("{} refused: {cause}", grant.what), remedy: remedy.to_owned() })
        }
    });
    let refused: Vec<Verdict> = verdicts.collect();
    match (grants.len(), refused.is_empty()) {
        (0, _) => Verdict::absent("not made", "run `bench doctor` on the machine itself"),
        (wishes, true) => Verdict::ok(format!("{wishes} wishes of the loop, none refused")),
        (_, false) => Verdict::over(refused),
    }
}

/// The loop's memory is locked; that of the programs beside it is not, and their paging holds up the disk.
pub(super) fn swap(surroundings: &Surroundings) -> Verdict {
    match surroundings.root.text("/proc/swaps") {
        None => Verdict::ok("none"),
        Some(text) => {
            // One line of headings, then one per area.
            let areas: Vec<&str> = text.lines().skip(1).filter_map(|line| line.split_whitespace().next()).collect();
            if areas.is_empty() {
                Verdict::ok("none in use")
            } else {
                Verdict::advice(format!("on: {}", areas.join(", ")), "`swapoff -a` before a session")
            }
        }
    }
}
