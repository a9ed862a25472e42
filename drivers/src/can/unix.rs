//! A Unix socket in place of a bus: `SOCK_SEQPACKET`, a `struct can_frame` a packet. A frame's time is that of its reception.

use super::arrival::monotonic_ns;
use super::poll::{self, polled};
use super::port::{End, Heard, Wanted};
use super::wire::{self, Content};
use super::{CanError, Frame, FrameId, Interface, TimedFrame};
use rustix::io::Errno;
use rustix::net::{AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, sockopt};
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// Asked for; the kernel doubles it: some forty frames. What waits for a peer that does not read grows stale.
const SEND_BUFFER: usize = 16 << 10;

type Peer = Arc<AsyncFd<OwnedFd>>;

/// One end.
pub struct Unix {
    /// None where an end that binds waits for one.
    peer: Mutex<Option<Peer>>,
    listener: Option<Listener>,
    /// In order; all where there is none.
    wanted: Option<Vec<FrameId>>,
}

/// The end that binds; its socket's file goes with it.
struct Listener {
    socket: AsyncFd<OwnedFd>,
    path: PathBuf,
}

impl Drop for Listener {
    fn drop(&mut self) {
        // Gone already: then somebody has cleaned up.
        let _ = std::fs::remove_file(&self.path);
    }
}

impl Unix {
    pub(super) fn open(path: &Path, wanted: Wanted<'_>, end: End) -> Result<Unix, CanError> {
        let wanted = match wanted {
            Wanted::All => None,
            Wanted::Only(ids) => {
                let mut ids = ids.to_vec();
                ids.sort();
                Some(ids)
            }
        };
        let (peer, listener) = match end {
            End::Connects => (Some(connect(path)?), None),
            End::Binds => (None, Some(bind(path)?)),
        };
        Ok(Unix { peer: Mutex::new(peer), listener, wanted })
    }

    pub(super) async fn receive(&self) -> io::Result<Heard> {
        loop {
            let bytes = match (&self.listener, self.peer()) {
                (None, Some(peer)) => match packet(&peer).await? {
                    Some(bytes) => bytes,
                    None => return Err(io::Error::new(io::ErrorKind::ConnectionReset, "the other end has gone")),
                },
                (Some(listener), Some(peer)) => tokio::select! {
                    biased;
                    received = packet(&peer) => match received {
                        Ok(Some(bytes)) => bytes,
                        // Gone, or not of our kind.
                        Ok(None) | Err(_) => {
                            self.set_peer(None);
                            continue;
                        }
                    },
                    // One at a time: a second one finds its socket closed.
                    second = accept(&listener.socket) => {
                        drop(second?);
                        continue;
                    }
                },
                (Some(listener), None) => {
                    let peer = accept(&listener.socket).await?;
                    self.set_peer(Some(Arc::new(polled(peer)?)));
                    continue;
                }
                // An end that connects has its peer as long as it lives.
                (None, None) => return Err(io::ErrorKind::NotConnected.into()),
            };
            let received_ns = monotonic_ns();
            match wire::from_bytes(&bytes) {
                Some(Content::Data(frame)) if self.wants(frame.id) => {
                    return Ok(Heard::Frame(TimedFrame { frame, received_ns }));
                }
                Some(Content::Error(error)) => return Ok(Heard::Error(error)),
                _ => {}
            }
        }
    }

    pub(super) fn try_send(&self, frame: &Frame) -> io::Result<()> {
        let Some(peer) = self.peer() else { return Ok(()) };
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        match rustix::net::send(peer.get_ref(), &wire::to_bytes(frame), flags) {
            Ok(_) => Ok(()),
            // The next reception sees to it.
            Err(Errno::PIPE | Errno::CONNRESET) if self.listener.is_some() => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    pub(super) async fn room(&self) -> io::Result<()> {
        match self.peer() {
            Some(peer) => poll::room(peer.get_ref()).await,
            None => Ok(()),
        }
    }

    fn wants(&self, id: FrameId) -> bool {
        self.wanted.as_ref().is_none_or(|ids| ids.binary_search(&id).is_ok())
    }

    fn peer(&self) -> Option<Peer> {
        self.peer.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_peer(&self, peer: Option<Peer>) {
        *self.peer.lock().unwrap_or_else(PoisonError::into_inner) = peer;
    }
}

/// The next packet; `None` where the other end has gone.
async fn packet(peer: &AsyncFd<OwnedFd>) -> io::Result<Option<[u8; wire::SIZE]>> {
    peer.async_io(Interest::READABLE, |socket| {
        let mut bytes = [0; wire::SIZE];
        loop {
            match rustix::net::recv(socket, &mut bytes[..], RecvFlags::DONTWAIT | RecvFlags::TRUNC) {
                Ok((_, wire::SIZE)) => return Ok(Some(bytes)),
                Ok((_, 0)) => return Ok(None),
                Ok((_, got)) => {
                    let what = format!("expected packets of {} bytes (struct can_frame), got one of {got}", wire::SIZE);
                    return Err(io::Error::new(io::ErrorKind::InvalidData, what));
                }
                // It left without having read all: what it sent before is still there, and then the end.
                Err(Errno::CONNRESET | Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
    })
    .await
}

async fn accept(listener: &AsyncFd<OwnedFd>) -> io::Result<OwnedFd> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    listener.async_io(Interest::READABLE, |socket| Ok(rustix::net::accept_with(socket, flags)?)).await
}

fn socket() -> rustix::io::Result<OwnedFd> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
    sockopt::set_socket_send_buffer_size(&socket, SEND_BUFFER)?;
    Ok(socket)
}

fn connect(path: &Path) -> Result<Peer, CanError> {
    let failed = |what| move |source: Errno| error(path, what, source);
    let address = SocketAddrUnix::new(path).map_err(failed("path of a socket"))?;
    let socket = socket().map_err(failed("socket"))?;
    rustix::net::connect(&socket, &address).map_err(|source| match source {
        Errno::NOENT => CanError::NobodyThere { path: path.to_owned(), found: "there is no such socket" },
        Errno::CONNREFUSED => CanError::NobodyThere { path: path.to_owned(), found: "nobody listens there" },
        // Its queue of peers is full: the first one has not been let in.
        Errno::AGAIN => CanError::NobodyThere { path: path.to_owned(), found: "who listens there lets nobody in" },
        Errno::PROTOTYPE => CanError::NobodyThere { path: path.to_owned(), found: "a socket of another kind is there" },
        source => error(path, "connect", source),
    })?;
    polled(socket).map(Arc::new).map_err(|source| system(path, "epoll", source))
}

fn bind(path: &Path) -> Result<Listener, CanError> {
    let failed = |what| move |source: Errno| error(path, what, source);
    let address = SocketAddrUnix::new(path).map_err(failed("path of a socket"))?;
    let listener = socket().map_err(failed("socket"))?;
    let bound = match rustix::net::bind(&listener, &address) {
        Err(Errno::ADDRINUSE) => {
            free(path, &address)?;
            rustix::net::bind(&listener, &address)
        }
        bound => bound,
    };
    bound.map_err(failed("bind"))?;
    rustix::net::listen(&listener, 4).map_err(failed("listen"))?;
    let socket = polled(listener).map_err(|source| system(path, "epoll", source))?;
    Ok(Listener { socket, path: path.to_owned() })
}

/// Removes what a process that has ended left there; anything else is somebody's.
fn free(path: &Path, address: &SocketAddrUnix) -> Result<(), CanError> {
    let taken = |found| CanError::Taken { path: path.to_owned(), found };
    let probe = socket().map_err(|source| error(path, "socket", source))?;
    match rustix::net::connect(&probe, address) {
        Err(Errno::CONNREFUSED) => {
            use std::os::unix::fs::FileTypeExt;
            let is_socket = std::fs::symlink_metadata(path).is_ok_and(|about| about.file_type().is_socket());
            if !is_socket {
                return Err(taken("a file that is no socket is there"));
            }
            std::fs::remove_file(path).map_err(|source| system(path, "unlink", source))
        }
        // Gone by itself in between.
        Err(Errno::NOENT) => Ok(()),
        _ => Err(taken("another process listens there")),
    }
}

fn error(path: &Path, what: &'static str, source: Errno) -> CanError {
    match source {
        Errno::ACCESS | Errno::PERM => CanError::Permission {
            interface: Interface::Unix(path.to_owned()),
            what,
            remedy: "both ends need the right to write to the socket and to search its folder",
        },
        source => system(path, what, source.into()),
    }
}

fn system(path: &Path, what: &'static str, source: io::Error) -> CanError {
    CanError::System { interface: Interface::Unix(path.to_owned()), what, source }
}
