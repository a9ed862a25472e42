//! A file that bears its name only once it is complete: it is written as `NAME.part` and renamed.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};

use crate::CampaignError;

/// The extension of a file that has not been closed.
pub(crate) const PART: &str = ".part";
/// The extension of a recording that is being rescued from a `.part`.
const RECOVERING: &str = ".recovering";

const BUFFER_BYTES: usize = 256 * 1024;

/// What to do where the file, or a part of it, exists already.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Existing {
    /// It can be made again: replace it, and leave nothing behind on failure.
    Replace,
    /// It is a measurement: never overwrite it, and keep the part on failure.
    Keep,
    /// It is rescued from a damaged measurement: never overwrite one, but the part can be made again.
    Rescue,
}

/// An open `NAME.part`.
///
/// What was flushed is sound: [`cut_back`](Self::cut_back) takes the file back to there. Whoever writes records flushes
/// between them only.
pub(crate) struct PartFile {
    writer: BufWriter<File>,
    part: PathBuf,
    target: PathBuf,
    existing: Existing,
    committed: bool,
    /// Everything that was handed in.
    all: Extent,
    /// What the system has taken.
    sound: Extent,
}

/// The first bytes of a file: how many, and their checksum.
#[derive(Clone, Debug, Default)]
struct Extent {
    bytes: u64,
    crc: crc32fast::Hasher,
}

/// `NAME.part` for `NAME`.
pub(crate) fn part_path(target: &Path) -> PathBuf {
    with_suffix(target, PART)
}

fn with_suffix(target: &Path, suffix: &str) -> PathBuf {
    let mut name = target.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

fn refuse_existing(target: &Path) -> io::Result<()> {
    // A dangling link counts, too.
    match target.symlink_metadata() {
        Ok(_) => Err(io::Error::new(io::ErrorKind::AlreadyExists, "a recording of this name exists")),
        Err(_) => Ok(()),
    }
}

fn rename_to_free(part: &Path, target: &Path) -> io::Result<()> {
    match renameat_with(CWD, part, CWD, target, RenameFlags::NOREPLACE) {
        Ok(()) => Ok(()),
        // A name that is taken, or a file system that does not know this kind of renaming.
        Err(_) => refuse_existing(target).and_then(|()| fs::rename(part, target)),
    }
}

fn folder_of(target: &Path) -> io::Result<File> {
    File::open(target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")))
}

impl PartFile {
    pub(crate) fn create(target: &Path, existing: Existing) -> Result<Self, CampaignError> {
        let part = if existing == Existing::Rescue { with_suffix(target, RECOVERING) } else { part_path(target) };
        if existing != Existing::Replace {
            refuse_existing(target).map_err(|there| CampaignError::write(target, there))?;
        }
        let mut options = OpenOptions::new();
        match existing {
            Existing::Replace | Existing::Rescue => options.write(true).create(true).truncate(true),
            Existing::Keep => options.write(true).create_new(true),
        };
        let file = options.open(&part).map_err(|source| CampaignError::write(&part, source))?;
        let writer = BufWriter::with_capacity(BUFFER_BYTES, file);
        let target = target.to_owned();
        let (all, sound) = Default::default();
        Ok(Self { writer, part, target, existing, committed: false, all, sound })
    }

    /// The name under which it is written.
    pub(crate) fn part(&self) -> &Path {
        &self.part
    }

    /// CRC-32 of everything that was handed in.
    pub(crate) fn crc32(&self) -> u32 {
        self.all.crc.clone().finalize()
    }

    /// Everything on the disk, then the final name. A measurement that came up under this name meanwhile is not overwritten.
    pub(crate) fn commit(mut self) -> Result<PathBuf, CampaignError> {
        let done =
            self.writer.flush().and_then(|()| self.writer.get_ref().sync_all()).and_then(|()| match self.existing {
                Existing::Replace => fs::rename(&self.part, &self.target),
                Existing::Keep | Existing::Rescue => rename_to_free(&self.part, &self.target),
            });
        done.map_err(|source| CampaignError::write(&self.target, source))?;
        self.committed = true;
        // Without it a power cut may take the new name back. The file is whole either way, and not every file system can do it.
        let _ = folder_of(&self.target).and_then(|folder| folder.sync_all());
        Ok(std::mem::take(&mut self.target))
    }

    /// After a failure: takes away what came after the last flush, and gives its room back.
    pub(crate) fn cut_back(&mut self) -> io::Result<()> {
        let file = self.writer.get_ref().try_clone()?;
        let failed = std::mem::replace(&mut self.writer, BufWriter::with_capacity(BUFFER_BYTES, file));
        // What it still holds must not reach the file when it is dropped.
        let (mut file, _unwritten) = failed.into_parts();
        self.all = self.sound.clone();
        file.set_len(self.sound.bytes)?;
        file.seek(SeekFrom::Start(self.sound.bytes)).map(drop)
    }

    /// Hands everything to the system without calling it sound.
    pub(crate) fn flush_unsound(&mut self) -> io::Result<()> {
        self.writer.flush()
    }

    /// Removes the file: it holds nothing of worth.
    pub(crate) fn discard(mut self) {
        self.existing = Existing::Replace;
    }
}

impl Write for PartFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = self.writer.write(bytes)?;
        self.all.crc.update(&bytes[..taken]);
        self.all.bytes += taken as u64;
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()?;
        self.sound = self.all.clone();
        Ok(())
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.committed && self.existing != Existing::Keep {
            // The error that led here is the one to report, not that of cleaning up.
            let _ = fs::remove_file(&self.part);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measurement_that_came_up_meanwhile_is_not_overwritten() {
        for (existing, left) in [(Existing::Keep, Some("a.mcap.part")), (Existing::Rescue, None)] {
            let dir = tempfile::tempdir().unwrap();
            let target = dir.path().join("a.mcap");
            let mut file = PartFile::create(&target, existing).unwrap();
            file.write_all(b"new").unwrap();
            fs::write(&target, "other").unwrap();
            let error = file.commit().expect_err("the name is taken");
            assert!(error.to_string().contains("a recording of this name exists"), "{error}");
            assert_eq!(fs::read_to_string(&target).unwrap(), "other");
            let names =
                fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
            let others: Vec<String> = names.filter(|name| name != "a.mcap").collect();
            assert_eq!(others.first().map(String::as_str), left, "{existing:?}: a measurement's part is kept");
        }
    }

    #[test]
    fn what_can_be_made_again_replaces_what_was_there() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.csv");
        fs::write(&target, "old").unwrap();
        let mut file = PartFile::create(&target, Existing::Replace).unwrap();
        file.write_all(b"new").unwrap();
        assert_eq!(file.commit().unwrap(), target);
        assert_eq!(fs::read_to_string(&target).unwrap(), "new");
    }
}
