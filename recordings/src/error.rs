//! What can be wrong with a campaign: where it is, what was expected, what came, and what to do.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// A place in a file, as exact as it is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub file: PathBuf,
    /// Line, counted from 1 (a CSV header is line 1).
    pub line: Option<u64>,
    /// Name of the CSV column, the TOML key or the MCAP field.
    pub column: Option<String>,
}

impl Place {
    /// The file as a whole.
    pub fn file(file: &Path) -> Self {
        Self {
            file: file.to_owned(),
            line: None,
            column: None,
        }
    }

    /// With a line, counted from 1.
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// With the name of a column or key.
    pub fn column(mut self, column: impl Into<String>) -> Self {
        self.column = Some(column.into());
        self
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, ", line {line}")?;
        }
        if let Some(column) = &self.column {
            write!(f, ", {column}")?;
        }
        Ok(())
    }
}

/// Why a campaign or one of its recordings could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The content is not what the format asks for: the user's input has to change.
    #[error("{at}: expected {expected}, got {got}; {remedy}")]
    Content {
        /// Where.
        at: Place,
        /// What the format asks for.
        expected: String,
        /// What is there.
        got: String,
        /// What to do.
        remedy: String,
    },
    /// The operating system refused to read.
    #[error("{}: can't be read: {source}; check that it exists and that its permissions allow reading", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The operating system refused to write.
    #[error("{}: can't be written: {source}; check the folder, its permissions and the free space", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

impl CampaignError {
    pub(crate) fn content(
        at: Place,
        expected: impl Into<String>,
        got: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Content {
            at,
            expected: expected.into(),
            got: got.into(),
            remedy: remedy.into(),
        }
    }

    pub(crate) fn read(file: &Path, source: io::Error) -> Self {
        Self::Read {
            file: file.to_owned(),
            source,
        }
    }

    pub(crate) fn write(file: &Path, source: io::Error) -> Self {
        Self::Write {
            file: file.to_owned(),
            source,
        }
    }
}
