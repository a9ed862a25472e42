//! A serial port of our own making: a pseudo-terminal pair, whose master end is an emulated amplifier's.

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, ioctl_tiocgptpeer, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::ffi::OsStr;
use std::fs::{read_link, remove_file};
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Where the system puts pseudo-terminals.
const SLAVES: &str = "/dev/pts";

/// The master end of a pty pair; whoever opens [`Pty::slave`] has a serial port. Raw: nothing echoes, no byte is special.
///
/// Reads and writes never wait. Bytes pass through a worker of the kernel: who spins on them at a real-time priority may keep that worker
/// from running.
///
/// The slave end is held open here too. So the master end is quiet, and not at its end, while nobody has the port open; bytes stay
/// for the next who opens it, as many as the kernel has room for (some kilobytes each way).
/// Dropped, the port is gone for who has it open, as an adapter that is pulled out.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    _held_open: OwnedFd,
    slave: PathBuf,
    link: Option<PathBuf>,
}

impl Pty {
    /// Makes a pair; with `link` a symbolic link to the slave end, so that its name is known beforehand. A link there that leads
    /// to a pseudo-terminal that is gone is replaced; anything else there is an error. The link is removed on drop.
    ///
    /// # Errors
    /// No pseudo-terminal to be had, or the link can't be made; the message says what to do.
    pub fn open(link: Option<&Path>) -> io::Result<Pty> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).map_err(|e| {
            explained(e.into(), "a pseudo-terminal (/dev/ptmx); is devpts mounted, are there too many?")
        })?;
        unlockpt(&master)?;
        let slave = PathBuf::from(OsStr::from_bytes(ptsname(&master, Vec::new())?.as_bytes()));
        let held_open = ioctl_tiocgptpeer(&master, OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        let mut termios = tcgetattr(&held_open)?;
        termios.make_raw();
        // No speed: so a speed that somebody sets can be told from the system's default.
        termios.set_speed(0)?;
        tcsetattr(&held_open, OptionalActions::Now, &termios)?;
        fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
        if let Some(link) = link {
            point(link, &slave)?;
        }
        Ok(Pty { master, _held_open: held_open, slave, link: link.map(Path::to_owned) })
    }

    /// The port to open: `/dev/pts/N`.
    pub fn slave(&self) -> &Path {
        &self.slave
    }

    /// The port's name for others: the link if there is one, else [`Pty::slave`].
    pub fn path(&self) -> &Path {
        self.link.as_deref().unwrap_or(&self.slave)
    }

    /// Bits a second that the other side has set; `None` before anybody did. A pty carries bytes at any speed: who emulates a UART
    /// has to garble them where the speeds differ.
    pub fn speed_baud(&self) -> Option<u32> {
        tcgetattr(&self.master).ok().map(|termios| termios.output_speed()).filter(|&baud| baud > 0)
    }

    /// Reads what is there.
    ///
    /// # Errors
    /// [`ErrorKind::WouldBlock`] where nothing is.
    pub fn try_read(&self, bytes: &mut [u8]) -> io::Result<usize> {
        Ok(rustix::io::retry_on_intr(|| rustix::io::read(&self.master, &mut *bytes))?)
    }

    /// Writes as many bytes as there is room for. A UART has nowhere to keep what finds no room: it is lost.
    ///
    /// # Errors
    /// [`ErrorKind::WouldBlock`] where there is no room.
    pub fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        Ok(rustix::io::retry_on_intr(|| rustix::io::write(&self.master, bytes))?)
    }

    /// The same for a tokio runtime.
    ///
    /// # Errors
    /// The runtime can't watch it.
    ///
    /// # Panics
    /// Outside of a runtime with I/O.
    pub fn into_async(self) -> io::Result<AsyncPty> {
        // SAFETY: `as_raw_fd` is the master end's, which stays open and the same for as long as the pty is owned.
        Ok(AsyncPty { pty: unsafe { AsyncFd::register(self) }? })
    }
}

impl AsRawFd for Pty {
    fn as_raw_fd(&self) -> RawFd {
        self.master.as_raw_fd()
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // Somebody else's link by now stays.
        if let Some(link) = self.link.take().filter(|link| read_link(link).is_ok_and(|to| to == self.slave)) {
            // What can't be removed dangles, and is replaced by the next.
            let _ = remove_file(link);
        }
    }
}

/// Makes `link` point to `slave`.
fn point(link: &Path, slave: &Path) -> io::Result<()> {
    let hint = |e| explained(e, &format!("the link {} to a pseudo-terminal", link.display()));
    match symlink(slave, link) {
        Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
        made => return made.map_err(hint),
    }
    let ours = read_link(link).is_ok_and(|to| to.starts_with(SLAVES) && !to.exists());
    if !ours {
        let text = format!(
            "{}: expected a name that is free, or a link to a pseudo-terminal that is gone; is it in use? Remove it, or take another",
            link.display()
        );
        return Err(io::Error::new(ErrorKind::AlreadyExists, text));
    }
    remove_file(link).and_then(|()| symlink(slave, link)).map_err(hint)
}

fn explained(e: io::Error, expected: &str) -> io::Error {
    io::Error::new(e.kind(), format!("expected {expected}: {e}"))
}

/// [`Pty`] on a tokio runtime.
#[derive(Debug)]
pub struct AsyncPty {
    pty: AsyncFd<Pty>,
}

impl AsyncPty {
    /// The pty itself.
    pub fn pty(&self) -> &Pty {
        self.pty.get_ref()
    }
}

impl AsyncRead for AsyncPty {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        loop {
            let mut guard = ready!(self.pty.poll_read_ready(cx))?;
            match guard.try_io(|pty| pty.get_ref().try_read(buf.initialize_unfilled())) {
                Ok(read) => return Poll::Ready(read.map(|bytes| buf.advance(bytes))),
                Err(_would_block) => {}
            }
        }
    }
}

impl AsyncWrite for AsyncPty {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        loop {
            let mut guard = ready!(self.pty.poll_write_ready(cx))?;
            match guard.try_io(|pty| pty.get_ref().try_write(bytes)) {
                Ok(written) => return Poll::Ready(written),
                Err(_would_block) => {}
            }
        }
    }

    /// Written is written: the kernel passes it on.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test")]

    use super::*;
    use std::fs::{self, File, OpenOptions};
    use std::io::{Read, Write};
    use std::time::{Duration, Instant};

    fn port(path: &Path) -> File {
        OpenOptions::new().read(true).write(true).open(path).unwrap()
    }

    /// Bytes that the master end gets, waiting for them.
    fn got(pty: &Pty, count: usize) -> Vec<u8> {
        let (start, mut all, mut bytes) = (Instant::now(), vec![], [0; 64]);
        while all.len() < count {
            assert!(start.elapsed() < Duration::from_secs(30), "{} of {count} bytes", all.len());
            match pty.try_read(&mut bytes) {
                Ok(read) => all.extend_from_slice(&bytes[..read]),
                Err(e) => assert_eq!(e.kind(), ErrorKind::WouldBlock),
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        all
    }

    #[test]
    fn every_byte_passes_both_ways_and_none_echoes() {
        let pty = Pty::open(None).unwrap();
        let every: Vec<u8> = (0..=255).collect();
        let mut port = port(pty.slave());
        port.write_all(&every).unwrap();
        assert_eq!(got(&pty, 256), every);
        assert_eq!(pty.try_write(&every).unwrap(), 256);
        let mut back = [0; 256];
        port.read_exact(&mut back).unwrap();
        assert_eq!(back.to_vec(), every);
        assert_eq!(pty.try_read(&mut back).unwrap_err().kind(), ErrorKind::WouldBlock, "an echo");
    }

    #[test]
    fn it_is_quiet_before_and_between_those_who_open_it() {
        let pty = Pty::open(None).unwrap();
        for _ in 0..3 {
            assert_eq!(pty.try_read(&mut [0]).unwrap_err().kind(), ErrorKind::WouldBlock);
            port(pty.slave()).write_all(&[7]).unwrap();
            assert_eq!(got(&pty, 1), [7]);
        }
    }

    #[test]
    fn the_speed_is_what_the_other_side_set() {
        let pty = Pty::open(None).unwrap();
        assert_eq!(pty.speed_baud(), None);
        let port = port(pty.slave());
        for baud in [9_600, 460_800, 3_000_000] {
            let mut termios = tcgetattr(&port).unwrap();
            termios.set_speed(baud).unwrap();
            tcsetattr(&port, OptionalActions::Now, &termios).unwrap();
            assert_eq!(pty.speed_baud(), Some(baud));
        }
    }

    #[test]
    fn a_link_is_made_replaced_and_removed_only_if_it_is_ours() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("amplifier");
        let pty = Pty::open(Some(&link)).unwrap();
        assert_eq!((read_link(&link).unwrap(), pty.path()), (pty.slave().to_owned(), &*link));
        let second = Pty::open(Some(&link)).unwrap_err();
        assert!(second.to_string().contains("is it in use?"), "{second}");
        drop(pty);
        assert!(read_link(&link).is_err(), "it was removed");

        // What was left behind by a program that was killed.
        symlink("/dev/pts/99999999", &link).unwrap();
        let pty = Pty::open(Some(&link)).unwrap();
        assert_eq!(read_link(&link).unwrap(), pty.slave());
        remove_file(&link).unwrap();
        symlink("/nowhere", &link).unwrap();
        drop(pty);
        assert_eq!(read_link(&link).unwrap(), Path::new("/nowhere"), "somebody else's stays");
        assert_eq!(Pty::open(Some(&link)).unwrap_err().kind(), ErrorKind::AlreadyExists);

        let file = folder.path().join("file");
        fs::write(&file, "precious").unwrap();
        assert_eq!(Pty::open(Some(&file)).unwrap_err().kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
    }

    #[test]
    fn on_a_runtime_it_waits_for_bytes_and_for_room() {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let pty = Pty::open(None).unwrap();
            let mut port = port(pty.slave());
            let mut pty = pty.into_async().unwrap();
            // More than the kernel has room for, so that both ends wait for each other.
            let sent: Vec<u8> = (0..100_000u32).map(|n| (n % 251) as u8).collect();
            let there = sent.clone();
            let other = std::thread::spawn(move || {
                port.write_all(&there).unwrap();
                let mut back = vec![0; there.len()];
                port.read_exact(&mut back).unwrap();
                back
            });
            let mut got = vec![0; sent.len()];
            pty.read_exact(&mut got).await.unwrap();
            pty.write_all(&got).await.unwrap();
            assert_eq!(other.join().unwrap(), sent);
        });
    }
}
