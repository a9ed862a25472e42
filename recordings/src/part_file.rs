//! A file that bears its name only once it is complete: it is written as `NAME.part` and renamed.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::CampaignError;

/// The extension of a file that has not been closed.
pub(crate) const PART: &str = ".part";

/// What to do where the file, or a part of it, exists already.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Existing {
    /// It can be made again: replace it, and leave nothing behind on failure.
    Replace,
    /// It is a measurement: never overwrite it, and keep the part on failure.
    Keep,
}

/// An open `NAME.part`.
pub(crate) struct PartFile {
    writer: BufWriter<File>,
    part: PathBuf,
    target: PathBuf,
    existing: Existing,
    committed: bool,
}

/// `NAME.part` for `NAME`.
pub(crate) fn part_path(target: &Path) -> PathBuf {
    let mut name = target.as_os_str().to_owned();
    name.push(PART);
    PathBuf::from(name)
}

impl PartFile {
    pub(crate) fn create(target: &Path, existing: Existing) -> Result<Self, CampaignError> {
        let part = part_path(target);
        let mut options = OpenOptions::new();
        match existing {
            Existing::Replace => options.write(true).create(true).truncate(true),
            Existing::Keep => {
                if target.exists() {
                    let there = io::Error::new(io::ErrorKind::AlreadyExists, "a recording of this name exists");
                    return Err(CampaignError::write(target, there));
                }
                options.write(true).create_new(true)
            }
        };
        let file = options.open(&part).map_err(|source| CampaignError::write(&part, source))?;
        let writer = BufWriter::with_capacity(256 * 1024, file);
        Ok(Self { writer, part, target: target.to_owned(), existing, committed: false })
    }

    /// The file's final name.
    pub(crate) fn target(&self) -> &Path {
        &self.target
    }

    /// Everything on the disk, then the final name.
    pub(crate) fn commit(mut self) -> Result<PathBuf, CampaignError> {
        let done = self
            .writer
            .flush()
            .and_then(|()| self.writer.get_ref().sync_all())
            .and_then(|()| fs::rename(&self.part, &self.target));
        done.map_err(|source| CampaignError::write(&self.target, source))?;
        self.committed = true;
        Ok(std::mem::take(&mut self.target))
    }
}

impl Write for PartFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for PartFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.writer.seek(to)
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.committed && self.existing == Existing::Replace {
            // The error that led here is the one to report, not that of cleaning up.
            let _ = fs::remove_file(&self.part);
        }
    }
}
