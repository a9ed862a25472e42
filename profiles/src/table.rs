//! Tables of a wave: CSV with the columns `time_s,value`, beside the script or within it.

use crate::error::{ScriptError, Source};
use crate::signal::Point;
use serde::Deserialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Component, Path};
use std::sync::Arc;

/// Longest time in a table, s.
const LONGEST_S: f64 = 86_400.0;

/// What a table says between its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Interpolation {
    /// A straight line from row to row.
    Linear,
    /// The value of the row before.
    Hold,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Row {
    time_ns: u64,
    pub value: f64,
    /// Line in the file, from 1.
    pub line: usize,
}

/// A checked table: at least one row, the first at time 0, times strictly increasing, values finite.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    /// For messages.
    pub file: String,
    rows: Vec<Row>,
}

impl Table {
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The table at a time; behind its end the last value stays.
    pub fn at(&self, time_ns: u64, interpolation: Interpolation) -> Point {
        let following = self.rows.partition_point(|row| row.time_ns <= time_ns);
        // The first row is at 0, so at least one is not later.
        let row = self.rows[following - 1];
        match (interpolation, self.rows.get(following)) {
            (Interpolation::Linear, Some(next)) => {
                let length_ns = (next.time_ns - row.time_ns) as f64;
                let way = next.value - row.value;
                let part = (time_ns - row.time_ns) as f64 / length_ns;
                Point { value: row.value + way * part, rate_per_s: way / (length_ns * 1e-9) }
            }
            _ => Point { value: row.value, rate_per_s: 0.0 },
        }
    }

    pub fn parse(text: &str, file: &str) -> Result<Table, ScriptError> {
        let error = |line: usize, what: String| ScriptError { file: file.to_owned(), line, what };
        let mut lines = Lines { text, offset: 0, line: 1 };
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(text.as_bytes());
        let bad = |e: csv::Error| error(1, format!("expected a CSV table: {e}"));
        let header = reader.headers().map_err(bad)?;
        if header.iter().ne(["time_s", "value"]) {
            let got: Vec<_> = header.iter().collect();
            return Err(error(1, format!("expected the header `time_s,value`, got `{}`", got.join(","))));
        }
        let mut rows: Vec<Row> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(bad)?;
            let line = lines.of(record.position().map_or(0, |position| position.byte() as usize));
            if record.len() != 2 {
                return Err(error(line, format!("expected 2 columns, time_s and value, got {}", record.len())));
            }
            let number = |column: usize, name: &str| {
                let field = record.get(column).unwrap_or_default();
                field.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
                    error(line, format!("column {} ({name}): expected a finite number, got {field:?}", column + 1))
                })
            };
            let (time_s, value) = (number(0, "time_s")?, number(1, "value")?);
            if !(0.0..=LONGEST_S).contains(&time_s) {
                let what = format!("column 1 (time_s): expected a time within 0 .. {LONGEST_S} s, got {time_s}");
                return Err(error(line, what));
            }
            let time_ns = (time_s * 1e9).round() as u64;
            match rows.last() {
                None if time_ns != 0 => {
                    return Err(error(line, format!("column 1 (time_s): the first row must be at 0 s, got {time_s}")));
                }
                Some(before) if time_ns <= before.time_ns => {
                    let before_s = before.time_ns as f64 * 1e-9;
                    let what = format!("column 1 (time_s): times must increase, got {time_s} after {before_s}");
                    return Err(error(line, what));
                }
                _ => rows.push(Row { time_ns, value, line }),
            }
        }
        if rows.is_empty() {
            return Err(error(1, "expected at least one row behind the header, got none".to_owned()));
        }
        Ok(Table { file: file.to_owned(), rows })
    }

    /// The table as text that reads as the same numbers.
    fn text(&self) -> String {
        let mut text = "time_s,value\n".to_owned();
        for Row { time_ns, value, .. } in &self.rows {
            // Writing to a string does not fail.
            let _ = writeln!(text, "{}.{:09},{value}", time_ns / 1_000_000_000, time_ns % 1_000_000_000);
        }
        text
    }
}

/// Counts lines up to the records of a text, in their order.
struct Lines<'a> {
    text: &'a str,
    offset: usize,
    line: usize,
}

impl Lines<'_> {
    /// Line of the record that is read from here on: the reader's place lies before the empty lines that it skips.
    fn of(&mut self, offset: usize) -> usize {
        let rest = self.text.get(offset..).unwrap_or_default();
        let empty = rest.len() - rest.trim_start_matches(['\r', '\n']).len();
        let begins = offset + empty;
        let passed = self.text.get(self.offset..begins).unwrap_or_default();
        self.line += passed.bytes().filter(|&byte| byte == b'\n').count();
        self.offset = begins;
        self.line
    }
}

/// Where a script's tables come from: its own `[files]`, or else its folder.
pub(crate) struct Tables<'a> {
    within: Option<&'a BTreeMap<String, String>>,
    folder: Option<&'a Path>,
    read: RefCell<BTreeMap<String, Arc<Table>>>,
}

impl<'a> Tables<'a> {
    pub fn new(within: Option<&'a BTreeMap<String, String>>, folder: Option<&'a Path>) -> Self {
        Tables { within, folder, read: RefCell::default() }
    }

    /// The table that the script names at `offset`.
    pub fn get(&self, name: &str, source: &Source, offset: usize) -> Result<Arc<Table>, ScriptError> {
        if let Some(table) = self.read.borrow().get(name) {
            return Ok(table.clone());
        }
        let refused = |what: String| Err(source.error(offset, what));
        let table = match (self.within, self.folder) {
            (Some(within), _) => match within.get(name) {
                Some(text) => Table::parse(text, &format!("{} [files] {name}", source.file))?,
                None => return refused(format!("`file` names {name:?}, which [files] does not hold: add it there")),
            },
            (None, Some(folder)) => {
                let plain = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
                if !plain || name.is_empty() || name.contains(|c: char| c.is_control() || "\"\\".contains(c)) {
                    return refused(format!("`file` must be a path within the script's folder, got {name:?}"));
                }
                let path = folder.join(name);
                match std::fs::read_to_string(&path) {
                    Ok(text) => Table::parse(&text, &path.display().to_string())?,
                    Err(error) => {
                        return refused(format!(
                            "`file`: expected a readable CSV file at {}, got \"{error}\"",
                            path.display()
                        ));
                    }
                }
            }
            (None, None) => {
                return refused(format!(
                    "`file` names {name:?}, but this script was not read from a folder: put the table into [files]"
                ));
            }
        };
        let table = Arc::new(table);
        self.read.borrow_mut().insert(name.to_owned(), table.clone());
        Ok(table)
    }

    /// The script's text with the tables that were read from its folder within it.
    pub fn self_contained(&self, text: &str) -> String {
        let read = self.read.borrow();
        if self.within.is_some() || read.is_empty() {
            return text.to_owned();
        }
        let mut whole = format!("{text}\n[files]\n");
        for (name, table) in read.iter() {
            // Names were checked when they were read, and a table's text holds numbers only: neither ends its quotes.
            let _ = writeln!(whole, "\"{name}\" = '''\n{}'''", table.text());
        }
        whole
    }
}
