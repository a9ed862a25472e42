//! CAN databases (DBC) compiled to shifts and masks, no I/O but reading the file.
//!
//! The text is parsed by the crate `can-dbc`; what it does not check is checked here ([`Problem`] lists it), so that a database that was
//! read can be used without a further look. Classic frames of at most 8 bytes alone can be mapped: messages that are longer (CAN FD,
//! transport protocols) may stand in the file, their signals have no codec.
//!
//! ```
//! let text = "BU_: VALVES\n\nBO_ 416 LOOP: 8 VALVES\n SG_ Pressure : 0|16@1- (0.001,0) [0|0] \"bar\" BENCH\n";
//! let database = drivers::dbc::Database::parse(text, "rec.dbc").unwrap();
//! let (message, pressure) = database.signal("LOOP.Pressure").unwrap();
//! let mut data = [0; 8];
//! pressure.codec.encode(-1.2344, &mut data).unwrap();
//! assert_eq!(pressure.codec.decode(&data[..message.length]), Some(-1.234));
//! ```

mod check;
mod codec;
mod database;
mod error;
mod multiplexing;
mod text;

pub use codec::{Codec, OutOfRange};
pub use database::{Database, Message, Signal};
pub use error::{DbcError, Problem};
