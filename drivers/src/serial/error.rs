//! Why an amplifier can't be reached: expected, got, remedy.

use crate::amplifier::AmplifierError;
use std::io;
use std::path::PathBuf;

/// Why there is no link to the amplifier.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The settings of the protocol.
    #[error(transparent)]
    Amplifier(#[from] AmplifierError),

    /// There is nothing of that name.
    #[error("{}: expected the amplifier's serial port, there is no such file; {there}; connect and power the adapter, or correct [amplifier] port", port.display())]
    NoSuchPort {
        /// As the rig file has it.
        port: PathBuf,
        /// The ports that there are.
        there: String,
    },

    /// The port is another user's.
    #[error("{}: expected to open the amplifier's port, permission denied; `usermod -aG dialout USER`, then log in again (or give `{}` to your group by a udev rule)", port.display(), port.display())]
    Permission {
        /// As the rig file has it.
        port: PathBuf,
    },

    /// It is a file, but no terminal.
    #[error("{}: expected a serial port (a tty), got {got}; {there}", port.display())]
    NotATty {
        /// As the rig file has it.
        port: PathBuf,
        /// What it is.
        got: String,
        /// The ports that there are.
        there: String,
    },

    /// Somebody else has it.
    #[error("{}: expected the port for ourselves, another program has it open; end that program (`fuser -v {}` names it; ModemManager is a usual one)", port.display(), port.display())]
    Busy {
        /// As the rig file has it.
        port: PathBuf,
    },

    /// The port does not run at that rate.
    #[error("{}: expected a port at {asked} baud, {got}; set [amplifier] baud to a rate that both the adapter and the amplifier know", port.display())]
    Baud {
        /// As the rig file has it.
        port: PathBuf,
        /// Wanted, bits a second.
        asked: u32,
        /// What the system said.
        got: String,
    },

    /// The system refused something else about the port.
    #[error("{}: expected a working serial port, {doing}: {source}; is it the right one, and is its adapter connected?", port.display())]
    Port {
        /// As the rig file has it.
        port: PathBuf,
        /// What was tried.
        doing: &'static str,
        /// What came.
        source: io::Error,
    },

    /// No answer, not one byte.
    #[error("{}: expected an answer from the amplifier ({title}, {baud} baud), got nothing in {waited_ms} ms; is it powered, is it the right port, are TX and RX crossed, does its UART speak this protocol and rate?", port.display())]
    Silent {
        /// As the rig file has it.
        port: PathBuf,
        /// What was expected to be spoken.
        title: &'static str,
        /// Bits a second.
        baud: u32,
        /// How long.
        waited_ms: u64,
    },

    /// Bytes came, but no answer.
    #[error("{}: expected frames of {title} at {baud} baud, got {bytes} bytes with {sound} sound frames and no answer to the hello; they begin {first}; {remedy}", port.display())]
    Garbled {
        /// As the rig file has it.
        port: PathBuf,
        /// What was expected to be spoken.
        title: &'static str,
        /// Bits a second.
        baud: u32,
        /// How many came.
        bytes: usize,
        /// Frames among them that the protocol accepts.
        sound: u64,
        /// The first of them, hexadecimal.
        first: String,
        /// What to do.
        remedy: &'static str,
    },

    /// The amplifier speaks another protocol of ours.
    #[error("{}: expected {title}, got {spoken_title}; set [amplifier] protocol = {spoken:?}, or take the right port", port.display())]
    OtherProtocol {
        /// As the rig file has it.
        port: PathBuf,
        /// What was expected to be spoken.
        title: &'static str,
        /// What is spoken: its name in a rig file.
        spoken: &'static str,
        /// What is spoken: in words.
        spoken_title: &'static str,
    },

    /// The system refused something that is not about the port.
    #[error("{doing}: {source}; free memory, file descriptors or threads (`ulimit -a`)")]
    System {
        /// What was tried.
        doing: &'static str,
        /// What came.
        source: io::Error,
    },
}

impl LinkError {
    /// Whether the rig file is what has to be changed, whatever is connected (else a device or a link failed).
    pub fn is_configuration(&self) -> bool {
        use LinkError::*;
        matches!(self, Amplifier(_) | NotATty { .. } | Baud { .. } | OtherProtocol { .. })
    }
}
