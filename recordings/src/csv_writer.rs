//! Columns to CSV.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::error::Place;
use crate::part_file::{Existing, PartFile};
use crate::recording::COLUMNS;
use crate::{CampaignError, Recording};

/// Writes the contract's columns; see [`Recording::write_csv`].
pub(crate) fn write(recording: &Recording, path: &Path, gzip: bool) -> Result<(), CampaignError> {
    check(recording, path)?;
    let file = PartFile::create(path, Existing::Replace)?;
    let failed = |source| CampaignError::write(path, source);
    let file = if gzip {
        // No name and no time in the header: the same recording gives the same bytes.
        let mut packer = BufWriter::with_capacity(1 << 16, GzEncoder::new(file, Compression::default()));
        rows(recording, &mut packer).map_err(failed)?;
        let packer = packer.into_inner().map_err(|error| failed(error.into_error()))?;
        packer.finish().map_err(failed)?
    } else {
        let mut file = file;
        rows(recording, &mut file).map_err(failed)?;
        file
    };
    file.commit().map(drop)
}

fn rows(recording: &Recording, to: &mut impl Write) -> io::Result<()> {
    writeln!(to, "{}", COLUMNS.join(","))?;
    for row in 0..recording.len() {
        // `{:?}` gives the shortest text that reads back as the same bits.
        write!(to, "{:?},{:?}", recording.time_s[row], recording.voltage_v[row])?;
        for (_, values) in recording.measured() {
            if values[row].is_nan() {
                to.write_all(b",")?;
            } else {
                write!(to, ",{:?}", values[row])?;
            }
        }
        let valves = (u8::from(recording.brake_open[row]), u8::from(recording.bypass_open[row]));
        writeln!(to, ",{},{},{}", valves.0, valves.1, recording.segment[row])?;
    }
    Ok(())
}

/// Nothing is written that the reader would refuse.
fn check(recording: &Recording, path: &Path) -> Result<(), CampaignError> {
    let rows = recording.len();
    let fault = |row: usize, column: &str, expected: &str, got: String| {
        let at = Place::file(path).line(row as u64 + 2).column(column);
        Err(CampaignError::content(at, expected, got, "correct the recording before it is written"))
    };
    let lengths = [
        ("voltage_v", recording.voltage_v.len()),
        ("angle_deg", recording.angle_deg.len()),
        ("pressure1_bar", recording.pressure1_bar.len()),
        ("pressure2_bar", recording.pressure2_bar.len()),
        ("torque_nm", recording.torque_nm.len()),
        ("volume_ml", recording.volume_ml.len()),
        ("brake_open", recording.brake_open.len()),
        ("bypass_open", recording.bypass_open.len()),
        ("segment", recording.segment.len()),
    ];
    for (column, length) in lengths {
        if length != rows {
            let expected = format!("{rows} values, as many as time_s has");
            return fault(length.min(rows), column, &expected, length.to_string());
        }
    }
    for (column, values) in [("time_s", &recording.time_s), ("voltage_v", &recording.voltage_v)] {
        if let Some(row) = values.iter().position(|value| !value.is_finite()) {
            return fault(row, column, "a finite number", values[row].to_string());
        }
    }
    for (column, values) in recording.measured() {
        if let Some(row) = values.iter().position(|value| value.is_infinite()) {
            return fault(row, column, "a finite number, or NaN for a missing value", values[row].to_string());
        }
    }
    if let Some(row) = recording.time_s.windows(2).position(|pair| pair[1] <= pair[0]) {
        let expected = format!("a time after {} s", recording.time_s[row]);
        return fault(row + 1, "time_s", &expected, format!("{} s", recording.time_s[row + 1]));
    }
    Ok(())
}
