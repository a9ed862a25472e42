//! What the loop does when a tick ends after the next one should have begun.

use std::fmt;
use std::str::FromStr;

use crate::types::PERIOD_NS;

/// What follows a missed deadline. A setting of the profile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OverrunPolicy {
    /// Ticks whose time has passed are not run; the next one is on time. The samples say how many are missing.
    #[default]
    Skip,
    /// Every tick is run, late ones one after the other without a wait, until the loop is on time again.
    CatchUp,
    /// The supervisor trips at the next tick: safe state, aftermath, end of the run.
    SafeState,
    /// The safe state is written at once and the run ends.
    Abort,
}

impl OverrunPolicy {
    /// All of them.
    pub const ALL: [OverrunPolicy; 4] =
        [OverrunPolicy::Skip, OverrunPolicy::CatchUp, OverrunPolicy::SafeState, OverrunPolicy::Abort];

    /// As written in a profile.
    pub fn as_str(self) -> &'static str {
        match self {
            OverrunPolicy::Skip => "skip",
            OverrunPolicy::CatchUp => "catch-up",
            OverrunPolicy::SafeState => "safe-state",
            OverrunPolicy::Abort => "abort",
        }
    }

    /// The tick that follows `index` when its work was done at `now_ns` since the run's start.
    pub(crate) fn next(self, index: u64, now_ns: u64) -> u64 {
        match self {
            OverrunPolicy::CatchUp => index + 1,
            _ => (index + 1).max(now_ns.div_ceil(PERIOD_NS)),
        }
    }
}

impl fmt::Display for OverrunPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for OverrunPolicy {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        OverrunPolicy::ALL.into_iter().find(|policy| policy.as_str() == word).ok_or_else(|| {
            let words: Vec<_> = OverrunPolicy::ALL.iter().map(|policy| policy.as_str()).collect();
            format!("expected one of {}, got {word:?}", words.join(", "))
        })
    }
}
