//! `rig.toml`: the device and its wires, the facts of the rig, what the supervisor enforces, the safe state, the budget of the wires.
//!
//! Everything that can be checked without hardware is checked when the file is read, and all that is wrong is said at once.

mod document;
mod limits;
mod problems;
mod record;
mod schema;
mod signals;
#[cfg(test)]
mod tests;
mod understood;
mod units;
mod wires;

pub(crate) use limits::{RawLimits, RawSafeState};
pub use record::{DBC_FILE, RIG_FILE, RigRecord};
pub use understood::{Mapped, Part, Understood, Wire};

use crate::controller::Settings as LoopSettings;
use crate::failure::{Failure, Kind};
use crate::setup::Knowledge;
use crate::simulation::added_effects;
use document::{Document, label, table_label};
use drivers::wired::{AmplifierSettings, CanSettings, Settings};
use model::{ModelFile, Parameters};
use problems::Problems;
use profiles::Plane;
use recordings::RigFacts;
use rt_core::Limits;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use wires::Wires;

/// The rig file of the emulated rig, which is used where none is given; documents every key but those of the wires.
pub const EMULATED: &str = include_str!("../../rigs/emulated.toml");

/// A rig file of a wired rig; documents every key of the wires.
pub const WIRED: &str = include_str!("../../rigs/wired.toml");

/// Share of a wire that a rig may use where its file does not say another.
pub const MOST_SHARE: f64 = 0.8;

/// A rig, read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Text of the file, as it was read.
    pub text: String,
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
    /// The file names the controller's model. Where it does not, an emulated rig's controller knows its plant, which a campaign must not.
    pub names_model: bool,
    /// Settings of the loops, for whatever model.
    pub loops: LoopSettings,
    /// Largest share of each wire that its budget may take, above 0, at most 1.
    pub most_share: f64,
}

/// What the loop drives.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceSpec {
    /// The emulated rig with this plant, in this process.
    Emulated(Box<ModelFile>),
    /// A rig on real wires. Paths are joined to the rig file's folder; everything is checked that can be without hardware, the
    /// budget of both wires included.
    Wired(Box<Settings>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRig {
    name: Option<String>,
    #[serde(default)]
    device: RawDevice,
    rig: Option<RawFacts>,
    #[serde(default)]
    controller: RawController,
    #[serde(default)]
    limits: RawLimits,
    #[serde(default)]
    safe_state: RawSafeState,
    amplifier: Option<AmplifierSettings>,
    can: Option<CanSettings>,
    #[serde(default)]
    budget: RawBudget,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDevice {
    #[serde(default)]
    kind: DeviceKind,
    model: Option<PathBuf>,
}

#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum DeviceKind {
    #[default]
    Emulated,
    Wired,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFacts {
    inertia_kg_m2: f64,
    gravity_nm: f64,
    u_max_v: f64,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawController {
    model: Option<PathBuf>,
    #[serde(default)]
    loops: LoopSettings,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBudget {
    most_share: Option<f64>,
}

impl Rig {
    /// The rig of this file, or the emulated one.
    ///
    /// # Errors
    /// File, line, what was expected and what came, for everything that is wrong (2).
    pub fn read(path: Option<&Path>) -> Result<Rig, Failure> {
        let Some(path) = path else { return Rig::parse(EMULATED, "the built-in rig file", Path::new("")) };
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| {
            Failure::new(Kind::Input, format!("{file}: expected a rig file, got \"{error}\"; check the path"))
        })?;
        Rig::parse(&text, &file, path.parent().unwrap_or(Path::new("")))
    }

    /// The rig of this text; `file` is for messages, models and database are looked for in `folder`.
    ///
    /// # Errors
    /// Those of [`Rig::read`].
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Rig, Failure> {
        let mut problems = Problems::default();
        let rig = Document::read(text, &mut problems).and_then(|document| {
            match RawRig::deserialize(document.table.clone()) {
                Ok(raw) => Some(Builder { document: &document, folder, problems: &mut problems }.rig(raw)),
                // The list of keys lets pass what the types do not: it is said all the same.
                Err(error) => {
                    problems.add(0, error.message());
                    None
                }
            }
        });
        problems.judge(file)?;
        let rig = rig.map(|rig| Rig { text: text.to_owned(), ..rig });
        rig.ok_or_else(|| Failure::new(Kind::Internal, format!("{file}: refused without a reason")))
    }
}

/// Makes a rig of what was written; what does not go together is noted.
struct Builder<'a> {
    document: &'a Document,
    folder: &'a Path,
    problems: &'a mut Problems,
}

impl Builder<'_> {
    fn rig(mut self, raw: RawRig) -> Rig {
        let kind_known = !self.document.refused("device.kind");
        let wired = raw.device.kind == DeviceKind::Wired;
        if kind_known {
            self.sections(wired, &raw);
        }
        let plant = match (&raw.device.model, wired) {
            (Some(path), false) => self.model(path, "device.model"),
            _ => None,
        };
        let plant = plant.unwrap_or_else(|| ModelFile::plain(Parameters::example()));
        let facts = match raw.rig {
            Some(RawFacts { inertia_kg_m2, gravity_nm, u_max_v }) => RigFacts { inertia_kg_m2, gravity_nm, u_max_v },
            None => {
                let Parameters { load, pump, .. } = plant.parameters;
                RigFacts { inertia_kg_m2: load.J, gravity_nm: load.G, u_max_v: pump.u_max }
            }
        };
        // A fraction of u_max may round up in its last digit. What the file says wrongly has been said.
        let u_max_v = if facts.u_max_v.is_finite() { facts.u_max_v } else { plant.parameters.pump.u_max };
        let defaults = Limits { voltage_max_v: u_max_v * (1.0 + 1e-9), ..Limits::default() };
        let limits = Limits { safe_state: raw.safe_state.over(defaults.safe_state), ..raw.limits.over(defaults) };
        if let Err(error) = limits.validate() {
            self.problem(&format!("limits.{}", error.field), format!("expected {}, got {}", error.expected, error.got));
        }
        let (names_model, loops) = (raw.controller.model.is_some(), raw.controller.loops);
        let knowledge = self.knowledge(raw.controller, &plant, wired);
        let most_share = raw.budget.most_share.unwrap_or(MOST_SHARE);

        let device = match (raw.amplifier, raw.can) {
            (Some(amplifier), Some(mut can)) if wired => {
                if !can.dbc.as_os_str().is_empty() {
                    can.dbc = self.folder.join(&can.dbc);
                }
                let settings = Settings { amplifier, can };
                let u_max_v = raw.rig.map(|facts| facts.u_max_v);
                let Builder { document, problems, .. } = self;
                Wires { settings: &settings, limits: &limits, u_max_v, most_share, document, problems }.check();
                DeviceSpec::Wired(Box::new(settings))
            }
            _ => DeviceSpec::Emulated(Box::new(plant)),
        };
        let (text, name) = (String::new(), raw.name.unwrap_or_else(|| "rig".to_owned()));
        Rig { text, name, facts, limits, device, knowledge, names_model, loops, most_share }
    }

    fn problem(&mut self, path: &str, what: impl AsRef<str>) {
        self.problems.add(self.document.line(path), format!("{}: {}", label(path), what.as_ref()));
    }

    /// Which sections a kind of device has.
    fn sections(&mut self, wired: bool, raw: &RawRig) {
        let wires = [("amplifier", raw.amplifier.is_some()), ("can", raw.can.is_some())];
        let mut say = |path: &str, what: &str| {
            let line = self.document.line(if self.document.has(path) { path } else { "device" });
            self.problems.add(line, format!("{}: {what}", table_label(path)));
        };
        if wired {
            for (section, _) in wires.into_iter().filter(|(section, there)| !there && !self.document.has(section)) {
                say(section, "missing; expected this section for [device] kind = \"wired\"");
            }
            if raw.rig.is_none() && !self.document.has("rig") {
                let what = "missing; expected inertia_kg_m2, gravity_nm and u_max_v, as a wired rig has no plant to take them from";
                say("rig", what);
            }
            if self.document.has("device.model") {
                let what = "is the plant of the emulated rig, and this device is \"wired\"; leave it out, or set [controller] model for targets of \
                            flow, pressure and angle";
                self.problem("device.model", what);
            }
        } else {
            let others = [("budget", self.document.has("budget"))];
            for (section, _) in wires.into_iter().chain(others).filter(|(_, there)| *there) {
                let what = "only for [device] kind = \"wired\", and this device is \"emulated\"; set the kind, or leave the section out";
                say(section, what);
            }
        }
    }

    /// What the controller knows. The plant of the emulated rig is known; its effects are what nobody knows.
    fn knowledge(&mut self, controller: RawController, plant: &ModelFile, wired: bool) -> Knowledge {
        let model = match &controller.model {
            Some(path) => self.model(path, "controller.model"),
            None if wired => None,
            None => Some(ModelFile::plain(plant.parameters)),
        };
        let Some(model) = model else { return Knowledge::Nothing };
        let knowledge = Knowledge::Model(model, controller.loops);
        for plane in [Plane::Horizontal, Plane::Vertical] {
            if let Err(failure) = knowledge.controller(plane) {
                self.problems.add(self.document.line("controller.loops"), format!("[controller] {failure}"));
                break;
            }
        }
        knowledge
    }

    fn model(&mut self, path: &Path, key: &str) -> Option<ModelFile> {
        let path = self.folder.join(path);
        match ModelFile::read(&path) {
            Ok(model) => {
                // Said now, and not when the first run is to begin.
                if let Err(error) = added_effects(&model) {
                    self.problem(key, format!("{}: {error}", path.display()));
                }
                Some(model)
            }
            Err(error) => {
                self.problem(key, Failure::of(Kind::Input, &error).message);
                None
            }
        }
    }
}
