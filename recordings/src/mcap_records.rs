//! The records of an MCAP file outside of chunks, one after another, with all its checksums.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use mcap::McapError;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::CampaignError;
use crate::chunk;
use crate::error::Place;

/// Bytes that are read from the file at a time, at least.
const READ_BYTES: usize = 256 * 1024;

pub(crate) const REMEDY: &str =
    "nothing of the file is used: copy it again, record the run again, or rescue what is sound with `bench recover`";

/// The file's records outside of chunks, one at a time; a chunk is one of them.
pub(crate) struct Records {
    file: File,
    reader: LinearReader,
}

/// Why there is no next record.
pub(crate) enum Broken {
    System(io::Error),
    Content(McapError),
}

impl Records {
    pub fn new(file: File) -> Self {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(chunk::LONGEST);
        Self { file, reader: LinearReader::new_with_options(options) }
    }

    /// Hands the next record's opcode and content to `take`; `None` at the end of a complete file.
    pub fn next<T>(&mut self, take: impl FnOnce(u8, &[u8]) -> T) -> Result<Option<T>, Broken> {
        loop {
            match self.reader.next_event() {
                None => return Ok(None),
                Some(Err(error)) => return Err(Broken::Content(error)),
                Some(Ok(LinearReadEvent::ReadRequest(bytes))) => {
                    let read = self.file.read(self.reader.insert(bytes.max(READ_BYTES))).map_err(Broken::System)?;
                    self.reader.notify_read(read);
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => return Ok(Some(take(opcode, data))),
            }
        }
    }
}

impl Broken {
    /// `samples` came before; `tick`: where the next one would stand.
    pub fn explain(self, path: &Path, samples: u64, tick: u64) -> CampaignError {
        let (expected, got) = match self {
            Broken::System(source) => return CampaignError::read(path, source),
            Broken::Content(McapError::UnexpectedEof) => {
                ("a complete MCAP recording", format!("one that is cut short after {samples} complete samples"))
            }
            Broken::Content(McapError::BadMagic) if samples == 0 => {
                ("an MCAP recording", "a file that does not start as one".to_owned())
            }
            Broken::Content(error) => {
                ("a sound MCAP recording", format!("one that is damaged after {samples} sound samples ({error})"))
            }
        };
        CampaignError::content(Place::file(path).tick(tick), expected, got, REMEDY)
    }
}
