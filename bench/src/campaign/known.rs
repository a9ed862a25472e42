//! What a campaign knows of its rig at each run: what the rig file says, or what the runs before it measured.

use super::plan::{file_of, write_whole};
use crate::controller::Settings as LoopSettings;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::setup::Knowledge;
use identify::component::{fit_pump, pump_points};
use identify::identification::{IdentifyError, Loaded, identify};
use identify::model_file::model_file;
use identify::uncertainty::Uncertainty;
use model::{ModelFile, Parameters};
use profiles::{Need, Script};
use recordings::{Campaign, Protocol, Role, RunEntry};
use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

/// Name of the model that targets of pressure and angle were controlled with, in the campaign's folder.
pub const CONTROL_MODEL_FILE: &str = "model_for_control.toml";

/// Key of its `[source]` that names the recordings it came from.
const FROM: &str = "recordings_crc32";

/// Parameters that no target of pressure or angle needs: a controlled run keeps the bypass closed.
const NOT_NEEDED: [&str; 1] = ["k_b"];

/// What is known before a run. It grows: nothing, the pump from its maps, the model from the runs recorded so far. What a rig file
/// says of the model is never replaced.
#[derive(Clone, Debug)]
pub struct Known {
    knowledge: Knowledge,
    loops: LoopSettings,
    /// The pump's maps that it was measured from.
    maps: BTreeSet<String>,
}

impl Known {
    /// Before the first run: what the rig file says, and how the loops of an identified model are to be set.
    pub fn at_first(knowledge: Knowledge, loops: LoopSettings) -> Self {
        Known { knowledge, loops, maps: BTreeSet::new() }
    }

    /// For a run of this script, where `recorded` holds the runs before it. A model is identified where one is needed for the first time,
    /// and left in the folder as [`CONTROL_MODEL_FILE`].
    ///
    /// # Errors
    /// A pump's map that no pump fits, runs that do not determine a parameter that the controller needs (3); a recording that can't be
    /// read (2).
    pub fn before(&mut self, script: &Script, recorded: &Campaign, progress: &Progress) -> Result<&Knowledge, Failure> {
        if !matches!(self.knowledge, Knowledge::Model(..)) {
            self.measure_pump(recorded)?;
            if script.need() == Need::Model {
                self.knowledge = Knowledge::Model(model_for_control(recorded, &script.name, progress)?, self.loops);
            }
        }
        Ok(&self.knowledge)
    }

    fn measure_pump(&mut self, recorded: &Campaign) -> Result<(), Failure> {
        let fitted = |run: &&RunEntry| run.protocol == Protocol::PumpMap && run.role == Role::Identify;
        let maps: Vec<&RunEntry> = recorded.runs.iter().filter(fitted).collect();
        let files: BTreeSet<String> = maps.iter().map(|run| run.file.clone()).collect();
        if files != self.maps {
            self.knowledge = Knowledge::Pump(measured_pump(recorded, &maps)?);
            self.maps = files;
        }
        Ok(())
    }
}

/// The example with the pump's parameters from its recorded maps.
fn measured_pump(campaign: &Campaign, maps: &[&RunEntry]) -> Result<ModelFile, Failure> {
    let mut points = Vec::new();
    for run in maps {
        points.extend(pump_points(&campaign.read(run).map_err(|e| Failure::of(Kind::Input, &e))?));
    }
    let mut parameters = Parameters::example();
    parameters.pump.u_max = campaign.rig.u_max_v;
    if !fit_pump(&points, &mut parameters) {
        let files: Vec<&str> = maps.iter().map(|run| run.file.as_str()).collect();
        let message = format!(
            "{}: expected a pump that delivers more at a higher voltage, got points that eq. (10) does not fit; flows \
             can't be commanded",
            files.join(", ")
        );
        return Err(Failure::new(Kind::Acceptance, message));
    }
    Ok(ModelFile::plain(parameters))
}

/// The model from all runs with role identify that are recorded: the one in the folder where it came from just these.
fn model_for_control(recorded: &Campaign, wanted_by: &str, progress: &Progress) -> Result<ModelFile, Failure> {
    let runs: Vec<RunEntry> = recorded.runs.iter().filter(|run| run.role == Role::Identify).cloned().collect();
    let campaign = Campaign { runs, ..recorded.clone() };
    let path = campaign.dir.join(CONTROL_MODEL_FILE);
    let from = from(&campaign)?;
    if let Ok(model) = ModelFile::read(&path)
        && model.source.get(FROM) == Some(&from)
    {
        return Ok(model);
    }
    let step = progress.step("model for control", 0);
    let mut model = identified(campaign)?;
    step.done(&format!("identified from {}", from_names(&from)));
    model.source.insert("made_for".into(), format!("the targets of pressure and angle of {}", file_of(wanted_by)));
    model.source.insert(FROM.into(), from);
    write_whole(&path, &model.to_toml())?;
    // As every later call reads it.
    ModelFile::read(&path).map_err(|e| Failure::of(Kind::Internal, &e))
}

fn identified(campaign: Campaign) -> Result<ModelFile, Failure> {
    let of = |error: IdentifyError| Failure::of(Kind::Input, &error);
    let dir = campaign.dir.clone();
    let loaded = Loaded::of(campaign).map_err(of)?;
    let identified = identify(&loaded, &|_| {}).map_err(of)?;
    let lacking: Vec<String> = identified
        .undetermined
        .iter()
        .filter(|(name, _)| !NOT_NEEDED.contains(&name.as_str()))
        .map(|(name, why)| format!("{name}: {why}"))
        .collect();
    if !lacking.is_empty() {
        let message = format!(
            "{}: expected runs that determine every parameter that control of pressures and angles needs, got ones that leave open {}",
            dir.display(),
            lacking.join("; ")
        );
        return Err(Failure::new(Kind::Acceptance, message));
    }
    let uncertainty = Uncertainty::of(&identified.problem, &identified.fit)
        .map_err(|source| of(IdentifyError::Simulation { what: "the identify runs".to_owned(), source }))?;
    Ok(model_file(&loaded, &identified, None, &identified.fit, &uncertainty))
}

/// The recordings of a campaign with the CRC-32 of each: `a.mcap 0123abcd, b.mcap 4567cdef`.
fn from(campaign: &Campaign) -> Result<String, Failure> {
    let mut words = Vec::with_capacity(campaign.runs.len());
    for run in &campaign.runs {
        let path = campaign.dir.join(&run.file);
        let crc = file_crc32(&path).map_err(|error| {
            Failure::new(Kind::Input, format!("{}: expected a recording, got \"{error}\"", path.display()))
        })?;
        words.push(format!("{} {crc:08x}", run.file));
    }
    Ok(words.join(", "))
}

fn from_names(from: &str) -> String {
    from.split(", ").filter_map(|word| word.split(' ').next()).collect::<Vec<_>>().join(", ")
}

fn file_crc32(path: &Path) -> std::io::Result<u32> {
    let (mut file, mut hasher) = (std::fs::File::open(path)?, crc32fast::Hasher::new());
    let mut block = vec![0; 1 << 20];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hasher.finalize()),
            bytes => hasher.update(&block[..bytes]),
        }
    }
}
