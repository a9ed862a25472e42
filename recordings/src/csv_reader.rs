//! CSV to columns. Fields are handed over as bytes and parsed once; the exact line of a fault is looked up only when
//! there is one.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use csv::{ByteRecord, ReaderBuilder};
use flate2::read::MultiGzDecoder;

use crate::error::{Place, quoted};
use crate::recording::{COLUMNS, FileKind, Whole};
use crate::{CampaignError, Protocol, Recording};

const REMEDY_MEASURED: &str = "write a number, or leave the field empty where nothing was measured";
const REMEDY_REQUIRED: &str = "write the value: this column is never empty";

/// Something is wrong with a field or a row. The place is added by whoever knows the file.
struct Fault {
    column: Option<String>,
    expected: String,
    got: String,
    remedy: &'static str,
}

impl Fault {
    fn field(column: usize, expected: &str, got: String, remedy: &'static str) -> Box<Self> {
        Box::new(Self { column: Some(COLUMNS[column].to_owned()), expected: expected.to_owned(), got, remedy })
    }
}

/// Where each of [`COLUMNS`] stands in this file.
struct Layout {
    index: [usize; COLUMNS.len()],
    header: ByteRecord,
}

/// Rows of a block at most.
const BLOCK_ROWS: usize = 4096;

/// Reads and checks a CSV file of the contract.
pub(crate) fn read(path: &Path, gzip: bool, protocol: Protocol) -> Result<Recording, CampaignError> {
    let mut rows = CsvRows::open_as(path, gzip, protocol)?;
    let mut recording = Recording::default();
    while rows.append(&mut recording, usize::MAX)? {}
    Ok(recording)
}

/// Reads a CSV run (`.csv`, `.csv.gz`) block by block, some thousand rows at a time: what [`Recording::read`] gives, in a stream.
///
/// What comes before an error is sound, but whoever reads columns refuses the whole file: the last item tells whether it is whole.
pub struct CsvRows {
    path: PathBuf,
    gzip: bool,
    protocol: Protocol,
    reader: csv::Reader<Box<dyn Read>>,
    layout: Layout,
    record: ByteRecord,
    last_time_s: Option<f64>,
    whole: Whole,
    done: bool,
}

impl CsvRows {
    /// Opens a run and reads its header line. `protocol` decides which columns must hold a value.
    ///
    /// # Errors
    /// Another extension, a header without the contract's columns, the system's refusal.
    pub fn open(path: &Path, protocol: Protocol) -> Result<CsvRows, CampaignError> {
        match FileKind::of(path)? {
            FileKind::Csv { gzip } => CsvRows::open_as(path, gzip, protocol),
            FileKind::Mcap => Err(CampaignError::content(
                Place::file(path),
                "a file name that ends in .csv or .csv.gz",
                "one that ends in .mcap",
                "only CSV is read here",
            )),
        }
    }

    fn open_as(path: &Path, gzip: bool, protocol: Protocol) -> Result<CsvRows, CampaignError> {
        let mut reader = ReaderBuilder::new()
            .flexible(true) // a row of another length is reported here, with its line
            .buffer_capacity(1 << 16)
            .from_reader(open(path, gzip)?);
        let header = reader.byte_headers().map_err(|error| unreadable(path, gzip, error, 0))?.clone();
        let layout = Layout::new(header).map_err(|fault| located(path, gzip, 0, *fault))?;
        Ok(CsvRows {
            path: path.to_owned(),
            gzip,
            protocol,
            reader,
            layout,
            record: ByteRecord::new(),
            last_time_s: None,
            whole: Whole::default(),
            done: false,
        })
    }

    /// Appends up to `most` rows; false: the file is at its end, and holds what a run of its protocol must hold.
    fn append(&mut self, to: &mut Recording, most: usize) -> Result<bool, CampaignError> {
        let first = to.len();
        for _ in 0..most {
            let more = self.reader.read_byte_record(&mut self.record);
            let rows = self.whole.rows + (to.len() - first);
            if !more.map_err(|error| unreadable(&self.path, self.gzip, error, rows))? {
                self.whole.count(to, first);
                self.whole.check(self.protocol, Place::file(&self.path).line(2))?;
                return Ok(false);
            }
            if let Err(fault) = self.layout.push_row(&self.record, self.last_time_s, to) {
                let byte = self.record.position().map_or(0, |position| position.byte());
                return Err(located(&self.path, self.gzip, byte, *fault));
            }
            self.last_time_s = to.time_s.last().copied();
        }
        self.whole.count(to, first);
        Ok(true)
    }
}

impl Iterator for CsvRows {
    /// The next rows, at least one.
    type Item = Result<Recording, CampaignError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let mut block = Recording::default();
        match self.append(&mut block, BLOCK_ROWS) {
            Ok(more) => {
                self.done = !more;
                (!block.is_empty()).then_some(Ok(block))
            }
            Err(error) => {
                self.done = true;
                Some(Err(error))
            }
        }
    }
}

/// A fault with the place of the first record at or after this byte of the unpacked file.
fn located(path: &Path, gzip: bool, byte: u64, fault: Fault) -> CampaignError {
    let mut at = Place::file(path).line(line_at(path, gzip, byte));
    at.column = fault.column;
    CampaignError::content(at, fault.expected, fault.got, fault.remedy)
}

/// The file's bytes, unpacked.
fn open(path: &Path, gzip: bool) -> Result<Box<dyn Read>, CampaignError> {
    let file = File::open(path).map_err(|source| CampaignError::read(path, source))?;
    Ok(if gzip { Box::new(MultiGzDecoder::new(BufReader::with_capacity(1 << 16, file))) } else { Box::new(file) })
}

/// An error below the fields: the system's, or a gzip stream that is cut short or damaged.
fn unreadable(path: &Path, gzip: bool, error: csv::Error, rows: usize) -> CampaignError {
    let source = match error.into_kind() {
        csv::ErrorKind::Io(source) => source,
        other => io::Error::new(io::ErrorKind::InvalidData, format!("{other:?}")),
    };
    let damaged = matches!(
        source.kind(),
        io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput
    );
    if gzip && damaged {
        let got = match source.kind() {
            io::ErrorKind::UnexpectedEof => {
                format!("one that is cut short after {rows} complete rows")
            }
            _ => format!("one that is damaged after {rows} complete rows ({source})"),
        };
        let at = Place::file(path).line(rows as u64 + 2);
        return CampaignError::content(at, "a complete gzip stream", got, "copy or pack the file again");
    }
    CampaignError::read(path, source)
}

/// Line (from 1) of the first record at or after this byte of the unpacked file. The CSV parser's own count is off
/// after empty lines and with CRLF.
fn line_at(path: &Path, gzip: bool, byte: u64) -> u64 {
    let Ok(stream) = open(path, gzip) else {
        return 1;
    };
    let mut line = 1;
    let mut before = byte;
    for next in BufReader::with_capacity(1 << 16, stream).bytes() {
        let Ok(next) = next else { break };
        if before == 0 && next != b'\n' && next != b'\r' {
            break;
        }
        line += u64::from(next == b'\n');
        before = before.saturating_sub(1);
    }
    line
}

impl Layout {
    fn new(header: ByteRecord) -> Result<Self, Box<Fault>> {
        let names: Vec<String> =
            header.iter().map(|name| String::from_utf8_lossy(name.trim_ascii()).into_owned()).collect();
        if std::str::from_utf8(header.as_slice()).is_err() {
            return Err(Box::new(Fault {
                column: None,
                expected: "a header line in UTF-8".to_owned(),
                got: quoted(header.as_slice()),
                remedy: "save the file as UTF-8",
            }));
        }
        let mut index = [0; COLUMNS.len()];
        for (column, &name) in COLUMNS.iter().enumerate() {
            let mut found = names.iter().enumerate().filter(|(_, given)| *given == name).map(|(at, _)| at);
            index[column] = found.next().ok_or_else(|| {
                let got = if names.is_empty() {
                    "an empty file".to_owned()
                } else {
                    format!("the columns {}", quoted(names.join(",").as_bytes()))
                };
                let remedy = "add the column; its fields may be empty where the contract allows it";
                Fault::field(column, "this column in the header line", got, remedy)
            })?;
            if let Some(again) = found.next() {
                let got = format!("it as fields {} and {}", index[column] + 1, again + 1);
                return Err(Fault::field(column, "this column once", got, "remove one of them"));
            }
        }
        Ok(Self { index, header })
    }

    /// Appends a row, or leaves the recording with columns of unequal length and says what is wrong.
    fn push_row(&self, record: &ByteRecord, last_time_s: Option<f64>, into: &mut Recording) -> Result<(), Box<Fault>> {
        if record.len() != self.header.len() {
            return Err(Box::new(Fault {
                column: None,
                expected: format!("{} fields, as in the header line", self.header.len()),
                got: record.len().to_string(),
                remedy: "complete the row; a missing value is an empty field between its commas",
            }));
        }
        if std::str::from_utf8(record.as_slice()).is_err() {
            return Err(self.not_utf8(record));
        }
        let field = |column: usize| (column, &record[self.index[column]]);
        let time_s = number(field(0))?;
        if let Some(before) = last_time_s
            && time_s <= before
        {
            let expected = format!("a time after the row before ({before} s)");
            let got = format!("{time_s} s");
            return Err(Fault::field(0, &expected, got, "sort the rows and remove repeated ones"));
        }
        into.time_s.push(time_s);
        into.voltage_v.push(number(field(1))?);
        into.angle_deg.push(measured(field(2))?);
        into.pressure1_bar.push(measured(field(3))?);
        into.pressure2_bar.push(measured(field(4))?);
        into.torque_nm.push(measured(field(5))?);
        into.volume_ml.push(measured(field(6))?);
        into.brake_open.push(valve(field(7))?);
        into.bypass_open.push(valve(field(8))?);
        into.segment.push(integer(field(9))?);
        Ok(())
    }

    fn not_utf8(&self, record: &ByteRecord) -> Box<Fault> {
        let bad = record.iter().position(|field| std::str::from_utf8(field).is_err());
        let name = bad.and_then(|at| self.header.get(at)).map(|name| String::from_utf8_lossy(name).into_owned());
        Box::new(Fault {
            column: name,
            expected: "text in UTF-8".to_owned(),
            got: quoted(bad.map_or(record.as_slice(), |at| &record[at])),
            remedy: "save the file as UTF-8",
        })
    }
}

/// The field as a finite number, in any notation Rust knows, with or without blanks around it.
fn finite(field: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(field).ok()?;
    let value: f64 = text.parse().or_else(|_| text.trim_ascii().parse()).ok()?;
    value.is_finite().then_some(value)
}

fn is_blank(field: &[u8]) -> bool {
    field.trim_ascii().is_empty()
}

fn shown(field: &[u8]) -> String {
    if is_blank(field) { "an empty field".to_owned() } else { quoted(field) }
}

/// A number that is never missing.
fn number((column, field): (usize, &[u8])) -> Result<f64, Box<Fault>> {
    finite(field).ok_or_else(|| Fault::field(column, "a finite number", shown(field), REMEDY_REQUIRED))
}

/// A measured value; NaN where the field is empty.
fn measured((column, field): (usize, &[u8])) -> Result<f64, Box<Fault>> {
    if field.is_empty() {
        return Ok(f64::NAN);
    }
    match finite(field) {
        Some(value) => Ok(value),
        None if is_blank(field) => Ok(f64::NAN),
        None => Err(Fault::field(column, "a finite number or an empty field", quoted(field), REMEDY_MEASURED)),
    }
}

/// Exactly 0 or 1, however it is spelled.
fn valve((column, field): (usize, &[u8])) -> Result<bool, Box<Fault>> {
    match field {
        b"0" => return Ok(false),
        b"1" => return Ok(true),
        _ => {}
    }
    match finite(field) {
        Some(0.0) => Ok(false),
        Some(1.0) => Ok(true),
        _ => Err(Fault::field(column, "0 (closed) or 1 (open)", shown(field), REMEDY_REQUIRED)),
    }
}

/// A whole number, also where it is spelled with a fraction of zero, as spreadsheets do.
fn integer((column, field): (usize, &[u8])) -> Result<i64, Box<Fault>> {
    /// Up to here every whole number has its own f64.
    const EXACT: f64 = 9_007_199_254_740_992.0;
    if let Some(value) = std::str::from_utf8(field).ok().and_then(|text| text.parse().ok()) {
        return Ok(value);
    }
    match finite(field) {
        Some(value) if value.fract() == 0.0 && value.abs() <= EXACT => Ok(value as i64),
        _ => Err(Fault::field(column, "a whole number", shown(field), REMEDY_REQUIRED)),
    }
}
