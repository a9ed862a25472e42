//! What the checks look at: files below a root, and the facts that are in none.

use rt_core::system::{Report, Request, prepare_process, prepare_thread};
use rt_core::transport::{self, Foreign};
use rustix::fs::{Access, access, statvfs};
use rustix::time::{ClockId, clock_getres};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Longest file that is read, bytes: /proc/cpuinfo of a machine with hundreds of CPUs, an unpacked kernel configuration.
const MAX_BYTES: u64 = 4 << 20;

/// The directory below which /proc, /sys, /dev and /boot are: `/`, or a copy of another machine's.
#[derive(Clone, Debug)]
pub struct Root(PathBuf);

impl Root {
    /// A root; `Root::new("/")` is this machine.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Root(path.into())
    }

    /// Where an absolute path of the examined machine is on this one.
    pub(super) fn at(&self, path: impl AsRef<Path>) -> PathBuf {
        let path = path.as_ref();
        self.0.join(path.strip_prefix("/").unwrap_or(path))
    }

    /// Text of a file, without white space (or a device tree's NUL) at its ends; `None` when it is not there, not readable or no text.
    pub(super) fn text(&self, path: impl AsRef<Path>) -> Option<String> {
        let mut text = String::new();
        File::open(self.at(path)).ok()?.take(MAX_BYTES).read_to_string(&mut text).ok()?;
        Some(text.trim_matches(|c: char| c.is_whitespace() || c == '\0').to_owned())
    }

    /// A file that holds one number.
    pub(super) fn number(&self, path: impl AsRef<Path>) -> Option<i64> {
        self.text(path)?.parse().ok()
    }

    /// Text of a gzip file.
    pub(super) fn unpacked(&self, path: impl AsRef<Path>) -> Option<String> {
        let mut text = String::new();
        flate2::read::GzDecoder::new(File::open(self.at(path)).ok()?).take(MAX_BYTES).read_to_string(&mut text).ok()?;
        Some(text)
    }

    /// Names in a directory, sorted; none when it is not there.
    pub(super) fn names(&self, directory: impl AsRef<Path>) -> Vec<String> {
        let entries = fs::read_dir(self.at(directory)).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    /// Opens a file for reading and writing and closes it again.
    pub(super) fn opens(&self, path: impl AsRef<Path>) -> io::Result<()> {
        OpenOptions::new().read(true).write(true).open(self.at(path)).map(drop)
    }
}

/// What the user wants to know about in particular.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    /// Serial ports, as paths.
    pub serial: Vec<PathBuf>,
    /// CAN interfaces, by name.
    pub can: Vec<String>,
    /// Directory for the recordings; need not exist yet.
    pub directory: PathBuf,
}

/// Room in a file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space {
    /// Free for this user, bytes.
    pub free_bytes: u64,
    /// This user may create files there.
    pub writable: bool,
}

/// All that the checks judge.
#[derive(Debug)]
pub struct Surroundings {
    /// Where the files are.
    pub root: Root,
    /// What the user asked about.
    pub asked: Asked,
    /// Smallest step of a timer, ns (`clock_getres`).
    pub timer_resolution_ns: u64,
    /// Where the recordings go, or why that can't be told.
    pub disk: Result<Space, String>,
    /// /dev/shm, or why that can't be told.
    pub shared_memory: Result<Space, String>,
    /// The folder of the shared memory's services where another user made it, so that this one may not use it.
    pub foreign: Option<Foreign>,
    /// Output of `ip -details -json link show`; `None` where there is no `ip`.
    pub ip_links: Option<String>,
    /// What the system granted when it was asked, as the loop will ask.
    pub trial: Report,
}

impl Surroundings {
    /// Those of this process on this machine. Asks for real time in a thread of its own, and gives it back.
    pub fn here(asked: Asked) -> Self {
        let resolution = clock_getres(ClockId::Monotonic);
        Surroundings {
            root: Root::new("/"),
            timer_resolution_ns: resolution.tv_sec as u64 * 1_000_000_000 + resolution.tv_nsec as u64,
            disk: space_of(&asked.directory),
            shared_memory: space_of(Path::new("/dev/shm")),
            foreign: transport::foreign(),
            ip_links: ip_links(),
            trial: trial(),
            asked,
        }
    }
}

/// Room where `directory` is, or where its nearest parent is that exists.
fn space_of(directory: &Path) -> Result<Space, String> {
    // An empty path is the current directory, which a relative one ends in.
    let absolute = std::path::absolute(directory).map_err(|e| format!("{}: {e}", directory.display()))?;
    let there = absolute.ancestors().find(|path| path.is_dir()).unwrap_or(Path::new("/"));
    let system = statvfs(there).map_err(|e| format!("{}: {}", there.display(), io::Error::from(e)))?;
    let free_bytes = system.f_bavail.saturating_mul(system.f_frsize);
    Ok(Space { free_bytes, writable: access(there, Access::WRITE_OK | Access::EXEC_OK).is_ok() })
}

fn ip_links() -> Option<String> {
    let output = Command::new("ip").args(["-details", "-json", "link", "show"]).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

fn trial() -> Report {
    let request = Request::default();
    let (_held, process) = prepare_process(&request);
    // A thread of its own: this one shall not keep the priority.
    let thread = std::thread::spawn(move || prepare_thread(&request)).join().unwrap_or_default();
    Report::new(process.grants().iter().cloned().chain(thread).collect())
}
