//! `rig.toml`: the device, the facts of the rig, what the supervisor enforces, the safe state.

mod limits;

pub(crate) use limits::{RawLimits, RawSafeState};

use crate::controller::Settings as LoopSettings;
use crate::failure::{Failure, Kind};
use crate::setup::Knowledge;
use model::{ModelFile, Parameters};
use profiles::Plane;
use recordings::RigFacts;
use rt_core::Limits;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The rig file of the emulated rig, which is used where none is given; documents every key.
pub const EMULATED: &str = include_str!("../../rigs/emulated.toml");

/// A rig, read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Free text.
    pub name: String,
    /// For campaigns, and for voltages as a fraction of u_max.
    pub facts: RigFacts,
    /// What the supervisor enforces, the safe state included.
    pub limits: Limits,
    /// What the loop drives.
    pub device: DeviceSpec,
    /// What the controller knows.
    pub knowledge: Knowledge,
}

/// What the loop drives.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceSpec {
    /// The emulated rig with this plant, in this process.
    Emulated(Box<ModelFile>),
    /// A rig on real wires. Paths are joined to the rig file's folder; everything is checked that can be without hardware, the
    /// budget of both wires included.
    Wired(Box<drivers::wired::Settings>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRig {
    name: Option<String>,
    #[serde(default)]
    device: RawDevice,
    rig: Option<RawFacts>,
    controller: Option<RawController>,
    #[serde(default)]
    limits: RawLimits,
    #[serde(default)]
    safe_state: RawSafeState,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDevice {
    #[serde(default)]
    kind: DeviceKind,
    model: Option<PathBuf>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum DeviceKind {
    #[default]
    Emulated,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFacts {
    inertia_kg_m2: f64,
    gravity_nm: f64,
    u_max_v: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawController {
    model: Option<PathBuf>,
    #[serde(default)]
    loops: LoopSettings,
}

impl Rig {
    /// The rig of this file, or the emulated one.
    ///
    /// # Errors
    /// File, line, what was expected and what came (2).
    pub fn read(path: Option<&Path>) -> Result<Rig, Failure> {
        let Some(path) = path else { return Rig::parse(EMULATED, "the built-in rig file", Path::new("")) };
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| {
            Failure::new(Kind::Input, format!("{file}: expected a rig file, got \"{error}\"; check the path"))
        })?;
        Rig::parse(&text, &file, path.parent().unwrap_or(Path::new("")))
    }

    /// The rig of this text; `file` is for messages, models are looked for in `folder`.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Rig, Failure> {
        let input = |what: String| Failure::new(Kind::Input, format!("{file}: {what}"));
        let raw: RawRig = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| text[..span.start.min(text.len())].matches('\n').count() + 1);
            input(format!("line {line}: {}", error.message()))
        })?;
        let model = |path: &PathBuf| ModelFile::read(&folder.join(path)).map_err(|e| Failure::of(Kind::Input, &e));
        let DeviceKind::Emulated = raw.device.kind;
        let plant = match &raw.device.model {
            Some(path) => model(path)?,
            None => ModelFile::plain(Parameters::example()),
        };
        let facts = match raw.rig {
            Some(RawFacts { inertia_kg_m2, gravity_nm, u_max_v }) => RigFacts { inertia_kg_m2, gravity_nm, u_max_v },
            None => {
                let Parameters { load, pump, .. } = plant.parameters;
                RigFacts { inertia_kg_m2: load.J, gravity_nm: load.G, u_max_v: pump.u_max }
            }
        };
        let positive = [("inertia_kg_m2", facts.inertia_kg_m2), ("u_max_v", facts.u_max_v)];
        if let Some((key, got)) = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return Err(input(format!("[rig] {key}: expected a finite number above 0, got {got}")));
        }
        if !(facts.gravity_nm.is_finite() && facts.gravity_nm >= 0.0) {
            return Err(input(format!(
                "[rig] gravity_nm: expected a finite number, 0 or more, got {}",
                facts.gravity_nm
            )));
        }
        // A fraction of u_max may round up in its last digit.
        let defaults = Limits { voltage_max_v: facts.u_max_v * (1.0 + 1e-9), ..Limits::default() };
        let limits = Limits { safe_state: raw.safe_state.over(defaults.safe_state), ..raw.limits.over(defaults) };
        // The plant of the emulated rig is known; its effects are what nobody knows.
        let (controller_model, loops) = match raw.controller {
            Some(RawController { model: Some(path), loops }) => (model(&path)?, loops),
            Some(RawController { model: None, loops }) => (ModelFile::plain(plant.parameters), loops),
            None => (ModelFile::plain(plant.parameters), LoopSettings::default()),
        };
        let knowledge = Knowledge::Model(controller_model, loops);
        for plane in [Plane::Horizontal, Plane::Vertical] {
            knowledge.controller(plane).map_err(|failure| input(format!("[controller] {failure}")))?;
        }
        limits.validate().map_err(|error| input(format!("[limits] {error}")))?;
        let device = DeviceSpec::Emulated(Box::new(plant));
        Ok(Rig { name: raw.name.unwrap_or_else(|| "rig".to_owned()), facts, limits, device, knowledge })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Rig, Failure> {
        Rig::parse(text, "rig.toml", Path::new(""))
    }

    #[test]
    fn the_built_in_file_says_what_is_the_case_without_it() {
        let documented = Rig::read(None).expect("the built-in file is sound");
        let mut bare = parse("name = \"emulated rig\"").expect("every key is optional");
        // The one key that depends on another: left out, it is u_max.
        assert!((bare.limits.voltage_max_v - bare.facts.u_max_v).abs() < 1e-6);
        bare.limits.voltage_max_v = documented.limits.voltage_max_v;
        assert_eq!(documented, bare);
    }

    #[test]
    fn the_built_in_file_names_every_limit() {
        let all = toml::to_string(&RawLimits::of(&Limits::default())).expect("plain numbers");
        for line in all.lines() {
            let key = line.split(' ').next().unwrap_or_default();
            assert!(EMULATED.contains(&format!("\n{key} = ")), "{key}");
        }
    }

    #[test]
    fn limits_survive_being_written_and_read() {
        let limits = Limits { slew_max_v_s: f64::INFINITY, pressure_max_bar: 1.0 / 3.0 + 5.0, ..Limits::default() };
        let text = toml::to_string(&RawLimits::of(&limits)).expect("plain numbers");
        let read: RawLimits = toml::from_str(&text).expect("as written");
        assert_eq!(read.over(Limits::default()), limits);
    }

    #[test]
    fn a_bad_file_is_named_with_line_and_reason() {
        for (text, expected) in [
            ("name = \"a\"\n[limits]\npresure_max_bar = 3.0\n", "rig.toml: line 3"),
            ("[limits]\npressure_max_bar = 0.1\n", "above pressure_min_bar"),
            ("[safe_state]\nbrake = \"ajar\"\n", "line 2"),
            ("[rig]\ninertia_kg_m2 = 0.0\ngravity_nm = 1\nu_max_v = 24\n", "inertia_kg_m2"),
            ("[device]\nkind = \"can\"\n", "line 2"),
            ("[device]\nmodel = \"nowhere.toml\"\n", "nowhere.toml"),
        ] {
            let failure = parse(text).expect_err(text);
            assert_eq!(failure.exit_code(), 2);
            assert!(failure.message.contains(expected), "{text}: {failure}");
        }
    }
}
