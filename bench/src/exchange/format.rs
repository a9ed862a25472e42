//! Formats that a recording can be exported to.

use crate::failure::{Failure, Kind};
use std::path::Path;

/// A format, by the extension of its files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Text, comma-separated
    #[value(name = "csv")]
    Csv,
    /// The same, packed with gzip
    #[value(name = "csv.gz")]
    CsvGz,
    /// ASAM MDF 4.1
    #[value(name = "mf4")]
    Mf4,
    /// Apache Parquet
    #[value(name = "parquet")]
    Parquet,
}

impl Format {
    /// All of them.
    pub const ALL: [Format; 4] = [Format::Csv, Format::CsvGz, Format::Mf4, Format::Parquet];

    /// Extension without the point in front.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Csv => "csv",
            Format::CsvGz => "csv.gz",
            Format::Mf4 => "mf4",
            Format::Parquet => "parquet",
        }
    }

    /// Whether a file of this format can be a run of a campaign.
    pub fn is_csv(self) -> bool {
        matches!(self, Format::Csv | Format::CsvGz)
    }

    /// By the name of the file that is to be written, which must agree with what was `asked` for.
    ///
    /// # Errors
    /// Another extension (2).
    pub fn of_file(target: &Path, asked: Option<Format>) -> Result<Format, Failure> {
        let name = target.file_name().unwrap_or_default().to_string_lossy();
        let named = Format::ALL.into_iter().find(|format| name.ends_with(&format!(".{}", format.extension())));
        match (named, asked) {
            (Some(named), None) => Ok(named),
            (Some(named), Some(asked)) if named == asked => Ok(named),
            // `--format csv` leaves it to the name whether the text is packed.
            (Some(Format::CsvGz), Some(Format::Csv)) => Ok(Format::CsvGz),
            _ => {
                let expected = match asked {
                    Some(asked) => format!("a file name that ends in .{}", asked.extension()),
                    None => "a file name that ends in .csv, .csv.gz, .mf4 or .parquet".to_owned(),
                };
                let message =
                    format!("{}: expected {expected}, got {name:?}; name the file by what it is", target.display());
                Err(Failure::new(Kind::Input, message))
            }
        }
    }
}
