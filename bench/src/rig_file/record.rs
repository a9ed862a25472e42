//! What a recording keeps of the rig: the files that describe it, and its calibration as it was understood.
//!
//! The plant of an emulated rig is not among them: a recording holds what the bench knows of its rig, not what the rig is.

use super::understood::{Mapped, Understood};
use super::{DeviceSpec, RawLimits, RawSafeState, Rig};
use crate::failure::{Failure, Kind};
use drivers::dbc::Database;
use recordings::RigFacts;
use rt_core::Limits;
use serde::Serialize;
use std::collections::BTreeMap;

/// Name of the rig file among a recording's files.
pub const RIG_FILE: &str = "rig.toml";
/// Name of the CAN database among a recording's files.
pub const DBC_FILE: &str = "rig.dbc";

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RigRecord {
    /// [`RIG_FILE`], and where the rig is on wires [`DBC_FILE`]: the text by the name.
    pub files: BTreeMap<String, String>,
    /// Scale of the amplifier, and gain and offset of every channel on the bus with the signal that they act on, as TOML; empty where nothing
    /// is calibrated.
    pub calibration: String,
}

#[derive(Serialize)]
struct Calibration<'a> {
    amplifier: AmplifierScale<'a>,
    channel: Vec<&'a Mapped>,
}

#[derive(Serialize)]
struct AmplifierScale<'a> {
    protocol: &'a str,
    /// Voltage at a duty of 1.
    full_scale_v: f64,
    reversed: bool,
}

#[derive(Serialize)]
struct Written<'a> {
    name: &'a str,
    device: BTreeMap<&'a str, &'a str>,
    rig: BTreeMap<&'a str, f64>,
    limits: RawLimits,
    safe_state: RawSafeState,
}

impl Rig {
    /// What a recording keeps of it.
    ///
    /// # Errors
    /// A database that is no longer what it was when the rig was read (2).
    pub fn record(&self) -> Result<RigRecord, Failure> {
        let mut files = BTreeMap::from([(RIG_FILE.to_owned(), self.text.clone())]);
        let DeviceSpec::Wired(settings) = &self.device else {
            return Ok(RigRecord { files, calibration: String::new() });
        };
        let database = Database::read(&settings.can.dbc).map_err(|e| Failure::of(Kind::Input, &e))?;
        files.insert(DBC_FILE.to_owned(), database.text().to_owned());
        let understood = Understood::of(self)?;
        let amplifier = &settings.amplifier;
        let calibration = Calibration {
            amplifier: AmplifierScale {
                protocol: &amplifier.protocol,
                full_scale_v: amplifier.full_scale_v,
                reversed: amplifier.reversed,
            },
            channel: understood.mapping.iter().filter(|mapped| mapped.gain.is_some()).collect(),
        };
        let head = "# value of a channel = gain * signal + offset, the signal as the database scales it\n";
        let text = toml::to_string(&calibration).expect("plain numbers and texts always have a TOML form");
        Ok(RigRecord { files, calibration: format!("{head}{text}") })
    }
}

impl RigRecord {
    /// Of an emulated rig that no file describes: a rig file that says what was known of it.
    pub fn of_emulated(name: &str, facts: &RigFacts, limits: &Limits) -> RigRecord {
        let RigFacts { inertia_kg_m2, gravity_nm, u_max_v } = *facts;
        let written = Written {
            name,
            device: [("kind", "emulated")].into(),
            rig: [("inertia_kg_m2", inertia_kg_m2), ("gravity_nm", gravity_nm), ("u_max_v", u_max_v)].into(),
            limits: RawLimits::of(limits),
            safe_state: RawSafeState::of(limits.safe_state),
        };
        let text = toml::to_string(&written).expect("plain numbers and texts always have a TOML form");
        RigRecord { files: [(RIG_FILE.to_owned(), text)].into(), calibration: String::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_rig_on_wires_is_kept_with_its_database_and_its_calibration() {
        let rigs = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs");
        let file = rigs.join("wired.toml");
        let record = Rig::read(Some(&file)).and_then(|rig| rig.record()).expect("a sound rig file");
        let text = std::fs::read_to_string(&file).expect("the same file");
        assert_eq!(record.files[RIG_FILE], text);
        let calibration: toml::Table = record.calibration.parse().expect("TOML");
        let written: toml::Table = text.parse().expect("TOML");
        let dbc = written["can"]["dbc"].as_str().expect("a path");
        assert_eq!(record.files[DBC_FILE], std::fs::read_to_string(rigs.join(dbc)).expect("its database"));
        assert_eq!(calibration["amplifier"]["full_scale_v"], written["amplifier"]["full_scale_v"]);
        let sensors = written["can"]["sensors"].as_table().expect("a table");
        let channels = calibration["channel"].as_array().expect("a list");
        assert_eq!(channels.len(), sensors.len());
        for channel in channels {
            let sensor = &sensors[channel["key"].as_str().expect("a name")];
            let signal =
                format!("{}.{}", channel["message"].as_str().unwrap_or(""), channel["signal"].as_str().unwrap_or(""));
            assert_eq!(sensor["signal"].as_str(), Some(signal.as_str()));
            for (key, default) in [("gain", 1.0), ("offset", 0.0)] {
                let written = sensor.get(key).and_then(toml::Value::as_float).unwrap_or(default);
                assert_eq!(channel[key].as_float(), Some(written), "{key} of {signal}");
            }
        }
    }

    #[test]
    fn an_emulated_rig_that_no_file_describes_is_kept_as_one_that_can_be_read() {
        let facts = RigFacts { inertia_kg_m2: 1.0 / 3.0, gravity_nm: 0.7, u_max_v: 12.0 };
        let limits = Limits { pressure_min_bar: 0.3, voltage_max_v: 12.5, ..Limits::default() };
        let record = RigRecord::of_emulated("emulated rig, seed 3", &facts, &limits);
        let rig = Rig::parse(&record.files[RIG_FILE], RIG_FILE, Path::new("")).expect("a sound rig file");
        assert_eq!((rig.name.as_str(), rig.facts, rig.limits), ("emulated rig, seed 3", facts, limits));
        assert_eq!(rig.record().expect("no wires"), record);
    }
}
