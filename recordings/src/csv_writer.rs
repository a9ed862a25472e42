//! Columns to CSV.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::error::Place;
use crate::part_file::{Existing, PartFile};
use crate::recording::COLUMNS;
use crate::{CampaignError, Recording};

/// Writes the contract's columns; see [`Recording::write_csv`].
pub(crate) fn write(recording: &Recording, path: &Path, gzip: bool) -> Result<(), CampaignError> {
    // Before the file that is to be replaced is touched.
    check(recording, path, 0, None)?;
    let file = PartFile::create(path, Existing::Replace)?;
    let failed = |source| CampaignError::write(path, source);
    let file = if gzip {
        // No name and no time in the header: the same recording gives the same bytes.
        let packer = BufWriter::with_capacity(1 << 16, GzEncoder::new(file, Compression::default()));
        let packer = rows(recording, packer, path)?;
        let packer = packer.into_inner().map_err(|error| failed(error.into_error()))?;
        packer.finish().map_err(failed)?
    } else {
        rows(recording, file, path)?
    };
    file.commit().map(drop)
}

fn rows<W: Write>(recording: &Recording, to: W, path: &Path) -> Result<W, CampaignError> {
    let mut writer = CsvWriter::new(to, path)?;
    writer.write(recording)?;
    Ok(writer.into_inner())
}

/// Writes the contract's columns block by block; memory holds one block's text at most. NaN becomes an empty field, every number is
/// the shortest text that reads back as the same bits.
pub struct CsvWriter<W> {
    to: W,
    path: PathBuf,
    text: Vec<u8>,
    rows: u64,
    last_time_s: Option<f64>,
}

impl<W: Write> CsvWriter<W> {
    /// Text that is collected before it is handed on, bytes.
    const TEXT: usize = 1 << 16;

    /// Writes the header line. `path` is for messages only.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn new(to: W, path: &Path) -> Result<Self, CampaignError> {
        let mut text = Vec::with_capacity(Self::TEXT + 1024);
        text.extend_from_slice(COLUMNS.join(",").as_bytes());
        text.push(b'\n');
        let mut writer = CsvWriter { to, path: path.to_owned(), text, rows: 0, last_time_s: None };
        writer.hand_on()?;
        Ok(writer)
    }

    /// Appends rows.
    ///
    /// # Errors
    /// What no reader would take: columns of unequal length, time that does not increase, a NaN in time or voltage, an infinite
    /// value. The system's refusal.
    pub fn write(&mut self, block: &Recording) -> Result<(), CampaignError> {
        check(block, &self.path, self.rows, self.last_time_s)?;
        for row in 0..block.len() {
            push_number(&mut self.text, block.time_s[row]);
            self.text.push(b',');
            push_number(&mut self.text, block.voltage_v[row]);
            for (_, values) in block.measured() {
                self.text.push(b',');
                if !values[row].is_nan() {
                    push_number(&mut self.text, values[row]);
                }
            }
            for open in [block.brake_open[row], block.bypass_open[row]] {
                self.text.extend_from_slice(if open { b",1" } else { b",0" });
            }
            self.text.push(b',');
            push_integer(&mut self.text, block.segment[row]);
            self.text.push(b'\n');
            if self.text.len() >= Self::TEXT {
                self.hand_on()?;
            }
        }
        self.rows += block.len() as u64;
        self.last_time_s = block.time_s.last().copied().or(self.last_time_s);
        self.hand_on()
    }

    /// What was written to; nothing is held back.
    pub fn into_inner(self) -> W {
        self.to
    }

    fn hand_on(&mut self) -> Result<(), CampaignError> {
        let taken = self.to.write_all(&self.text);
        self.text.clear();
        taken.map_err(|source| CampaignError::write(&self.path, source))
    }
}

/// Appends the shortest decimal text that reads back as the same bits, in the notation of `{:?}`. `value` is finite. (Where two texts of
/// the same length lie equally near, `{:?}` may take the other one.)
pub fn push_number(text: &mut Vec<u8>, value: f64) {
    let magnitude = value.abs();
    // Where other notations begin is up to a library; these are `{:?}`'s.
    if magnitude == 0.0 || (1e-4..1e15).contains(&magnitude) {
        text.extend_from_slice(zmij::Buffer::new().format_finite(value).as_bytes());
    } else {
        write!(text, "{value:?}").expect("a Vec grows as far as a text needs");
    }
}

/// Appends a whole number.
pub fn push_integer(text: &mut Vec<u8>, value: i64) {
    match u8::try_from(value) {
        Ok(digit @ 0..=9) => text.push(b'0' + digit),
        _ => write!(text, "{value}").expect("a Vec grows as far as a text needs"),
    }
}

/// Nothing is written that the reader would refuse. `rows`: that stand before this block; `last_time_s`: of the last of them.
fn check(block: &Recording, path: &Path, rows: u64, last_time_s: Option<f64>) -> Result<(), CampaignError> {
    let length = block.len();
    let fault = |row: usize, column: &str, expected: &str, got: String| {
        let at = Place::file(path).line(rows + row as u64 + 2).column(column);
        Err(CampaignError::content(at, expected, got, "correct the recording before it is written"))
    };
    let lengths = [
        ("voltage_v", block.voltage_v.len()),
        ("angle_deg", block.angle_deg.len()),
        ("pressure1_bar", block.pressure1_bar.len()),
        ("pressure2_bar", block.pressure2_bar.len()),
        ("torque_nm", block.torque_nm.len()),
        ("volume_ml", block.volume_ml.len()),
        ("brake_open", block.brake_open.len()),
        ("bypass_open", block.bypass_open.len()),
        ("segment", block.segment.len()),
    ];
    for (column, values) in lengths {
        if values != length {
            let expected = format!("{length} values, as many as time_s has");
            return fault(values.min(length), column, &expected, values.to_string());
        }
    }
    for (column, values) in [("time_s", &block.time_s), ("voltage_v", &block.voltage_v)] {
        if let Some(row) = values.iter().position(|value| !value.is_finite()) {
            return fault(row, column, "a finite number", values[row].to_string());
        }
    }
    for (column, values) in block.measured() {
        if let Some(row) = values.iter().position(|value| value.is_infinite()) {
            return fault(row, column, "a finite number, or NaN for a missing value", values[row].to_string());
        }
    }
    let mut before = last_time_s;
    for (row, &time_s) in block.time_s.iter().enumerate() {
        if let Some(before) = before
            && time_s <= before
        {
            return fault(row, "time_s", &format!("a time after {before} s"), format!("{time_s} s"));
        }
        before = Some(time_s);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn written(value: f64) -> String {
        let mut text = Vec::new();
        push_number(&mut text, value);
        String::from_utf8(text).expect("digits")
    }

    /// Reads back as the same bits, and no longer or otherwise written than Rust does.
    fn is_well_written(value: f64) -> bool {
        let (text, rusts) = (written(value), format!("{value:?}"));
        let same_bits = text.parse::<f64>().is_ok_and(|back| back.to_bits() == value.to_bits());
        let kinds = |text: &str| text.replace(|c: char| c.is_ascii_digit(), "0");
        same_bits && kinds(&text) == kinds(&rusts)
    }

    #[test]
    fn the_ends_of_the_plain_notation_are_those_of_rust() {
        for value in [0.0, 1.0, 1e-4, 1e-5, 9.999e-5, 1e15, 1e16, 123456789012345680.0, 5e-324, f64::MAX, 0.1 + 0.2] {
            for value in [value, -value, value.next_up(), value.next_down()] {
                if value.is_finite() {
                    assert_eq!(written(value), format!("{value:?}"));
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn a_number_is_written_as_rust_writes_it(bits in any::<u64>()) {
            let value = f64::from_bits(bits);
            prop_assume!(value.is_finite());
            prop_assert!(is_well_written(value), "{} {value:?}", written(value));
        }

        #[test]
        fn so_are_numbers_of_usual_size(value in -1e4f64..1e4, digits in 0i32..9) {
            let rounded = (value * 10f64.powi(digits)).round() / 10f64.powi(digits);
            for value in [value, rounded, rounded * 1e-9] {
                prop_assert!(is_well_written(value), "{} {value:?}", written(value));
            }
        }

        #[test]
        fn whole_numbers_too(value in any::<i64>(), small in -20i64..20) {
            for value in [value, small] {
                let mut text = Vec::new();
                push_integer(&mut text, value);
                prop_assert_eq!(String::from_utf8(text).expect("digits"), value.to_string());
            }
        }
    }
}
