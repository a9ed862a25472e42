//! A bus by SocketCAN: raw socket, filters in the kernel, error frames, receive times.

use super::arrival::{Arrivals, monotonic_ns};
use super::overflow;
use super::poll::{self, polled};
use super::port::{Controller, Heard, Wanted};
use super::wire::{self, Content};
use super::{CanError, Condition, Frame, FrameId, Interface, TimedFrame, interface};
use rustix::net::{AddressFamily, Protocol, SendFlags, SocketFlags, SocketType, sockopt};
use socketcan::nl::CanState;
use socketcan::{CanFilter, CanInterface, CanSocket, Socket, SocketOptions};
use std::io;
use std::num::NonZeroU32;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// `CAN_RAW_FILTER_MAX` (linux/can/raw.h).
const MOST_FILTERS: usize = 512;
/// Asked for; the kernel gives its least (4608 bytes, some six frames): what waits behind a bus that is busy grows stale.
const SEND_BUFFER: usize = 1;
/// Asked for; the kernel gives at most twice net.core.rmem_max, by default some 550 frames.
const RECEIVE_BUFFER: usize = 1 << 20;

/// One end of a bus.
pub struct SocketCan {
    name: String,
    socket: AsyncFd<CanSocket>,
    arrivals: Arrivals,
}

impl SocketCan {
    pub(super) fn open(name: &str, wanted: Wanted<'_>) -> Result<SocketCan, CanError> {
        let interface = || Interface::SocketCan(name.to_owned());
        let failed = |what| move |source: io::Error| error(name, what, source);
        // Before the interface is looked for: without CAN in the kernel there is none, and that is not why. Loads the module, too.
        let raw = NonZeroU32::new(libc::CAN_RAW as u32).map(Protocol::from_raw);
        rustix::net::socket_with(AddressFamily::CAN, SocketType::RAW, SocketFlags::CLOEXEC, raw)
            .map_err(|e| failed("socket")(e.into()))?;
        interface::check(name)?;
        let socket = CanSocket::open(name).map_err(failed("bind"))?;
        socket.set_nonblocking(true).map_err(failed("O_NONBLOCK"))?;
        match wanted {
            Wanted::All => {}
            Wanted::Only(ids) => {
                let mut ids = ids.to_vec();
                ids.sort();
                ids.dedup();
                if ids.len() > MOST_FILTERS {
                    let (count, most) = (ids.len(), MOST_FILTERS);
                    return Err(CanError::TooManyWanted { interface: interface(), count, most });
                }
                let filters: Vec<CanFilter> = ids.into_iter().map(filter).collect();
                socket.set_filters(&filters).map_err(failed("CAN_RAW_FILTER"))?;
            }
        }
        socket.set_error_filter_accept_all().map_err(failed("CAN_RAW_ERR_FILTER"))?;
        socket.set_recv_own_msgs(false).map_err(failed("CAN_RAW_RECV_OWN_MSGS"))?;
        socket.set_recv_timestamp(true).map_err(failed("SO_TIMESTAMPNS"))?;
        sockopt::set_socket_send_buffer_size(&socket, SEND_BUFFER).map_err(|e| failed("SO_SNDBUF")(e.into()))?;
        sockopt::set_socket_recv_buffer_size(&socket, RECEIVE_BUFFER).map_err(|e| failed("SO_RCVBUF")(e.into()))?;
        let arrivals = Arrivals::default();
        arrivals.found_empty(monotonic_ns());
        let socket = polled(socket).map_err(failed("epoll"))?;
        Ok(SocketCan { name: name.to_owned(), socket, arrivals })
    }

    pub(super) async fn receive(&self) -> io::Result<Heard> {
        loop {
            let received = self
                .socket
                // An interface that goes down says so as an error of the socket.
                .async_io(Interest::READABLE | Interest::ERROR, |socket| {
                    let before_ns = monotonic_ns();
                    let received = socket.read_frame_with_timestamps();
                    if received.as_ref().is_err_and(|e| e.kind() == io::ErrorKind::WouldBlock) {
                        self.arrivals.found_empty(before_ns);
                    }
                    received
                })
                .await;
            let (frame, times) = received?;
            match wire::from_socket(frame) {
                Some(Content::Data(frame)) => {
                    return Ok(Heard::Frame(TimedFrame { frame, received_ns: self.arrivals.of(times.socket) }));
                }
                Some(Content::Error(error)) => return Ok(Heard::Error(error)),
                Some(Content::Remote) | None => {}
            }
        }
    }

    pub(super) fn try_send(&self, frame: &Frame) -> io::Result<()> {
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        rustix::net::send(self.socket.get_ref(), &wire::to_bytes(frame), flags)?;
        Ok(())
    }

    pub(super) async fn room(&self) -> io::Result<()> {
        poll::room(self.socket.get_ref()).await
    }

    /// Frames that the kernel dropped since the socket was opened; it wraps.
    pub(super) fn dropped(&self) -> u32 {
        overflow::dropped(self.socket.get_ref()).unwrap_or(0)
    }

    pub(super) fn controller(&self) -> Option<Controller> {
        let parameters = CanInterface::open(&self.name).ok()?.can_params().ok()?;
        let condition = match parameters.state? {
            CanState::ErrorActive => Condition::Active,
            CanState::ErrorWarning => Condition::Warning,
            CanState::ErrorPassive => Condition::Passive,
            CanState::BusOff => Condition::BusOff,
            _ => Condition::Down,
        };
        // Counters have 9 bits where bus-off is near.
        let counter = |count: u16| u8::try_from(count).unwrap_or(u8::MAX);
        let error_counters = parameters.berr_counter.map(|counters| (counter(counters.txerr), counter(counters.rxerr)));
        Some(Controller { condition, error_counters, restart_ms: parameters.restart_ms.unwrap_or(0) })
    }
}

/// Exactly this identifier, data frames alone: the kernel finds filters of this kind by a table and a hash, not one by one.
fn filter(id: FrameId) -> CanFilter {
    let bits = match id {
        FrameId::Standard(_) => libc::CAN_SFF_MASK,
        FrameId::Extended(_) => libc::CAN_EFF_MASK,
    };
    CanFilter::new(wire::raw_id(id), bits | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG)
}

fn error(name: &str, what: &'static str, source: io::Error) -> CanError {
    let name = name.to_owned();
    match source.raw_os_error() {
        Some(libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT | libc::ESOCKTNOSUPPORT) => CanError::NoCan { name },
        Some(libc::EPERM | libc::EACCES) => CanError::Permission {
            interface: Interface::SocketCan(name),
            what,
            remedy: "CAN sockets need no privilege of their own, so a container or a sandbox forbids them: allow AF_CAN there",
        },
        Some(libc::ENETDOWN) => CanError::Down { name },
        _ => CanError::System { interface: Interface::SocketCan(name), what, source },
    }
}
