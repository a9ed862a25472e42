//! What can be wrong with a CAN interface when it is opened.

use super::Interface;
use std::io;
use std::path::PathBuf;

/// A CAN interface can't be used.
#[derive(Debug, thiserror::Error)]
pub enum CanError {
    /// Not the name of an interface.
    #[error(
        "CAN interface `{name}`: expected the name of an interface (`can0`, `vcan0`: 1 to 15 characters without `/`, `:` and \
         spaces) or `unix:PATH`"
    )]
    Name {
        /// What was given.
        name: String,
    },
    /// There is no such interface.
    #[error(
        "there is no network interface {name}; CAN interfaces here: {present}. Connect the adapter, or make a virtual one: \
         `modprobe vcan; ip link add dev {name} type vcan; ip link set {name} up`"
    )]
    NoSuchInterface {
        /// The one that was asked for.
        name: String,
        /// Those that there are.
        present: String,
    },
    /// An interface of another kind.
    #[error("{name} is no CAN interface (link type {found}, expected 280); CAN interfaces here: {present}")]
    NotCan {
        /// The one that was asked for.
        name: String,
        /// Its type in /sys/class/net/NAME/type.
        found: String,
        /// Those that there are.
        present: String,
    },
    /// The interface is not up.
    #[error("{name} is down: {}", up(name))]
    Down {
        /// Which.
        name: String,
    },
    /// The kernel has no CAN.
    #[error(
        "this kernel has no CAN (AF_CAN, raw sockets): expected it for {name}. `modprobe can-raw`; where there is no such module, \
         boot a kernel that has it (Debian: linux-image-amd64 instead of linux-image-cloud-amd64), or use `unix:PATH` with \
         `bench emulate`"
    )]
    NoCan {
        /// The interface that was asked for.
        name: String,
    },
    /// Not allowed.
    #[error("{interface}: permission denied ({what}): {remedy}")]
    Permission {
        /// Of what.
        interface: Interface,
        /// The call that was refused.
        what: &'static str,
        /// What to do.
        remedy: &'static str,
    },
    /// More identifiers than a socket can filter.
    #[error("{interface}: {count} identifiers are wanted, a socket filters at most {most}; map fewer messages")]
    TooManyWanted {
        /// Of what.
        interface: Interface,
        /// How many.
        count: usize,
        /// How many there may be.
        most: usize,
    },
    /// Nobody listens at the Unix socket.
    #[error(
        "unix:{path}: {found}; expected the socket of the other end of the bus. Start it first: `bench emulate` with `unix:{path}`",
        path = path.display()
    )]
    NobodyThere {
        /// Where.
        path: PathBuf,
        /// What there is.
        found: &'static str,
    },
    /// Somebody else is that end of the bus.
    #[error(
        "unix:{path}: {found}; expected a path that is free. End the other one (another `bench emulate`?) or take another path",
        path = path.display()
    )]
    Taken {
        /// Where.
        path: PathBuf,
        /// What there is.
        found: &'static str,
    },
    /// Anything else that the system refuses.
    #[error(
        "{interface}: {what} failed: {source}; is the interface still there and up (`ip -details link`), and are there file descriptors and \
         threads left (`ulimit -a`)?"
    )]
    System {
        /// Of what.
        interface: Interface,
        /// The call.
        what: &'static str,
        /// Why.
        source: io::Error,
    },
}

/// How an interface is brought up.
fn up(name: &str) -> String {
    if name.starts_with('v') {
        format!("`ip link set {name} up`")
    } else {
        format!("`ip link set {name} up type can bitrate 500000 restart-ms 100` (with the bus's bit rate)")
    }
}
