//! A run as columns.

use std::path::Path;

use rt_core::{Measurement, Sample};

use crate::alignment::sound;
use crate::error::Place;
use crate::{CampaignError, Protocol, csv_reader, csv_writer, mcap_reader};

/// A run as columns of equal length, one row a sample; NaN = missing value. Units and sign convention as in the
/// contract; voltage and valves of a row act from its time to the next row's, the other columns are the state at its time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Since the run's start, strictly increasing, never NaN.
    pub time_s: Vec<f64>,
    /// Command to the motor amplifier, never NaN.
    pub voltage_v: Vec<f64>,
    /// Absolute encoder, degrees.
    pub angle_deg: Vec<f64>,
    /// Chamber 1 (pump-map: port 1), bar absolute.
    pub pressure1_bar: Vec<f64>,
    /// Chamber 2 (pump-map: port 2), bar absolute.
    pub pressure2_bar: Vec<f64>,
    /// Torque that the clamp holds, Nm; NaN while the lever moves.
    pub torque_nm: Vec<f64>,
    /// Measuring cylinder, ml; its meaning depends on the protocol.
    pub volume_ml: Vec<f64>,
    /// Valve in series with the pump.
    pub brake_open: Vec<bool>,
    /// Valve parallel to the pump.
    pub bypass_open: Vec<bool>,
    /// Counts the set points of the protocol.
    pub segment: Vec<i64>,
}

/// The contract's columns, in the order in which they are written.
pub(crate) const COLUMNS: [&str; 10] = [
    "time_s",
    "voltage_v",
    "angle_deg",
    "pressure1_bar",
    "pressure2_bar",
    "torque_nm",
    "volume_ml",
    "brake_open",
    "bypass_open",
    "segment",
];

impl Recording {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// No rows at all. A recording that was read from a file never is.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Reads `.csv`, `.csv.gz` or `.mcap`, by the file's extension, and checks it against the contract's rules for this
    /// protocol: time strictly increasing, at least one row, no value where one is never missing, and no column empty
    /// throughout that carries what the protocol measures. Errors name file, line (or tick) and column.
    pub fn read(path: &Path, protocol: Protocol) -> Result<Recording, CampaignError> {
        match FileKind::of(path)? {
            FileKind::Csv { gzip } => csv_reader::read(path, gzip, protocol),
            FileKind::Mcap => mcap_reader::read_recording(path, protocol, None),
        }
    }

    /// Writes the contract's CSV columns; gzip where the name ends in `.csv.gz`. NaN becomes an empty field, every number
    /// is written so that reading gives the same bits. Replaces an existing file once the new one is complete.
    ///
    /// # Errors
    /// Columns of unequal length, time that does not increase, a NaN in time or voltage, an infinite value anywhere
    /// (nothing is written that [`Recording::read`] would refuse), another extension, or the system's refusal.
    pub fn write_csv(&self, path: &Path) -> Result<(), CampaignError> {
        match FileKind::of(path)? {
            FileKind::Csv { gzip } => csv_writer::write(self, path, gzip),
            FileKind::Mcap => Err(CampaignError::content(
                Place::file(path),
                "a file name that ends in .csv or .csv.gz",
                "one that ends in .mcap",
                "choose the extension that says what is written",
            )),
        }
    }

    /// The rows of these samples; what a device calls wrong was not measured.
    pub fn of_samples<'a>(samples: impl IntoIterator<Item = &'a Sample>) -> Recording {
        let mut out = Recording::default();
        samples.into_iter().for_each(|s| out.push_sample(s, &sound(s)));
        out
    }

    /// `measured`: what of the sample's measurement its device does not call wrong.
    #[inline]
    pub(crate) fn push_sample(&mut self, sample: &Sample, measured: &Measurement) {
        self.time_s.push(sample.time_s());
        self.voltage_v.push(sample.voltage_v);
        self.angle_deg.push(measured.angle_deg);
        self.pressure1_bar.push(measured.pressure1_bar);
        self.pressure2_bar.push(measured.pressure2_bar);
        self.torque_nm.push(measured.torque_nm);
        self.volume_ml.push(measured.volume_ml);
        self.brake_open.push(sample.brake_open());
        self.bypass_open.push(sample.bypass_open());
        self.segment.push(i64::from(sample.segment));
    }

    /// Appends rows that follow.
    pub(crate) fn append(&mut self, mut rows: Recording) {
        if self.is_empty() {
            *self = rows;
            return;
        }
        self.time_s.append(&mut rows.time_s);
        self.voltage_v.append(&mut rows.voltage_v);
        self.angle_deg.append(&mut rows.angle_deg);
        self.pressure1_bar.append(&mut rows.pressure1_bar);
        self.pressure2_bar.append(&mut rows.pressure2_bar);
        self.torque_nm.append(&mut rows.torque_nm);
        self.volume_ml.append(&mut rows.volume_ml);
        self.brake_open.append(&mut rows.brake_open);
        self.bypass_open.append(&mut rows.bypass_open);
        self.segment.append(&mut rows.segment);
    }

    /// Leaves the first `rows` rows, and gives the others.
    pub(crate) fn split_off(&mut self, rows: usize) -> Recording {
        Recording {
            time_s: self.time_s.split_off(rows),
            voltage_v: self.voltage_v.split_off(rows),
            angle_deg: self.angle_deg.split_off(rows),
            pressure1_bar: self.pressure1_bar.split_off(rows),
            pressure2_bar: self.pressure2_bar.split_off(rows),
            torque_nm: self.torque_nm.split_off(rows),
            volume_ml: self.volume_ml.split_off(rows),
            brake_open: self.brake_open.split_off(rows),
            bypass_open: self.bypass_open.split_off(rows),
            segment: self.segment.split_off(rows),
        }
    }

    /// The columns that hold measured values, by name.
    pub(crate) fn measured(&self) -> [(&'static str, &[f64]); 5] {
        [
            ("angle_deg", &self.angle_deg),
            ("pressure1_bar", &self.pressure1_bar),
            ("pressure2_bar", &self.pressure2_bar),
            ("torque_nm", &self.torque_nm),
            ("volume_ml", &self.volume_ml),
        ]
    }
}

/// What a file of a protocol must hold as a whole: at least one row, and at least one value in each column that carries what the
/// protocol measures. Counted as the rows come.
#[derive(Clone, Debug, Default)]
pub(crate) struct Whole {
    /// Rows so far.
    pub rows: usize,
    /// Whether a value came, column by column as in [`Recording::measured`].
    values: [bool; 5],
}

impl Whole {
    /// The rows of `block` from `first` on.
    pub fn count(&mut self, block: &Recording, first: usize) {
        self.rows += block.len() - first;
        for (seen, (_, values)) in self.values.iter_mut().zip(block.measured()) {
            *seen = *seen || values[first..].iter().any(|value| !value.is_nan());
        }
    }

    /// Whether that is enough. `start` is the place of the first row.
    pub fn check(&self, protocol: Protocol, start: Place) -> Result<(), CampaignError> {
        if self.rows == 0 {
            return Err(CampaignError::content(
                start,
                "at least one sample",
                "none",
                "record the run again or take it out of campaign.toml",
            ));
        }
        for (seen, (column, _)) in self.values.into_iter().zip(Recording::default().measured()) {
            if !seen && carries(protocol, column) {
                return Err(CampaignError::content(
                    start.column(column),
                    format!("at least one value in a run of protocol {protocol}"),
                    format!("no value in any of {} rows", self.rows),
                    "check the sensor and the protocol named in campaign.toml",
                ));
            }
        }
        Ok(())
    }
}

/// Whether a run of this protocol is void where this measured column is empty throughout.
fn carries(protocol: Protocol, column: &str) -> bool {
    match column {
        "angle_deg" => protocol != Protocol::PumpMap,
        "torque_nm" => protocol == Protocol::TorqueMap,
        "volume_ml" => matches!(protocol, Protocol::VolumeMap | Protocol::PumpMap | Protocol::ClampSteps),
        _ => true,
    }
}

/// What a file's extension says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileKind {
    Csv { gzip: bool },
    Mcap,
}

/// The extensions a run may have, for messages.
pub(crate) const EXTENSIONS: &str = ".mcap, .csv or .csv.gz";

impl FileKind {
    /// By the name alone; `None` = not a recording.
    pub(crate) fn of_name(name: &str) -> Option<Self> {
        if name.ends_with(".csv") {
            Some(Self::Csv { gzip: false })
        } else if name.ends_with(".csv.gz") {
            Some(Self::Csv { gzip: true })
        } else if name.ends_with(".mcap") {
            Some(Self::Mcap)
        } else {
            None
        }
    }

    /// By the name of the file.
    pub(crate) fn of(path: &Path) -> Result<Self, CampaignError> {
        let name = path.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
        Self::of_name(&name).ok_or_else(|| {
            let remedy = if name.ends_with(crate::part_file::PART) {
                "this recording was never closed: record the run again, or see what `bench recover` saves"
            } else {
                "name the file by what it is"
            };
            let expected = format!("a file name that ends in {EXTENSIONS}");
            CampaignError::content(Place::file(path), expected, format!("{name:?}"), remedy)
        })
    }
}
