//! `rig.toml`: the device, the facts of the rig, what the supervisor enforces, the safe state.

use crate::controller::Settings as LoopSettings;
use crate::failure::{Failure, Kind};
use crate::setup::Knowledge;
use model::{ModelFile, Parameters};
use profiles::Plane;
use recordings::RigFacts;
use rt_core::{Limits, SafeState};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The rig file of the emulated rig, which is used where none is given; documents every key.
pub const EMULATED: &str = include_str!("../rigs/emulated.toml");

/// A rig, read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Free text.
    pub name: String,
    /// For campaigns, and for voltages as a fraction of u_max.
    pub facts: RigFacts,
    /// What the supervisor enforces, the safe state included.
    pub limits: Limits,
    /// The plant of the emulated rig.
    pub plant: ModelFile,
    /// What the controller knows.
    pub knowledge: Knowledge,
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

/// The limits as they are written; what is left out stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawLimits {
    pressure_min_bar: Option<f64>,
    pressure_max_bar: Option<f64>,
    angle_max_deg: Option<f64>,
    velocity_max_deg_s: Option<f64>,
    velocity_window_ticks: Option<u32>,
    torque_max_nm: Option<f64>,
    missing_max_ticks: Option<u32>,
    age_max_ms: Option<f64>,
    heartbeat_max_ms: Option<f64>,
    voltage_max_v: Option<f64>,
    slew_max_v_s: Option<f64>,
    aftermath_ticks: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawSafeState {
    brake: Option<Valve>,
    bypass: Option<Valve>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Valve {
    Open,
    Closed,
}

impl From<bool> for Valve {
    fn from(open: bool) -> Self {
        if open { Valve::Open } else { Valve::Closed }
    }
}

impl RawLimits {
    /// Everything that is enforced, spelled out.
    pub(crate) fn of(limits: &Limits) -> Self {
        RawLimits {
            pressure_min_bar: Some(limits.pressure_min_bar),
            pressure_max_bar: Some(limits.pressure_max_bar),
            angle_max_deg: Some(limits.angle_max_deg),
            velocity_max_deg_s: Some(limits.velocity_max_deg_s),
            velocity_window_ticks: Some(limits.velocity_window_ticks),
            torque_max_nm: Some(limits.torque_max_nm),
            missing_max_ticks: Some(limits.missing_max_ticks),
            age_max_ms: Some(limits.age_max_ms),
            heartbeat_max_ms: Some(limits.heartbeat_max_ms),
            voltage_max_v: Some(limits.voltage_max_v),
            slew_max_v_s: Some(limits.slew_max_v_s),
            aftermath_ticks: Some(limits.aftermath_ticks),
        }
    }

    /// These limits over `defaults`.
    pub(crate) fn over(self, defaults: Limits) -> Limits {
        Limits {
            pressure_min_bar: self.pressure_min_bar.unwrap_or(defaults.pressure_min_bar),
            pressure_max_bar: self.pressure_max_bar.unwrap_or(defaults.pressure_max_bar),
            angle_max_deg: self.angle_max_deg.unwrap_or(defaults.angle_max_deg),
            velocity_max_deg_s: self.velocity_max_deg_s.unwrap_or(defaults.velocity_max_deg_s),
            velocity_window_ticks: self.velocity_window_ticks.unwrap_or(defaults.velocity_window_ticks),
            torque_max_nm: self.torque_max_nm.unwrap_or(defaults.torque_max_nm),
            missing_max_ticks: self.missing_max_ticks.unwrap_or(defaults.missing_max_ticks),
            age_max_ms: self.age_max_ms.unwrap_or(defaults.age_max_ms),
            heartbeat_max_ms: self.heartbeat_max_ms.unwrap_or(defaults.heartbeat_max_ms),
            voltage_max_v: self.voltage_max_v.unwrap_or(defaults.voltage_max_v),
            slew_max_v_s: self.slew_max_v_s.unwrap_or(defaults.slew_max_v_s),
            aftermath_ticks: self.aftermath_ticks.unwrap_or(defaults.aftermath_ticks),
            safe_state: defaults.safe_state,
        }
    }
}

impl RawSafeState {
    pub(crate) fn of(state: SafeState) -> Self {
        RawSafeState { brake: Some(state.brake_open.into()), bypass: Some(state.bypass_open.into()) }
    }

    pub(crate) fn over(self, defaults: SafeState) -> SafeState {
        let open = |valve: Option<Valve>, default| valve.map_or(default, |valve| valve == Valve::Open);
        SafeState {
            brake_open: open(self.brake, defaults.brake_open),
            bypass_open: open(self.bypass, defaults.bypass_open),
        }
    }
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
        Ok(Rig { name: raw.name.unwrap_or_else(|| "rig".to_owned()), facts, limits, plant, knowledge })
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
