//! What can be wrong with a campaign: where it is, what was expected, what came, and what to do.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use rt_core::LossCertificate;

/// A place in a file, as exact as it is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub file: PathBuf,
    /// Where in the file.
    pub spot: Spot,
    /// Name of the CSV column, the TOML key or the MCAP field.
    pub column: Option<String>,
}

/// Where in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spot {
    /// The file as a whole.
    Whole,
    /// Line of a text file, counted from 1 (a CSV header is line 1).
    Line(u64),
    /// Tick of an MCAP recording, counted from 0.
    Tick(u64),
}

impl Place {
    pub(crate) fn file(file: &Path) -> Self {
        Self { file: file.to_owned(), spot: Spot::Whole, column: None }
    }

    pub(crate) fn line(mut self, line: u64) -> Self {
        self.spot = Spot::Line(line);
        self
    }

    pub(crate) fn tick(mut self, tick: u64) -> Self {
        self.spot = Spot::Tick(tick);
        self
    }

    pub(crate) fn column(mut self, column: impl Into<String>) -> Self {
        self.column = Some(column.into());
        self
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        match self.spot {
            Spot::Whole => {}
            Spot::Line(line) => write!(f, ", line {line}")?,
            Spot::Tick(tick) => write!(f, ", tick {tick}")?,
        }
        if let Some(column) = &self.column {
            write!(f, ", {column}")?;
        }
        Ok(())
    }
}

/// Content that is not what the format asks for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{at}: expected {expected}, got {got}; {remedy}")]
pub struct Mismatch {
    /// Where.
    pub at: Place,
    /// What the format asks for.
    pub expected: String,
    /// What is there.
    pub got: String,
    /// What to do.
    pub remedy: String,
}

/// Why a campaign or one of its recordings could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The content is not what the format asks for: the input has to change.
    #[error(transparent)]
    Content(Box<Mismatch>),
    /// The operating system refused to read.
    #[error("{}: expected a readable file, got \"{source}\"; check the path and the permissions", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The operating system refused to write on: the recording was cut short.
    #[error(transparent)]
    CutShort(#[from] CutShort),
    /// The operating system refused to write.
    #[error("{}: expected to write it, got \"{source}\"; check the folder, its permissions and the free space", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

/// A recording that the operating system refused to write on, as when the disk runs full. Its complete chunks are kept.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{}: expected to write it on, got \"{system}\"; it keeps its first {} samples (up to {end_s:.1} s) and {}; make room \
     on that disk, then record the run again",
    file.display(),
    certificate.received,
    if *closed { "is closed: readable, certified as incomplete" } else { "could not be closed: `bench recover` reads it" }
)]
pub struct CutShort {
    /// The file: under its own name if it could be closed, otherwise the `.part`.
    pub file: PathBuf,
    /// The system's reason.
    pub system: String,
    /// What the file certifies, or would if it had been closed.
    pub certificate: LossCertificate,
    /// Scheduled time of the last sample that it keeps, s.
    pub end_s: f64,
    /// It was closed, with a certificate that says what it lacks.
    pub closed: bool,
}

impl CutShort {
    /// What is kept of a run that turned out to have `expected` samples.
    pub fn of_run(&self, expected: u64) -> LossCertificate {
        let mut certificate = self.certificate.clone();
        if expected > certificate.expected {
            certificate.gaps.push((certificate.expected, expected - 1));
            certificate.expected = expected;
        }
        LossCertificate { end_seen: true, ..certificate }
    }
}

impl CampaignError {
    pub(crate) fn content(
        at: Place,
        expected: impl Into<String>,
        got: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let (expected, got, remedy) = (expected.into(), got.into(), remedy.into());
        Self::Content(Box::new(Mismatch { at, expected, got, remedy }))
    }

    pub(crate) fn read(file: &Path, source: io::Error) -> Self {
        Self::Read { file: file.to_owned(), source }
    }

    pub(crate) fn write(file: &Path, source: io::Error) -> Self {
        Self::Write { file: file.to_owned(), source }
    }
}

/// What came, quoted for a message and cut to a length that a person still reads.
pub(crate) fn quoted(text: &[u8]) -> String {
    const MOST: usize = 160;
    let text = String::from_utf8_lossy(text);
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{:?}...", &text[..end]),
        None => format!("{text:?}"),
    }
}
