//! A recording as columns, block by block.

use std::path::{Path, PathBuf};

use rt_core::{LossCertificate, Sample};

use crate::alignment::Alignment;
use crate::error::Place;
use crate::mcap_reader::Step;
use crate::recording::Whole;
use crate::run_metadata::RunMetadata;
use crate::{CampaignError, McapReader, Protocol, Recording};

/// Rows without any measured value that are held back at most, in case the run ends with them.
const HELD_ROWS: usize = 8192;

/// Reads an MCAP recording as columns, some thousand rows at a time: what [`Recording::read`] gives, in a stream. Memory does not
/// depend on the recording's length.
///
/// What comes before an error is sound, but whoever reads columns refuses the whole file: the last item tells whether it is whole.
pub struct Rows {
    path: PathBuf,
    protocol: Protocol,
    reader: McapReader,
    alignment: Alignment,
    whole: Whole,
    /// The newest rows as long as none of them holds a measured value.
    held: Recording,
    /// Rows that the whole run gives, once somebody had to look.
    keep: Option<usize>,
    /// The samples are at their end.
    ended: bool,
    done: bool,
}

impl Rows {
    /// Opens a recording (`.mcap`). Its own protocol decides which columns must hold a value.
    ///
    /// # Errors
    /// As [`McapReader::open`].
    pub fn open(path: &Path) -> Result<Rows, CampaignError> {
        let reader = McapReader::open(path)?;
        let protocol = reader.run().protocol;
        Ok(Rows {
            path: path.to_owned(),
            protocol,
            reader,
            alignment: Alignment::default(),
            whole: Whole::default(),
            held: Recording::default(),
            keep: None,
            ended: false,
            done: false,
        })
    }

    /// What the recording says about its run.
    pub fn run(&self) -> &RunMetadata {
        self.reader.run()
    }

    /// The loss certificate; `None` until the last block was given.
    pub fn certificate(&self) -> Option<&LossCertificate> {
        self.reader.certificate()
    }

    /// The next rows of the run, those included that its end may cost.
    fn block(&mut self) -> Result<Option<Recording>, CampaignError> {
        let mut sample = Sample::BLANK;
        while !self.ended {
            match self.reader.advance(&mut sample)? {
                Step::Sample => {
                    if let Some(block) = self.alignment.push(&sample) {
                        return Ok(Some(block));
                    }
                }
                Step::Other(_) => {}
                Step::End => {
                    self.ended = true;
                    self.check_lossless()?;
                }
            }
        }
        Ok(self.alignment.rest())
    }

    fn advance(&mut self) -> Result<Option<Recording>, CampaignError> {
        loop {
            let Some(mut block) = self.block()? else {
                // Where nothing was put back to its time, nothing is left over at the end either.
                let rest = if self.alignment.aged() { Recording::default() } else { std::mem::take(&mut self.held) };
                if rest.is_empty() {
                    self.whole.check(self.protocol, Place::file(&self.path))?;
                    return Ok(None);
                }
                return Ok(Some(rest));
            };
            if let Some(keep) = self.keep {
                let rows = block.len().min(keep.saturating_sub(self.whole.rows));
                block.split_off(rows);
                if block.is_empty() {
                    continue;
                }
                return Ok(Some(block));
            }
            let measured = measured_rows(&block);
            if measured > 0 {
                let tail = block.split_off(measured);
                let mut rows = std::mem::replace(&mut self.held, tail);
                rows.append(block);
                return Ok(Some(rows));
            }
            self.held.append(block);
            if self.held.len() > HELD_ROWS {
                let keep = kept_rows(&self.path);
                let mut rows = std::mem::take(&mut self.held);
                rows.split_off(rows.len().min(keep.saturating_sub(self.whole.rows)));
                self.keep = Some(keep);
                if !rows.is_empty() {
                    return Ok(Some(rows));
                }
            }
        }
    }

    fn check_lossless(&self) -> Result<(), CampaignError> {
        let Some(certificate) = self.reader.certificate().filter(|certificate| !certificate.is_lossless()) else {
            return Ok(());
        };
        let at = match certificate.gaps.first() {
            Some((first, _)) => Place::file(&self.path).tick(*first),
            None => Place::file(&self.path),
        };
        let remedy = "the command in a gap is unknown, so the run can't be simulated: record it again";
        Err(CampaignError::content(at, "a recording without loss", certificate.to_string(), remedy))
    }
}

impl Iterator for Rows {
    /// The next rows, at least one.
    type Item = Result<Recording, CampaignError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let block = self.advance();
        match &block {
            Ok(Some(rows)) => self.whole.count(rows, 0),
            Ok(None) | Err(_) => self.done = true,
        }
        block.transpose()
    }
}

/// Rows up to the last one that holds a measured value.
fn measured_rows(block: &Recording) -> usize {
    let columns = block.measured();
    (0..block.len())
        .rev()
        .find(|&row| columns.iter().any(|(_, values)| values[row].is_finite()))
        .map_or(0, |row| row + 1)
}

/// Rows that the run in this file gives. Where a run measures nothing for long, the rest of it is looked through for whether a value
/// still comes, instead of holding rows back without end.
fn kept_rows(path: &Path) -> usize {
    let Ok(mut reader) = McapReader::open(path) else { return usize::MAX };
    let (mut alignment, mut rows, mut measured) = (Alignment::default(), 0, 0);
    let mut count = |block: Recording| {
        if let found @ 1.. = measured_rows(&block) {
            measured = rows + found;
        }
        rows += block.len();
    };
    let mut sample = Sample::BLANK;
    loop {
        match reader.advance(&mut sample) {
            Ok(Step::Sample) => alignment.push(&sample).into_iter().for_each(&mut count),
            Ok(Step::Other(_)) => {}
            Ok(Step::End) => break,
            // Whoever reads the rows will come to it.
            Err(_) => return usize::MAX,
        }
    }
    while let Some(block) = alignment.rest() {
        count(block);
    }
    if alignment.aged() { measured } else { rows }
}
