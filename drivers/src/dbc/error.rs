//! What can be wrong with a database, with the place and what to do.

use crate::can::FrameId;
use thiserror::Error;

/// A database that can't be used, or a name that is not in it.
#[derive(Debug, Error)]
pub enum DbcError {
    /// The file can't be read.
    #[error("{file}: expected a CAN database (DBC) that can be read, got: {source}")]
    Read {
        /// Its path.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file has an error.
    #[error("{file}:{line}: {problem}")]
    File {
        /// Its path.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong there.
        problem: Problem,
    },
    /// A signal's path has not the form `MESSAGE.Signal`.
    #[error("{file}: expected a signal as MESSAGE.Signal, got {got:?}{nearest}")]
    Path {
        /// Path of the database.
        file: String,
        /// What came.
        got: String,
        /// The nearest signal, as `, did you mean "...?"`; empty where none is near.
        nearest: String,
    },
    /// No message of that name.
    #[error("{file}: expected one of its messages, got {got:?}{nearest}; it has {existing}")]
    NoMessage {
        /// Path of the database.
        file: String,
        /// What came.
        got: String,
        /// The nearest name, as `, did you mean "...?"`; empty where none is near.
        nearest: String,
        /// What the file has.
        existing: String,
    },
    /// No signal of that name in the message.
    #[error("{file}: expected one of the signals of message {message}, got {got:?}{nearest}; it has {existing}")]
    NoSignal {
        /// Path of the database.
        file: String,
        /// The message.
        message: String,
        /// What came.
        got: String,
        /// The nearest name, as `, did you mean "...?"`; empty where none is near.
        nearest: String,
        /// What the message has.
        existing: String,
    },
    /// The message is no classic frame.
    #[error(
        "{file}: message {message}: expected a classic frame of at most 8 bytes, got {length} bytes (CAN FD or a transport protocol): \
         map a signal of another message"
    )]
    NotClassic {
        /// Path of the database.
        file: String,
        /// The message.
        message: String,
        /// Its length in bytes.
        length: usize,
    },
}

/// An error in a database. `signal` is always `MESSAGE.Signal`.
#[derive(Clone, Debug, PartialEq, Error)]
#[allow(missing_docs, reason = "the fields are the words of the messages")]
pub enum Problem {
    /// Not of the form of a DBC file.
    #[error("column {column}: expected {expected}, got {got}")]
    Syntax { column: usize, expected: String, got: String },
    /// Of the form, but not understood by the parser.
    #[error("expected a statement with values in their ranges, got {got:?} ({reason})")]
    Statement { got: String, reason: String },
    /// Neither 11 bits nor 29 bits with bit 31 set.
    #[error(
        "expected an identifier 0..=2047 (11 bits), or 2147483648 + 0..=536870911 (29 bits), got {got}: where 29 bits are meant, add \
         2147483648"
    )]
    Identifier { got: String },
    /// Two nodes with the same identifier. Each message with its sender and line.
    #[error("two messages have the identifier {id}: {first} and {second}: give one of these nodes another identifier")]
    SameId { id: FrameId, first: String, second: String },
    /// Two messages with one name.
    #[error("two messages have the name {name}, the first one in line {first_line}: rename one")]
    SameMessage { name: String, first_line: usize },
    /// Two signals of a message with one name.
    #[error("two signals have the name {signal}, the first one in line {first_line}: rename one")]
    SameSignal { signal: String, first_line: usize },
    /// No bits, or more than 64.
    #[error("signal {signal}: expected a width of 1..=64 bits, got {got}")]
    Width { signal: String, got: u64 },
    /// `SIG_VALTYPE_` against the width.
    #[error(
        "signal {signal}: expected {expected} bits for an IEEE float of that size, got {got}: change the width or SIG_VALTYPE_"
    )]
    FloatWidth { signal: String, expected: u64, got: u64 },
    /// Beyond the end of the message.
    #[error(
        "signal {signal}: expected it within the {length} bytes of its message, got start bit {start} and {width} bits ({order}): move it, \
         or give the message more bytes"
    )]
    BeyondMessage { signal: String, length: usize, start: u64, width: u64, order: &'static str },
    /// Two signals in the same bits of the same frame.
    #[error(
        "signals {first} (line {first_line}) and {second} both have bit {bit} of byte {byte}: move one, or multiplex them"
    )]
    Overlap { first: String, first_line: usize, second: String, byte: u32, bit: u32 },
    /// Factor 0 or infinite, offset infinite.
    #[error(
        "signal {signal}: expected a finite factor other than 0 and a finite offset, got factor {factor}, offset {offset}"
    )]
    Scale { signal: String, factor: f64, offset: f64 },
    /// Limits the wrong way round.
    #[error("signal {signal}: expected minimum <= maximum, got [{minimum}|{maximum}]; [0|0] says that there are none")]
    Limits { signal: String, minimum: f64, maximum: f64 },
    /// Multiplexed by nothing.
    #[error(
        "signal {signal}: expected a multiplexor (M) in its message, got none: mark it, or take the m... away from the signal"
    )]
    NoMultiplexor { signal: String },
    /// More than one, and nothing says which one switches.
    #[error(
        "signal {signal}: expected one multiplexor (M) in its message, got {first} and {second}: say by SG_MUL_VAL_ which one it depends on"
    )]
    TwoMultiplexors { signal: String, first: String, second: String },
    /// `SG_MUL_VAL_` names a signal that is none.
    #[error("signal {signal}: expected a multiplexor (M) of its message, got {multiplexor}, {got}")]
    NotAMultiplexor { signal: String, multiplexor: String, got: &'static str },
    /// Signals that multiplex one another.
    #[error(
        "signal {signal}: expected multiplexors that end at one that is always there, got one that depends on itself: {chain}"
    )]
    MultiplexorLoop { signal: String, chain: String },
    /// A value that the multiplexor can't have.
    #[error("signal {signal}: expected a value 0..={largest} of the multiplexor {multiplexor}, got {got}")]
    MultiplexorValue { signal: String, multiplexor: String, largest: u64, got: String },
    /// More conditions than a codec holds.
    #[error(
        "signal {signal}: expected at most {most} ranges of multiplexor values (over all its multiplexors), got {got}: join ranges"
    )]
    TooManyRanges { signal: String, most: usize, got: usize },
    /// `SIG_VALTYPE_` or `SG_MUL_VAL_` for something that the file has not.
    #[error("{keyword}: expected a signal of the file, got {got}: correct the name, or remove the line")]
    Reference { keyword: &'static str, got: String },
    /// `SG_MUL_VAL_` for a signal without `m`.
    #[error("SG_MUL_VAL_: expected a multiplexed signal (m...), got {signal}: mark it, or remove the line")]
    NotMultiplexed { signal: String },
    /// `GenMsgCycleTime` no time.
    #[error("message {message}: expected a GenMsgCycleTime in ms, >= 0, got {got}")]
    CycleTime { message: String, got: String },
}
