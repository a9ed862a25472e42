//! Recordings to other programs' formats and back: CSV, ASAM MDF 4.1, Apache Parquet. Everything is a stream: memory does not depend on a
//! run's length.

pub mod content;
pub mod csv_file;
pub mod export;
pub mod format;
pub mod import;
mod mdf_blocks;
mod mdf_file;
pub mod output;
mod parquet_file;
pub mod source;
pub mod table;
