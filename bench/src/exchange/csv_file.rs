//! Tables as CSV, packed with gzip where the name ends in `.csv.gz`. The contract's columns are written by the recordings' own writer.

use super::content::Content;
use super::output::{Output, unwritten};
use super::source::Source;
use super::table::{Block, Column, Values};
use crate::failure::{Failure, Kind};
use flate2::Compression;
use flate2::write::GzEncoder;
use recordings::{CsvWriter, Recording, push_integer, push_number};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Text that is collected before it is handed on, bytes.
const TEXT: usize = 1 << 16;

/// Writes one table of a run.
///
/// # Errors
/// The target exists, the run can't be read to its end, the system refuses (2). Nothing is left behind.
pub fn write(source: &Source, content: Content, target: &Path) -> Result<PathBuf, Failure> {
    let to = Stream::create(target)?;
    let to = if content == Content::Rows { rows(source, to, target)? } else { table(source, content, to, target)? };
    to.commit(target)
}

/// Writes the contract's columns of a run that stands in memory.
///
/// # Errors
/// The target exists, the run is none that a reader would take, the system refuses (2). Nothing is left behind.
pub fn write_run(run: &Recording, target: &Path) -> Result<PathBuf, Failure> {
    let failed = |e| Failure::of(Kind::Input, &e);
    let mut writer = CsvWriter::new(Stream::create(target)?, target).map_err(failed)?;
    writer.write(run).map_err(failed)?;
    writer.into_inner().commit(target)
}

type Packer = BufWriter<GzEncoder<Output>>;

fn packer(output: Output) -> Packer {
    BufWriter::with_capacity(TEXT, GzEncoder::new(output, Compression::default()))
}

enum Stream {
    Plain(Output),
    Packed(Packer),
}

impl Stream {
    fn create(target: &Path) -> Result<Stream, Failure> {
        let output = Output::create(target)?;
        let gzip = target.to_string_lossy().ends_with(".gz");
        // No name and no time in the header: the same recording gives the same bytes.
        Ok(if gzip { Stream::Packed(packer(output)) } else { Stream::Plain(output) })
    }

    fn commit(self, target: &Path) -> Result<PathBuf, Failure> {
        let output = match self {
            Stream::Plain(output) => output,
            Stream::Packed(packer) => packer
                .into_inner()
                .map_err(io::IntoInnerError::into_error)
                .and_then(GzEncoder::finish)
                .map_err(|e| unwritten(target, &e))?,
        };
        output.commit()
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Stream::Plain(to) => to.write(bytes),
            Stream::Packed(to) => to.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Stream::Plain(to) => to.flush(),
            Stream::Packed(to) => to.flush(),
        }
    }
}

fn rows(source: &Source, to: Stream, target: &Path) -> Result<Stream, Failure> {
    let failed = |e| Failure::of(Kind::Input, &e);
    let mut writer = CsvWriter::new(to, target).map_err(failed)?;
    for block in source.rows()? {
        writer.write(&block.map_err(failed)?).map_err(failed)?;
    }
    Ok(writer.into_inner())
}

fn table(source: &Source, content: Content, mut to: Stream, target: &Path) -> Result<Stream, Failure> {
    let refused = |e: io::Error| unwritten(target, &e);
    let mut text = head(&content.columns());
    for block in source.blocks(content)? {
        let block = block.map_err(|e| Failure::of(Kind::Input, &e))?;
        for row in 0..block.rows() {
            push_row(&mut text, &block, row);
            if text.len() >= TEXT {
                to.write_all(&text).map_err(refused)?;
                text.clear();
            }
        }
    }
    to.write_all(&text).map_err(refused)?;
    Ok(to)
}

fn head(columns: &[Column]) -> Vec<u8> {
    let names: Vec<_> = columns.iter().map(|column| column.name).collect();
    let mut text = names.join(",").into_bytes();
    text.push(b'\n');
    text
}

fn push_row(text: &mut Vec<u8>, block: &Block, row: usize) {
    for (column, values) in block.values.iter().enumerate() {
        if column > 0 {
            text.push(b',');
        }
        match values {
            Values::Number(values) if values[row].is_nan() => {}
            Values::Number(values) => push_number(text, values[row]),
            Values::Natural(values) => {
                write!(text, "{}", values[row]).expect("a Vec grows as far as a text needs");
            }
            Values::Integer(values) => push_integer(text, values[row]),
            Values::Flag(values) => text.push(if values[row] { b'1' } else { b'0' }),
            Values::Text(values) => push_text(text, &values[row]),
        }
    }
    text.push(b'\n');
}

/// In quotes where it must be (RFC 4180).
fn push_text(text: &mut Vec<u8>, value: &str) {
    if value.contains([',', '"', '\n', '\r']) {
        text.push(b'"');
        text.extend_from_slice(value.replace('"', "\"\"").as_bytes());
        text.push(b'"');
    } else {
        text.extend_from_slice(value.as_bytes());
    }
}
