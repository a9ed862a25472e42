//! Recordings: bytes to samples and back. Campaign folders, CSV and MCAP; `FORMAT.md` is the normative text.
//!
//! Readers refuse what they don't understand, with file, line (or tick) and column; nothing is repaired silently.

mod alignment;
mod campaign;
mod campaign_toml;
mod carried;
mod chunk;
mod csv_reader;
mod csv_writer;
mod ending;
mod error;
pub mod live;
mod mcap_reader;
mod mcap_records;
mod mcap_writer;
mod part_file;
mod recording;
mod recovery;
mod rows;
mod run_metadata;
mod run_record;
mod sample_message;
mod succession;
mod survey;
mod vocabulary;
mod wire;

pub use campaign::{CAMPAIGN_FILE, Campaign, RigFacts, RunEntry};
pub use carried::{CarriedError, carried, carry};
pub use csv_reader::CsvRows;
pub use csv_writer::{CsvWriter, push_integer, push_number};
pub use error::{CampaignError, CutShort, Mismatch, Place, Spot};
pub use mcap_reader::{Item, McapReader};
pub use mcap_writer::McapWriter;
pub use recording::Recording;
pub use recovery::{Damage, Recovered, recover};
pub use rows::Rows;
pub use run_metadata::{AmplifierFault, AmplifierReport, Event, RunMetadata, Severity};
pub use vocabulary::{Plane, Protocol, Role, UnknownWord};
