//! Runs scripts on a rig and leaves a campaign folder: the recordings and `campaign.toml`.

use crate::devices::Devices;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::recorder::OnFull;
use crate::runner::{Mode, Plan, Runner, certify, judge};
use crate::setup::Knowledge;
use drivers::journal::JournalReader;
use identify::component::{fit_pump, pump_points};
use model::{ModelFile, Parameters};
use profiles::Script;
use recordings::{CAMPAIGN_FILE, Campaign, Protocol, RigFacts, RunEntry, UnknownWord};
use rt_core::{Device, Limits, LossCertificate, SafeState, Switches};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What a session is about.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folder of the campaign; is created. It must not hold a campaign yet: a measurement is never overwritten.
    pub dir: PathBuf,
    /// Free text for `campaign.toml`.
    pub name: String,
    /// What is known of the rig.
    pub rig: RigFacts,
    /// What the supervisor enforces.
    pub limits: Limits,
    /// Seed of the scripts' random steps.
    pub seed: u64,
    /// Noted in every recording.
    pub notes: BTreeMap<String, String>,
    /// Where the runs' ticks come from.
    pub mode: Mode,
}

/// A run that was recorded without loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Its entry in the campaign.
    pub entry: RunEntry,
    /// N of N.
    pub certificate: LossCertificate,
}

/// A campaign under way.
pub struct Session {
    campaign: Campaign,
    seed: u64,
    notes: BTreeMap<String, String>,
    instance: String,
    safe_state: SafeState,
    runner: Runner,
}

impl Session {
    /// Makes the folder, begins to publish on an instance of this process, and starts the logger.
    pub fn create(settings: Settings, progress: &Progress) -> Result<Self, Failure> {
        let Settings { dir, name, rig, limits, seed, notes, mode } = settings;
        make_folder(&dir)?;
        // Two campaigns on one machine must not hear each other.
        let instance = format!("campaign-{}", std::process::id());
        let runner = Runner::open(&instance, limits, mode, OnFull::GoOn, progress)?;
        let safe_state = limits.safe_state;
        let campaign = Campaign { dir, name, rig, runs: Vec::new() };
        Ok(Session { campaign, seed, notes, instance, safe_state, runner })
    }

    /// Runs one script to its end and adds its recording to the campaign. `knowledge` serves the targets other than voltages. Prints `NAME: N of N samples`.
    ///
    /// # Errors
    /// The script does not fit the rig (2), the device failed (4), the supervisor tripped (5), samples were lost or could
    /// not be written (6), a stop was asked for (130). Whatever was recorded stays in the folder.
    pub fn run(
        &mut self,
        script: &Script,
        device: &mut (dyn Device + Send),
        knowledge: &Knowledge,
        switches: &Switches,
        progress: &Progress,
    ) -> Result<Recorded, Failure> {
        let entry = entry(script).map_err(|e| Failure::of(Kind::Internal, &e))?;
        let path = self.campaign.dir.join(&entry.file);
        let (seed, u_max_v, notes) = (self.seed, self.campaign.rig.u_max_v, &self.notes);
        let plan = Plan { script, seed, u_max_v, knowledge, path: &path, notes };
        let finished = self.runner.run(&plan, device, switches, progress)?;
        self.campaign.runs.push(entry.clone());
        self.campaign.write_toml().map_err(|e| Failure::of(Kind::Input, &e))?;
        judge(&script.name, &finished.report)?;
        certify(&script.name, &finished.certificate)?;
        Ok(Recorded { entry, certificate: finished.certificate })
    }

    /// Name under which the samples are published.
    pub fn instance(&self) -> &str {
        &self.instance
    }

    /// Where drivers get the journals from that the recordings take their events from.
    pub fn journals(&mut self) -> &mut JournalReader {
        self.runner.journals()
    }

    /// Runs the scripts in their order. Where nothing is known of the rig, its pump is measured before flows are asked for: `knowledge`
    /// grows by the pump map.
    ///
    /// # Errors
    /// As [`Session::run`]; a rig that is not ready (4); a pump map that no pump fits (3).
    pub fn run_all(
        &mut self,
        scripts: &[Script],
        devices: &mut Devices,
        mut knowledge: Knowledge,
        switches: &Switches,
        progress: &Progress,
    ) -> Result<(), Failure> {
        for (run, script) in scripts.iter().enumerate() {
            let mut device = devices.prepare(script, self.seed, run, self.safe_state, self.runner.journals())?;
            let recorded = self.run(script, &mut *device, &knowledge, switches, progress)?;
            if recorded.entry.protocol == Protocol::PumpMap && knowledge == Knowledge::Nothing {
                knowledge = Knowledge::Pump(measured_pump(&self.campaign, &recorded.entry)?);
            }
        }
        Ok(())
    }

    /// The campaign as it is recorded so far; its folder can be read.
    pub fn campaign(&self) -> &Campaign {
        &self.campaign
    }

    /// Ends publication and logger.
    pub fn finish(self) -> Result<Campaign, Failure> {
        self.runner.finish()?;
        Ok(self.campaign)
    }
}

/// Makes the folder of a new campaign.
///
/// # Errors
/// It holds a campaign already, which is never overwritten, or the system refuses (2).
pub fn make_folder(dir: &Path) -> Result<(), Failure> {
    if dir.join(CAMPAIGN_FILE).exists() {
        let message = format!(
            "{}: expected a folder without a campaign, got one with {CAMPAIGN_FILE}; a measurement is never overwritten, \
             choose another folder or remove this one",
            dir.display()
        );
        return Err(Failure::new(Kind::Input, message));
    }
    std::fs::create_dir_all(dir).map_err(|error| {
        let message = format!("{}: expected to create this folder, got \"{error}\"; choose another one", dir.display());
        Failure::new(Kind::Input, message)
    })
}

fn entry(script: &Script) -> Result<RunEntry, UnknownWord> {
    Ok(RunEntry {
        file: format!("{}.mcap", script.name),
        protocol: FromStr::from_str(script.protocol.as_str())?,
        role: FromStr::from_str(script.role.as_str())?,
        plane: FromStr::from_str(script.plane.as_str())?,
    })
}

/// The example with the pump's parameters from its recorded map.
fn measured_pump(campaign: &Campaign, entry: &RunEntry) -> Result<ModelFile, Failure> {
    let run = campaign.read(entry).map_err(|e| Failure::of(Kind::Input, &e))?;
    let mut parameters = Parameters::example();
    parameters.pump.u_max = campaign.rig.u_max_v;
    if !fit_pump(&pump_points(&run), &mut parameters) {
        let message = format!(
            "{}: expected a pump that delivers more at a higher voltage, got points that eq. (10) does not fit; flows \
             can't be commanded",
            entry.file
        );
        return Err(Failure::new(Kind::Acceptance, message));
    }
    Ok(ModelFile::plain(parameters))
}
