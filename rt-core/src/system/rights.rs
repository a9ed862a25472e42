//! What the process is allowed to ask for.

use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, capabilities};
use std::fmt;

/// A resource limit of the process, in the unit of the resource; `None` = unlimited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Limit(pub Option<u64>);

impl Limit {
    /// Memory that may be locked, bytes.
    pub fn locked_memory() -> Self {
        Limit(getrlimit(Resource::Memlock).current)
    }

    /// Highest real-time priority.
    pub fn priority() -> Self {
        Limit(getrlimit(Resource::Rtprio).current)
    }

    pub fn unlimited(self) -> bool {
        self.0.is_none()
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(limit) => write!(f, "{limit}"),
            None => f.write_str("unlimited"),
        }
    }
}

/// The calling thread has the capability in effect. Where the kernel does not tell, it has not.
pub(super) fn may(capability: CapabilitySet) -> bool {
    capabilities(None).is_ok_and(|sets| sets.effective.contains(capability))
}
