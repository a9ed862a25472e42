//! `bench doctor`: what of this machine speaks against a run in real time, and what to change.
//!
//! Each [`Check`] is a small pure function of the [`Surroundings`]: the files of /proc and /sys below a [`Root`], and the few
//! facts that no file holds. [`CHECKS`] is the list; adding a check = one function + one line.

mod can;
mod cpus;
mod kernel;
mod rights;
mod serial;
mod space;
mod surroundings;

use serde::Serialize;
use std::fmt;

pub use space::MB_A_MINUTE;
pub use surroundings::{Asked, Root, Space, Surroundings};

/// How serious a finding is; the later the worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// This machine knows no such thing, or does not tell.
    Absent,
    /// As it should be.
    Ok,
    /// Real time works; timing would be better otherwise.
    Advice,
    /// A run would be refused, or fail, or be late as a rule.
    Problem,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            State::Absent => "absent",
            State::Ok => "ok",
            State::Advice => "advice",
            State::Problem => "problem",
        })
    }
}

/// What a check says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// How serious it is.
    pub state: State,
    /// What was found.
    pub found: String,
    /// What to do; empty exactly when the state is ok.
    pub remedy: String,
}

impl Verdict {
    fn ok(found: impl Into<String>) -> Self {
        Verdict { state: State::Ok, found: found.into(), remedy: String::new() }
    }

    fn absent(found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Verdict { state: State::Absent, found: found.into(), remedy: remedy.into() }
    }

    fn advice(found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Verdict { state: State::Advice, found: found.into(), remedy: remedy.into() }
    }

    fn problem(found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Verdict { state: State::Problem, found: found.into(), remedy: remedy.into() }
    }

    /// One verdict on several things of a kind, which must not be none: as bad as the worst, each remedy once.
    fn over(several: Vec<Verdict>) -> Self {
        let state = several.iter().map(|verdict| verdict.state).max().unwrap_or(State::Absent);
        let mut remedies: Vec<&str> = Vec::new();
        for verdict in &several {
            if verdict.state > State::Ok && !remedies.contains(&verdict.remedy.as_str()) {
                remedies.push(&verdict.remedy);
            }
        }
        let found: Vec<&str> = several.iter().map(|verdict| verdict.found.as_str()).collect();
        Verdict { state, found: found.join("; "), remedy: remedies.join("; ") }
    }
}

/// One thing to look at.
#[derive(Debug)]
pub struct Check {
    /// Unique among the checks.
    pub name: &'static str,
    /// Looks at it. Reads files below the root, nothing else.
    pub look: fn(&Surroundings) -> Verdict,
}

/// All checks, in the order in which they are said.
pub const CHECKS: [Check; 18] = [
    Check { name: "kernel", look: kernel::preemption },
    Check { name: "high-resolution timers", look: kernel::timer_resolution },
    Check { name: "clock source", look: kernel::clock_source },
    Check { name: "real-time throttling", look: kernel::throttling },
    Check { name: "virtual machine", look: kernel::virtual_machine },
    Check { name: "CPUs", look: cpus::count },
    Check { name: "isolated CPUs", look: cpus::isolation },
    Check { name: "governor", look: cpus::governor },
    Check { name: "idle states", look: cpus::idle_states },
    Check { name: "memory lock", look: rights::memory_lock },
    Check { name: "priority", look: rights::priority },
    Check { name: "trial", look: rights::trial },
    Check { name: "swap", look: rights::swap },
    Check { name: "serial ports", look: serial::latency_timers },
    Check { name: "CAN", look: can::interfaces },
    Check { name: "disk", look: space::disk },
    Check { name: "shared memory", look: space::shared_memory },
    Check { name: "transport", look: space::transport },
];

/// What a check found, under its name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Of the check.
    pub name: &'static str,
    /// How serious it is.
    pub state: State,
    /// What was found.
    pub found: String,
    /// What to do; empty exactly when the state is ok.
    pub remedy: String,
}

/// Goes through all checks.
pub fn examine(surroundings: &Surroundings) -> Vec<Finding> {
    let finding = |check: &Check| {
        let Verdict { state, found, remedy } = (check.look)(surroundings);
        Finding { name: check.name, state, found, remedy }
    };
    CHECKS.iter().map(finding).collect()
}
