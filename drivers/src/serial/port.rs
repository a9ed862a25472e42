//! Opening the port, and what may be wrong with it.

use super::LinkError;
use std::fs;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use tokio_serial::{ClearBuffer, ErrorKind, SerialPort, SerialStream};

/// Where udev names ports after their adapters.
const BY_ID: &str = "/dev/serial/by-id";
/// Kinds of ports without a name there.
const OTHERS: [&str; 4] = ["ttyUSB", "ttyACM", "ttyAMA", "ttymxc"];
/// A port may miss the rate by so much: a UART tolerates some percent between both ends.
const TOLERANCE: f64 = 0.02;

/// Opens a port: 8N1, raw, no flow control, exclusively, what was in its buffers forgotten. Called in a runtime.
pub(super) fn open(port: &Path, baud: u32) -> Result<SerialStream, LinkError> {
    let refused = |got: String| LinkError::Baud { port: port.to_owned(), asked: baud, got };
    if baud == 0 {
        // To a terminal, rate 0 is to hang up.
        return Err(refused("0 is no rate".into()));
    }
    let Some(name) = port.to_str() else {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "its name is not UTF-8");
        return Err(LinkError::Port { port: port.to_owned(), doing: "opening it", source });
    };
    let stream = SerialStream::open(&tokio_serial::new(name, baud)).map_err(|e| explain(port, e))?;
    // What the driver can't do it silently replaces by what it can.
    match stream.baud_rate() {
        Ok(got) if (f64::from(got) - f64::from(baud)).abs() <= TOLERANCE * f64::from(baud) => {}
        Ok(got) => return Err(refused(format!("its driver set {got}"))),
        Err(e) => return Err(refused(format!("its driver says: {e}"))),
    }
    let failed = |doing, source| LinkError::Port { port: port.to_owned(), doing, source };
    stream.clear(ClearBuffer::All).map_err(|e| failed("emptying its buffers", e.into()))?;
    if fs::canonicalize(port).is_ok_and(|to| to.starts_with("/dev/pts")) {
        // A pty lives on without us, and so would the mark of exclusive use if we were killed. The lock remains, and goes with us.
        // SAFETY: the descriptor is open for as long as `stream` is, which outlives the borrow.
        let open = unsafe { BorrowedFd::borrow_raw(stream.as_raw_fd()) };
        rustix::termios::ioctl_tiocnxcl(open).map_err(|e| failed("unmarking it", e.into()))?;
    }
    Ok(stream)
}

/// tokio-serial tells some causes apart; the others are looked for.
fn explain(port: &Path, e: tokio_serial::Error) -> LinkError {
    let port = port.to_owned();
    match e.kind() {
        ErrorKind::NoDevice => LinkError::Busy { port },
        ErrorKind::Io(io::ErrorKind::NotFound) => LinkError::NoSuchPort { port, there: there() },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => LinkError::Permission { port },
        _ => match fs::metadata(&port) {
            Ok(found) if !is_terminal(&port, &found) => {
                LinkError::NotATty { got: kind(&found).into(), port, there: there() }
            }
            _ => LinkError::Port { port, doing: "opening it", source: e.into() },
        },
    }
}

/// Opened without waiting and without changing anything; a port that can't be opened counts as one.
fn is_terminal(port: &Path, found: &fs::Metadata) -> bool {
    use rustix::fs::{Mode, OFlags, open};
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    found.file_type().is_char_device()
        && open(port, flags, Mode::empty()).is_ok_and(|file| {
            // A port whose hardware is missing answers EIO, not ENOTTY.
            !matches!(rustix::termios::tcgetattr(&file), Err(rustix::io::Errno::NOTTY | rustix::io::Errno::INVAL))
        })
}

fn kind(found: &fs::Metadata) -> &'static str {
    let kind = found.file_type();
    match () {
        () if kind.is_dir() => "a folder",
        () if kind.is_file() => "a file",
        () if kind.is_fifo() => "a named pipe",
        () if kind.is_socket() => "a socket",
        () if kind.is_block_device() => "a disk",
        () => "another kind of device",
    }
}

/// The ports that there are, for messages: names that stay first.
fn there() -> String {
    let by_id = names(Path::new(BY_ID), |_| true);
    let mut ports = by_id.clone();
    let named: Vec<PathBuf> = by_id.iter().filter_map(|link| fs::canonicalize(link).ok()).collect();
    let other = |name: &str| OTHERS.iter().any(|kind| name.starts_with(kind));
    ports.extend(names(Path::new("/dev"), other).into_iter().filter(|port| !named.contains(port)));
    if ports.is_empty() {
        return "there are no USB serial ports on this machine".into();
    }
    let list: Vec<String> = ports.iter().map(|port| port.display().to_string()).collect();
    format!("there are {}", list.join(", "))
}

fn names(folder: &Path, wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let wanted = |entry: &fs::DirEntry| entry.file_name().to_str().is_some_and(&wanted);
    let mut names: Vec<PathBuf> = entries.filter(wanted).map(|entry| entry.path()).collect();
    names.sort();
    names
}
