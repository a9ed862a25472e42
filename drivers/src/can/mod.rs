//! CAN: frames, the bus as SocketCAN or a Unix socket gives it, and the thread that owns it.
//!
//! ```text
//!  loop                          I/O thread
//!  CanLink::send ───── sets ───▶ Port::try_send ──▶ bus
//!  CanLink::receive ◀─ frames ── Port::receive ◀─── bus (kernel's filters and receive times, error frames)
//!  CanLink::state ◀─── counts ── error frames, interface down, peer gone
//! ```
mod arrival;
mod error;
mod error_frame;
mod frame;
mod interface;
mod link;
mod orders;
mod overflow;
mod poll;
mod port;
mod report;
mod socket;
mod state;
mod thread;
mod unix;
mod wire;

pub use error::CanError;
pub use error_frame::ErrorFrame;
pub use frame::{Frame, FrameId, MOST_BYTES, TimedFrame};
pub use interface::Interface;
pub use link::{CanLink, MOST_COMMAND_FRAMES};
pub use port::{End, Heard, Port, Wanted, is_full};
pub use socket::SocketCan;
pub use state::{BusState, Condition};
pub use unix::Unix;
