//! A recording as columns, block by block.

use std::path::Path;

use crate::run_metadata::RunMetadata;
use crate::{CampaignError, McapReader, Recording, mcap_reader};

/// Rows of a block at most.
const BLOCK_ROWS: usize = 4096;

/// Reads an MCAP recording as columns, some thousand rows at a time: what [`Recording::read`] gives, in a stream.
///
/// What comes before an error is sound, but whoever reads columns refuses the whole file: the last item tells whether it is whole.
pub struct Rows {
    run: RunMetadata,
    all: Recording,
    given: usize,
}

impl Rows {
    /// Opens a recording (`.mcap`).
    ///
    /// # Errors
    /// As [`McapReader::open`].
    pub fn open(path: &Path) -> Result<Rows, CampaignError> {
        let run = McapReader::open(path)?.run().clone();
        let all = mcap_reader::read_recording(path, run.protocol, None)?;
        Ok(Rows { run, all, given: 0 })
    }

    /// What the recording says about its run.
    pub fn run(&self) -> &RunMetadata {
        &self.run
    }
}

impl Iterator for Rows {
    /// The next rows, at least one.
    type Item = Result<Recording, CampaignError>;

    fn next(&mut self) -> Option<Self::Item> {
        let range = self.given..self.all.len().min(self.given + BLOCK_ROWS);
        self.given = range.end;
        (!range.is_empty()).then(|| Ok(self.all.rows(range)))
    }
}
