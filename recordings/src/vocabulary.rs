//! The words of a campaign: which experiment a run is, what it may be used for, and how the lever's plane lies.

use std::fmt;
use std::str::FromStr;

/// Which experiment a run is (the contract's protocol table; sections of the paper in brackets).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Protocol {
    /// Lever clamped at several angles, constant voltages until steady (3.1, fig. 2).
    TorqueMap,
    /// Chambers shut off, lever swept slowly, for several amounts of oil (3.1, fig. 3).
    VolumeMap,
    /// Pump alone between two reservoirs (4.1, fig. 5).
    PumpMap,
    /// Lever clamped, oil released from chamber 1 in steps (4.2, fig. 6).
    ClampSteps,
    /// Voltage from the inverted pump characteristic (4.4, fig. 7).
    ConstantFlow,
    /// Open loop, constant amplitude of alternating sign (5, fig. 8).
    SquareWave,
    /// Open loop, voltage steps of random size and length, both valves used.
    RandomSteps,
}

/// What a run may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// May be fitted, and every decision rests on runs of this role.
    Identify,
    /// Only simulated and scored.
    Validate,
}

/// The plane in which the lever moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Plane {
    /// Gravity does not act on the lever.
    Horizontal,
    /// Gravity acts on the lever with `G sin(phi)`.
    Vertical,
}

/// A word that is not in one of the three vocabularies. Says which words are.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a {what} ({allowed}), got {got:?}")]
pub struct UnknownWord {
    /// `"protocol"`, `"role"` or `"plane"`.
    pub what: &'static str,
    /// The words of this vocabulary, quoted, separated by commas.
    pub allowed: String,
    /// What came.
    pub got: String,
}

impl Protocol {
    /// All protocols, in the contract's order.
    pub const ALL: &'static [Protocol] = &[
        Protocol::TorqueMap,
        Protocol::VolumeMap,
        Protocol::PumpMap,
        Protocol::ClampSteps,
        Protocol::ConstantFlow,
        Protocol::SquareWave,
        Protocol::RandomSteps,
    ];

    /// The contract's word, `"torque-map"` and so on.
    pub fn as_str(self) -> &'static str {
        match self {
            Protocol::TorqueMap => "torque-map",
            Protocol::VolumeMap => "volume-map",
            Protocol::PumpMap => "pump-map",
            Protocol::ClampSteps => "clamp-steps",
            Protocol::ConstantFlow => "constant-flow",
            Protocol::SquareWave => "square-wave",
            Protocol::RandomSteps => "random-steps",
        }
    }
}

impl Role {
    /// All roles.
    pub const ALL: &'static [Role] = &[Role::Identify, Role::Validate];

    /// The contract's word, `"identify"` or `"validate"`.
    pub fn as_str(self) -> &'static str {
        match self {
            Role::Identify => "identify",
            Role::Validate => "validate",
        }
    }
}

impl Plane {
    /// All planes.
    pub const ALL: &'static [Plane] = &[Plane::Horizontal, Plane::Vertical];

    /// The contract's word, `"horizontal"` or `"vertical"`.
    pub fn as_str(self) -> &'static str {
        match self {
            Plane::Horizontal => "horizontal",
            Plane::Vertical => "vertical",
        }
    }
}

/// The item of `all` that is spelled `word`; no case folding, no abbreviations.
fn find<T: Copy>(what: &'static str, all: &[T], spell: fn(T) -> &'static str, word: &str) -> Result<T, UnknownWord> {
    all.iter().copied().find(|item| spell(*item) == word).ok_or_else(|| UnknownWord {
        what,
        allowed: all.iter().map(|item| format!("{:?}", spell(*item))).collect::<Vec<_>>().join(", "),
        got: word.to_owned(),
    })
}

impl FromStr for Protocol {
    type Err = UnknownWord;
    fn from_str(word: &str) -> Result<Self, UnknownWord> {
        find("protocol", Protocol::ALL, Protocol::as_str, word)
    }
}

impl FromStr for Role {
    type Err = UnknownWord;
    fn from_str(word: &str) -> Result<Self, UnknownWord> {
        find("role", Role::ALL, Role::as_str, word)
    }
}

impl FromStr for Plane {
    type Err = UnknownWord;
    fn from_str(word: &str) -> Result<Self, UnknownWord> {
        find("plane", Plane::ALL, Plane::as_str, word)
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Display for Plane {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}
