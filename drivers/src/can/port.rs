//! One end of a bus, for one task: frames out and in.

use super::socket::SocketCan;
use super::unix::Unix;
use super::{CanError, ErrorFrame, Frame, FrameId, Interface, TimedFrame};
use std::io;
use std::time::Duration;

/// Waiting for room where the system does not say when there is some.
const ROOM_AGAIN: Duration = Duration::from_millis(1);

/// Which end of a Unix socket; both ends of a real bus are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The bench: somebody must be there.
    Connects,
    /// The emulated rig: makes the socket, takes one peer, and the next one when it has gone.
    Binds,
}

/// Which frames are received.
#[derive(Clone, Copy, Debug)]
pub enum Wanted<'a> {
    /// All.
    All,
    /// Those with exactly these identifiers; the kernel drops all others.
    Only(&'a [FrameId]),
}

/// What was received.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// A data frame.
    Frame(TimedFrame),
    /// The controller tells of the bus.
    Error(ErrorFrame),
}

/// One end of a bus.
pub enum Port {
    /// An interface of the system.
    SocketCan(SocketCan),
    /// A Unix socket in place of a bus.
    Unix(Unix),
}

impl Port {
    /// Opens it; in a tokio runtime with I/O and time.
    ///
    /// # Errors
    /// Each kind of [`CanError`] but that of a name.
    pub fn open(interface: &Interface, wanted: Wanted<'_>, end: End) -> Result<Port, CanError> {
        match interface {
            Interface::SocketCan(name) => SocketCan::open(name, wanted).map(Port::SocketCan),
            Interface::Unix(path) => Unix::open(path, wanted, end).map(Port::Unix),
        }
    }

    /// The next frame. Cancel safe: what was not returned comes the next time.
    ///
    /// # Errors
    /// The interface went down or is gone, or the peer of an end that connects has gone: to be opened anew after a while.
    pub async fn receive(&self) -> io::Result<Heard> {
        match self {
            Port::SocketCan(port) => port.receive().await,
            Port::Unix(port) => port.receive().await,
        }
    }

    /// Sends a frame if there is room now. An end that binds and has no peer sends it to nobody.
    ///
    /// # Errors
    /// [`is_full`] tells that there is no room; otherwise as [`receive`](Self::receive).
    pub fn try_send(&self, frame: &Frame) -> io::Result<()> {
        match self {
            Port::SocketCan(port) => port.try_send(frame),
            Port::Unix(port) => port.try_send(frame),
        }
    }

    /// Waits until there may be room, after `full` was the error of [`try_send`](Self::try_send).
    ///
    /// # Errors
    /// As [`receive`](Self::receive).
    pub async fn room(&self, full: &io::Error) -> io::Result<()> {
        // A full queue of the interface (ENOBUFS), unlike a full socket, is not told when it empties.
        if full.kind() != io::ErrorKind::WouldBlock {
            tokio::time::sleep(ROOM_AGAIN).await;
            return Ok(());
        }
        match self {
            Port::SocketCan(port) => port.room().await,
            Port::Unix(port) => port.room().await,
        }
    }

    /// Sends a frame, and waits for room as long as it takes. Cancel safe: then it was not sent.
    ///
    /// # Errors
    /// As [`receive`](Self::receive).
    pub async fn send(&self, frame: &Frame) -> io::Result<()> {
        loop {
            match self.try_send(frame) {
                Err(full) if is_full(&full) => self.room(&full).await?,
                done => return done,
            }
        }
    }

    /// Frames that the system dropped since the port was opened, because this end did not read; it wraps. A Unix socket drops none: its sender waits.
    pub(super) fn dropped(&self) -> u32 {
        match self {
            Port::SocketCan(port) => port.dropped(),
            Port::Unix(_) => 0,
        }
    }

    /// What the system says about the controller; nothing where there is none.
    pub(super) fn controller(&self) -> Option<Controller> {
        match self {
            Port::SocketCan(port) => port.controller(),
            Port::Unix(_) => None,
        }
    }
}

/// The controller of an interface as the system knows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Controller {
    pub(super) condition: super::Condition,
    pub(super) error_counters: Option<(u8, u8)>,
    /// After a bus-off the system restarts it so long after, ms; 0: never.
    pub(super) restart_ms: u32,
}

/// Whether a frame was not sent because there was no room: in the socket, or in the interface's queue.
pub fn is_full(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::WouldBlock || error.raw_os_error() == Some(libc::ENOBUFS)
}
