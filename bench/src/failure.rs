//! What a command ends with when it does not succeed: one message, and an exit code by kind.

use std::error::Error;
use std::fmt;

/// Kinds of failure; the number is the process's exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A defect of the program itself.
    Internal = 1,
    /// Usage, configuration or input.
    Input = 2,
    /// Done, but the result was not accepted; or a dry run would trip.
    Acceptance = 3,
    /// A device or a link.
    Device = 4,
    /// The supervisor tripped.
    Safety = 5,
    /// A deadline was missed or samples were lost.
    Loss = 6,
    /// Interrupted by the user, after the outputs were zeroed.
    Interrupted = 130,
}

/// What the process's exit codes mean: help, manual pages and README.md say it in these words.
pub const EXIT_CODES: &[(u8, &str)] = &[
    (0, "done"),
    (Kind::Internal as u8, "internal error"),
    (Kind::Input as u8, "usage, configuration or bad input; the message names file, line and column"),
    (Kind::Acceptance as u8, "done, but the result was not accepted; or a dry run would trip: nothing moved"),
    (Kind::Device as u8, "a device or a link failed"),
    (Kind::Safety as u8, "the supervisor tripped: the rig is in its safe state"),
    (Kind::Loss as u8, "a deadline was missed or samples were lost"),
    (Kind::Interrupted as u8, "interrupted, after the outputs were zeroed"),
];

/// A failure of a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Decides the exit code.
    pub kind: Kind,
    /// What was expected, what came, where, and what to do.
    pub message: String,
}

impl Failure {
    /// A failure with a message of its own.
    pub fn new(kind: Kind, message: impl Into<String>) -> Self {
        Failure { kind, message: message.into() }
    }

    /// A failure out of a library's error; causes that its message does not already say are appended.
    pub fn of(kind: Kind, error: &dyn Error) -> Self {
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(error) = cause {
            let text = error.to_string();
            if !message.contains(&text) {
                message.push_str(": ");
                message.push_str(&text);
            }
            cause = error.source();
        }
        Failure { kind, message }
    }

    /// The process's exit code.
    pub fn exit_code(&self) -> u8 {
        self.kind as u8
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl Error for Failure {}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("run square_h could not be read")]
    struct Outer(#[source] Inner);

    #[derive(Debug, thiserror::Error)]
    #[error("square_h.csv, line 3: expected a number")]
    struct Inner;

    #[derive(Debug, thiserror::Error)]
    #[error("said already: {0}")]
    struct Saying(#[source] Inner);

    #[test]
    fn causes_are_said_once() {
        let failure = Failure::of(Kind::Input, &Outer(Inner));
        assert_eq!(failure.to_string(), "run square_h could not be read: square_h.csv, line 3: expected a number");
        let failure = Failure::of(Kind::Input, &Saying(Inner));
        assert_eq!(failure.to_string(), "said already: square_h.csv, line 3: expected a number");
    }

    #[test]
    fn exit_codes_are_those_of_the_readme() {
        let readme = include_str!("../../README.md");
        for (code, meaning) in EXIT_CODES {
            assert!(readme.contains(&format!("| {code} | {meaning} |")), "{code}, {meaning}, is not in README.md");
        }
        let all = [Kind::Internal, Kind::Input, Kind::Acceptance, Kind::Device, Kind::Safety, Kind::Loss];
        for kind in all.into_iter().chain([Kind::Interrupted]) {
            let code = Failure::new(kind, "").exit_code();
            assert!(EXIT_CODES.iter().any(|(listed, _)| *listed == code), "{kind:?} has no meaning");
        }
    }
}
