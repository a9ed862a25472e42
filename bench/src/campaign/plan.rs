//! `plan.toml`: what a campaign is going to be, written before its first run. A later call with the same plan goes on with it; one with
//! another is refused. `docs/CAMPAIGN.md` describes the file.

use super::order::{Experiment, order};
use crate::campaign::Settings;
use crate::failure::{Failure, Kind};
use crate::runner::Mode;
use crate::setup::{Knowledge, Setup};
use profiles::{Need, Script};
use recordings::RigFacts;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

/// Name of the plan in a campaign's folder.
pub const PLAN_FILE: &str = "plan.toml";

/// The format number that is written, and the only one that is read.
const FORMAT: u32 = 1;

const HEADER: &str = "# What this campaign is: made by `bench campaign`, which goes on with it when it is called again with the same \
                      rig, seed and profiles.\n# Not to be edited.\n";

/// A campaign before it is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    format: u32,
    /// Name of the rig, and of the campaign.
    pub name: String,
    /// Whose time the runs take place in.
    pub time: Time,
    /// What is known of the rig, and the files that say it.
    pub rig: PlannedRig,
    /// Seed, limits, safe state and controller as each recording's setup notes them.
    pub setup: toml::Table,
    /// In the order in which they are recorded.
    #[serde(rename = "run")]
    pub runs: Vec<PlannedRun>,
}

/// Whose time the runs take place in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Time {
    /// As fast as it goes.
    Virtual,
    /// The wall's.
    Real,
}

/// The rig of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedRig {
    /// Inertia of lever and load, kg m2.
    #[serde(rename = "J")]
    pub inertia_kg_m2: f64,
    /// Gravity torque at 90 degrees, Nm.
    #[serde(rename = "G")]
    pub gravity_nm: f64,
    /// Largest command to the amplifier, V.
    #[serde(rename = "u_max")]
    pub u_max_v: f64,
    /// CRC-32 of the rig's files by name, 8 hexadecimal digits: the rig file, the CAN database, models.
    pub files: BTreeMap<String, String>,
}

/// A run of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedRun {
    /// Name of the run.
    pub name: String,
    /// Its recording, in the campaign's folder.
    pub file: String,
    /// Words of the campaign format.
    pub protocol: String,
    /// The same.
    pub role: String,
    /// The same.
    pub plane: String,
    /// What it needs of the runs before it: `nothing`, `pump`, `model`.
    pub needs: String,
    /// Longest time that it can take, s.
    pub at_most_s: f64,
    /// CRC-32 of the profile's text, 8 hexadecimal digits.
    pub crc32: String,
    /// The profile's text, with its tables.
    pub profile: String,
}

impl Plan {
    /// The plan of these scripts, in the order that their needs ask for; the scripts are put into that order. `knowledge` is what the rig
    /// file serves, `files` are the texts of the rig's files by name.
    ///
    /// # Errors
    /// No script, two of one name, a need that nothing serves (2).
    pub fn of(
        settings: &Settings,
        files: &BTreeMap<String, String>,
        knowledge: &Knowledge,
        scripts: &mut Vec<Script>,
    ) -> Result<Plan, Failure> {
        distinct(scripts)?;
        let experiments: Vec<Experiment> = scripts.iter().map(Experiment::from).collect();
        let given = match knowledge {
            Knowledge::Nothing => Need::Nothing,
            Knowledge::Pump(_) => Need::Pump,
            Knowledge::Model(..) => Need::Model,
        };
        let ordered = order(&experiments, given).map_err(|e| Failure::of(Kind::Input, &e))?;
        let mut taken: Vec<Option<Script>> = scripts.drain(..).map(Some).collect();
        scripts.extend(ordered.into_iter().filter_map(|i| taken[i].take()));

        let RigFacts { inertia_kg_m2, gravity_nm, u_max_v } = settings.rig;
        let setup = Setup::of(settings.seed, u_max_v, &settings.limits, knowledge);
        let time = match settings.mode {
            Mode::Lockstep => Time::Virtual,
            Mode::RealTime { .. } => Time::Real,
        };
        let files = files.iter().map(|(name, text)| (name.clone(), crc32(text))).collect();
        Ok(Plan {
            format: FORMAT,
            name: settings.name.clone(),
            time,
            rig: PlannedRig { inertia_kg_m2, gravity_nm, u_max_v, files },
            setup: table_of(&setup)?,
            runs: scripts.iter().map(PlannedRun::of).collect(),
        })
    }

    /// The plan in a folder; `None` where there is none.
    ///
    /// # Errors
    /// A plan that is none of this program's, or was edited (2).
    pub fn read(dir: &Path) -> Result<Option<Plan>, Failure> {
        let path = dir.join(PLAN_FILE);
        let input = |what: String| Failure::new(Kind::Input, format!("{}: {what}", path.display()));
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => {
                return Err(input(format!(
                    "expected a campaign's plan that can be read, got \"{error}\"; check its permissions, or name another --out"
                )));
            }
        };
        let remedy = "record into another folder, or put the plan back as it was";
        let table: toml::Table = toml::from_str(&text).map_err(|error| input(at_line(&text, &error, remedy)))?;
        match table.get("format").and_then(toml::Value::as_integer) {
            Some(format) if format == i64::from(FORMAT) => {}
            Some(other) => {
                let what =
                    format!("expected format {FORMAT}, got {other}; use the version of the program that made it");
                return Err(input(what));
            }
            None => return Err(input(format!("expected the key \"format\", got none; {remedy}"))),
        }
        let plan: Plan = toml::from_str(&text).map_err(|error| input(at_line(&text, &error, remedy)))?;
        for run in &plan.runs {
            let own = crc32(&run.profile);
            if run.crc32 != own {
                let (name, crc) = (&run.name, &run.crc32);
                return Err(input(format!(
                    "run {name}: expected a profile with CRC-32 {crc}, got {own}: it was edited; {remedy}"
                )));
            }
        }
        Ok(Some(plan))
    }

    /// Puts the plan into a folder, whole and on the disk, or not at all.
    ///
    /// # Errors
    /// The system refuses (6).
    pub fn write(&self, dir: &Path) -> Result<(), Failure> {
        let text = toml::to_string_pretty(self).map_err(|e| Failure::of(Kind::Internal, &e))?;
        write_whole(&dir.join(PLAN_FILE), &format!("{HEADER}{text}"))
    }

    /// In what another plan differs from this one, each difference in words; nothing where they are the same campaign.
    pub fn differences(&self, other: &Plan) -> Vec<String> {
        let mut said = Vec::new();
        let (mine, theirs) = (self.facts(), other.facts());
        let keys: BTreeSet<&String> = mine.keys().chain(theirs.keys()).collect();
        for key in keys {
            let word = |facts: &BTreeMap<String, String>| facts.get(key).cloned().unwrap_or_else(|| "none".to_owned());
            if mine.get(key) != theirs.get(key) {
                said.push(format!("{key}: {} in the plan, {} now", word(&mine), word(&theirs)));
            }
        }
        let names = |plan: &Plan| plan.runs.iter().map(|run| run.name.clone()).collect::<Vec<_>>();
        let (planned, now) = (names(self), names(other));
        if planned != now {
            said.push(format!("order of the runs: {} in the plan, {} now", planned.join(", "), now.join(", ")));
        }
        for run in &self.runs {
            let same_name = other.runs.iter().find(|theirs| theirs.name == run.name);
            said.extend(same_name.and_then(|theirs| first_difference(run, theirs)));
        }
        said
    }

    /// Everything but the runs, by key.
    fn facts(&self) -> BTreeMap<String, String> {
        let mut facts = BTreeMap::from([("name of the rig".to_owned(), self.name.clone())]);
        let time = match self.time {
            Time::Virtual => "virtual",
            Time::Real => "real",
        };
        facts.insert("time".to_owned(), time.to_owned());
        let PlannedRig { inertia_kg_m2, gravity_nm, u_max_v, files } = &self.rig;
        for (key, value) in [("J", inertia_kg_m2), ("G", gravity_nm), ("u_max", u_max_v)] {
            facts.insert(format!("rig.{key}"), value.to_string());
        }
        facts.extend(files.iter().map(|(name, crc)| (format!("file {name}"), format!("CRC-32 {crc}"))));
        flatten("", &self.setup, &mut facts);
        facts
    }

    /// The largest time that the runs from number `first` on can take, s.
    pub fn at_most_s(&self, first: usize) -> f64 {
        self.runs.iter().skip(first).map(|run| run.at_most_s).sum()
    }
}

impl PlannedRun {
    fn of(script: &Script) -> Self {
        PlannedRun {
            name: script.name.clone(),
            file: file_of(&script.name),
            protocol: script.protocol.as_str().to_owned(),
            role: script.role.as_str().to_owned(),
            plane: script.plane.as_str().to_owned(),
            needs: script.need().as_str().to_owned(),
            at_most_s: script.duration_bound_s(),
            crc32: crc32(&script.text),
            profile: script.text.clone(),
        }
    }
}

/// The setup as each recording notes it.
fn table_of(setup: &Setup) -> Result<toml::Table, Failure> {
    let notes = setup.notes().into_values().collect::<Vec<_>>().join("\n");
    toml::from_str(&notes).map_err(|e| Failure::of(Kind::Internal, &e))
}

/// The recording of a run of this name.
pub fn file_of(name: &str) -> String {
    format!("{name}.mcap")
}

/// CRC-32 of a text, 8 hexadecimal digits.
pub fn crc32(text: &str) -> String {
    format!("{:08x}", crc32fast::hash(text.as_bytes()))
}

/// Writes a text beside its place, waits until it is on the disk and moves it there.
pub(super) fn write_whole(path: &Path, text: &str) -> Result<(), Failure> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let written = std::fs::File::create(&part)
        .and_then(|mut file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()))
        .and_then(|()| std::fs::rename(&part, path));
    written.map_err(|error| {
        let what = "expected to write it, got";
        Failure::new(Kind::Loss, format!("{}: {what} \"{error}\"; check the folder and the free space", path.display()))
    })
}

fn distinct(scripts: &[Script]) -> Result<(), Failure> {
    if scripts.is_empty() {
        return Err(Failure::new(
            Kind::Input,
            "expected at least one profile, got none; `bench profile list` names the built-in ones",
        ));
    }
    let mut seen = BTreeSet::new();
    match scripts.iter().find(|script| !seen.insert(&script.name)) {
        None => Ok(()),
        Some(twice) => {
            let message = format!(
                "{}: expected each profile once in a campaign, got two runs of this name; their recordings would be one file, \
                 give one of them another name",
                twice.name
            );
            Err(Failure::new(Kind::Input, message))
        }
    }
}

fn at_line(text: &str, error: &toml::de::Error, remedy: &str) -> String {
    let offset = error.span().map_or(text.len(), |span| span.start).min(text.len());
    let line = 1 + text.as_bytes()[..offset].iter().filter(|byte| **byte == b'\n').count();
    format!("line {line}: {}; {remedy}", error.message().replace('\n', ", "))
}

fn flatten(prefix: &str, table: &toml::Table, into: &mut BTreeMap<String, String>) {
    for (key, value) in table {
        let key = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            toml::Value::Table(inner) => flatten(&key, inner, into),
            toml::Value::String(text) => drop(into.insert(key, text.clone())),
            other => drop(into.insert(key, other.to_string())),
        }
    }
}

/// The first line in which two profiles of one name differ.
fn first_difference(planned: &PlannedRun, now: &PlannedRun) -> Option<String> {
    if planned.profile == now.profile {
        return None;
    }
    let (mut mine, mut theirs) = (planned.profile.lines(), now.profile.lines());
    let name = &planned.name;
    for line in 1.. {
        match (mine.next(), theirs.next()) {
            (Some(a), Some(b)) if a == b => {}
            (None, None) => break,
            (a, b) => {
                let word = |line: Option<&str>| line.map_or("no line".to_owned(), |text| format!("{:?}", text.trim()));
                return Some(format!("profile {name}: line {line} is {} in the plan, {} now", word(a), word(b)));
            }
        }
    }
    Some(format!("profile {name}: its line ends are others"))
}

#[cfg(test)]
mod tests;
