//! What people at the rig are asked for, where the rig does not do it itself.

use rt_core::Amount;

/// Who does the operator's part: clamps, leads, fills, releases, reads the cylinder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hands {
    /// The rig itself: an emulated one, or one with an automatic fixture. Nothing is asked.
    #[default]
    Rig,
    /// People: the run asks, and waits until they confirm.
    People,
}

impl Hands {
    /// As written in a recording.
    pub fn as_str(self) -> &'static str {
        match self {
            Hands::Rig => "rig",
            Hands::People => "people",
        }
    }
}

/// What people are asked for at a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// The step at which it is asked, as in the samples: counted through the unrolled loops from 0.
    pub step: u32,
    /// Line of the step in the script.
    pub line: usize,
    /// What is to be done, in plain words.
    pub text: String,
    /// The number that the confirmation must bring.
    pub amount: Option<Amount>,
}
