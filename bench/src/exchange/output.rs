//! A file that another program is to read: it bears its name only once it is complete, and replaces none that is there.

use crate::failure::{Failure, Kind};
use rustix::fs::{CWD, RenameFlags, renameat_with};
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const BUFFER_BYTES: usize = 1 << 18;

/// An open `NAME.part`. Dropped before [`commit`](Self::commit), it is removed: it can be made again.
pub struct Output {
    writer: BufWriter<File>,
    part: PathBuf,
    target: PathBuf,
    committed: bool,
}

impl Output {
    /// Begins `target`.
    ///
    /// # Errors
    /// A file of this name exists, or the system refuses (2).
    pub fn create(target: &Path) -> Result<Output, Failure> {
        refuse_existing(target)?;
        let part = with_suffix(target, ".part");
        let opened = OpenOptions::new().write(true).create(true).truncate(true).open(&part);
        let file = opened.map_err(|source| unwritten(&part, &source))?;
        let writer = BufWriter::with_capacity(BUFFER_BYTES, file);
        Ok(Output { writer, part, target: target.to_owned(), committed: false })
    }

    /// Where it will stand.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Everything on the disk, then the final name.
    ///
    /// # Errors
    /// A file of this name came up meanwhile, or the system refuses (2).
    pub fn commit(mut self) -> Result<PathBuf, Failure> {
        let flushed = self.writer.flush().and_then(|()| self.writer.get_ref().sync_all());
        flushed.map_err(|source| unwritten(&self.target, &source))?;
        match renameat_with(CWD, &self.part, CWD, &self.target, RenameFlags::NOREPLACE) {
            Ok(()) => {}
            Err(rustix::io::Errno::EXIST) => return Err(exists(&self.target)),
            // Not every file system knows this kind of renaming.
            Err(_) => {
                refuse_existing(&self.target)?;
                fs::rename(&self.part, &self.target).map_err(|source| unwritten(&self.target, &source))?;
            }
        }
        self.committed = true;
        Ok(self.target.clone())
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.writer.seek(to)
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if !self.committed {
            // The error that led here is the one to report, not that of cleaning up.
            let _ = fs::remove_file(&self.part);
        }
    }
}

/// # Errors
/// Something of this name is there already (2).
pub fn refuse_existing(target: &Path) -> Result<(), Failure> {
    // A dangling link counts, too.
    if target.symlink_metadata().is_ok() { Err(exists(target)) } else { Ok(()) }
}

fn exists(target: &Path) -> Failure {
    let message = format!(
        "{}: expected a name that is free, got one that exists; nothing is overwritten, choose another --out or remove it",
        target.display()
    );
    Failure::new(Kind::Input, message)
}

/// The system's refusal to write `path`.
pub fn unwritten(path: &Path, source: &io::Error) -> Failure {
    let message = format!(
        "{}: expected to write it, got \"{source}\"; check the folder, its permissions and the free space",
        path.display()
    );
    Failure::new(Kind::Input, message)
}

fn with_suffix(path: &Path, suffix: impl AsRef<OsStr>) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_given_at_the_end_and_never_taken_from_another() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let target = dir.path().join("a.csv");
        let mut output = Output::create(&target).expect("free");
        output.write_all(b"new").expect("writable");
        assert!(!target.exists());
        // Somebody was quicker.
        fs::write(&target, "other").expect("writable");
        let failure = output.commit().expect_err("taken");
        assert!(failure.exit_code() == 2 && failure.message.contains("nothing is overwritten"), "{failure}");
        assert_eq!(fs::read_to_string(&target).expect("there"), "other");
        assert_eq!(fs::read_dir(dir.path()).expect("there").count(), 1, "no part is left");
        assert!(Output::create(&target).is_err());
        let free = dir.path().join("b.csv");
        let mut output = Output::create(&free).expect("free");
        output.write_all(b"new").expect("writable");
        assert_eq!(output.commit().expect("written"), free);
        assert_eq!(fs::read_to_string(&free).expect("there"), "new");
    }
}
