//! The serial port of the pump amplifier.
//!
//! | file | what |
//! |---|---|
//! | `link.rs` | [`SerialLink`]: the loop's end; it never waits and never allocates |
//! | `thread.rs` | the thread that owns the port: where it sleeps, and what wakes it |
//! | `talk.rs` | what is said to the amplifier when: commands, requests, watchdog, silence, arming |
//! | `line.rs` | the port and the bytes that wait for room in it; reconnection |
//! | `shared.rs` | what the loop and the thread share |
//! | `hello.rs` | the first words with an amplifier, and what may be wrong where none answers |
//! | `port.rs` | opening a port, and what may be wrong with it |
//! | `pty.rs` | [`Pty`]: a port of our own making, for an emulated amplifier |

mod error;
mod hello;
mod line;
mod link;
mod port;
mod pty;
mod shared;
mod talk;
mod thread;

pub use error::LinkError;
pub use link::{AmplifierReport, SerialLink};
pub use pty::{AsyncPty, Pty};
