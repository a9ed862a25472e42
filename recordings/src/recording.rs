//! A run as columns.

use std::path::Path;

use crate::{CampaignError, Protocol};

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
    /// protocol. Errors name file, line and column.
    pub fn read(_path: &Path, _protocol: Protocol) -> Result<Recording, CampaignError> {
        todo!("next commit")
    }

    /// Writes the contract's CSV columns; gzip where the name ends in `.gz`. NaN becomes an empty field, and every number
    /// is written so that reading gives the same bits.
    pub fn write_csv(&self, _path: &Path) -> Result<(), CampaignError> {
        todo!("next commit")
    }
}
