//! A data file as a table of numbers: CSV with one header line, plain or gzipped.

use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;

/// A table of numbers.
#[derive(Clone, Debug)]
pub struct Table {
    /// Where it was read.
    pub file: PathBuf,
    names: Vec<String>,
    columns: Vec<Vec<f64>>,
}

/// A data file that can't be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {why}", file.display())]
pub struct DataError {
    /// The file.
    pub file: PathBuf,
    /// Expected, got, remedy.
    pub why: String,
}

impl Table {
    /// Reads a file; gzip is told by its first two bytes.
    ///
    /// # Errors
    /// It can't be read, has no header, a row of another length, or a value that is no finite number.
    pub fn read(file: &Path) -> Result<Table, DataError> {
        let refused = |why: String| DataError { file: file.to_owned(), why };
        let raw = std::fs::read(file).map_err(|e| refused(format!("expected a readable CSV file, got \"{e}\"")))?;
        let mut text = String::new();
        let decoded = if raw.starts_with(&[0x1f, 0x8b]) {
            MultiGzDecoder::new(&raw[..]).read_to_string(&mut text)
        } else {
            (&raw[..]).read_to_string(&mut text)
        };
        decoded.map_err(|e| refused(format!("expected CSV in UTF-8, plain or gzipped, got \"{e}\"")))?;
        Self::parse(file, &text)
    }

    /// Of a text; `file` is for messages.
    ///
    /// # Errors
    /// As [`Table::read`], of the content.
    pub fn parse(file: &Path, text: &str) -> Result<Table, DataError> {
        let refused = |why: String| DataError { file: file.to_owned(), why };
        let mut lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
        let (_, header) = lines.next().ok_or_else(|| refused("expected a header line, got an empty file".into()))?;
        let names: Vec<String> = header.split(',').map(|n| n.trim().to_string()).collect();
        let mut columns: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
        for (number, line) in lines {
            let cells: Vec<&str> = line.split(',').collect();
            if cells.len() != names.len() {
                let why = format!("line {}: expected {} values, got {}", number + 1, names.len(), cells.len());
                return Err(refused(why));
            }
            for ((cell, column), name) in cells.iter().zip(&mut columns).zip(&names) {
                let value = cell.trim().parse::<f64>().ok().filter(|v| v.is_finite());
                column.push(value.ok_or_else(|| {
                    refused(format!("line {}, column {name}: expected a finite number, got \"{cell}\"", number + 1))
                })?);
            }
        }
        Ok(Table { file: file.to_owned(), names, columns })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, Vec::len)
    }

    /// A column; `None` where there is none of this name.
    pub fn find(&self, name: &str) -> Option<&[f64]> {
        self.names.iter().position(|n| n == name).map(|i| &self.columns[i][..])
    }

    /// A column that has to be there.
    ///
    /// # Errors
    /// It is not: the message names those that are.
    pub fn column(&self, name: &str) -> Result<&[f64], DataError> {
        self.find(name).ok_or_else(|| {
            self.refuse(format!("expected a column {name}, got {}; rename or convert it", self.names.join(", ")))
        })
    }

    /// An error about this file.
    pub fn refuse(&self, why: String) -> DataError {
        DataError { file: self.file.clone(), why }
    }

    /// Refuses a table with fewer rows than this.
    ///
    /// # Errors
    /// Just that.
    pub fn at_least(&self, rows: usize, what: &str) -> Result<(), DataError> {
        if self.rows() < rows {
            return Err(self.refuse(format!("expected at least {rows} rows ({what}), got {}", self.rows())));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_tables_say_where() {
        let parse = |text: &str| Table::parse(Path::new("a.csv"), text);
        let said = |text: &str| parse(text).map(drop).map_err(|e| e.to_string()).unwrap_err();
        assert_eq!(said(""), "a.csv: expected a header line, got an empty file");
        assert_eq!(said("t,y\n0,1\n1\n"), "a.csv: line 3: expected 2 values, got 1");
        assert!(said("t,y\n0,x\n").contains("line 2, column y"));
        assert!(said("t,y\n0,nan\n").contains("finite"));
        let table = parse("t, y\n0,1\n\n1,2\n").unwrap();
        assert_eq!((table.rows(), table.column("y").unwrap()), (2, &[1.0, 2.0][..]));
        assert!(table.column("u").unwrap_err().to_string().contains("got t, y"));
        assert!(table.at_least(3, "a test").is_err());
    }
}
