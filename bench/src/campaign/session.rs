//! The runs of a campaign: scripts through the runner, one recording each, `campaign.toml` beside them.

use super::folder::{make_folder, nothing_there};
use super::known::Known;
use super::outlook::Outlook;
use super::plan::file_of;
use super::set_aside::set_aside;
use crate::devices::Devices;
use crate::failure::{Failure, Kind};
use crate::operator;
use crate::progress::Progress;
use crate::recorder::OnFull;
use crate::rig_file::RigRecord;
use crate::runner::{Mode, Plan, Runner};
use crate::setup::Knowledge;
use drivers::journal::JournalReader;
use profiles::Script;
use recordings::{Campaign, RigFacts, RunEntry, UnknownWord};
use rt_core::{Device, Limits, LossCertificate, SafeState, Switches};
use std::collections::BTreeMap;
use std::path::PathBuf;
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
    /// When the disk runs full; a stop needs somebody who hears it on the session's instance.
    pub on_full: OnFull,
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
    /// Its runs are those that are there, each as its script wanted it.
    campaign: Campaign,
    /// Runs that were not recorded by this campaign and belong to it all the same, see [`Session::keep_others`].
    others: Vec<RunEntry>,
    seed: u64,
    notes: BTreeMap<String, String>,
    instance: String,
    safe_state: SafeState,
    runner: Runner,
}

impl Session {
    /// Makes the folder, begins to publish on an instance of this process, and starts the logger.
    ///
    /// # Errors
    /// The folder holds a campaign (2); those of [`Runner::open`].
    pub fn create(settings: Settings, progress: &Progress) -> Result<Self, Failure> {
        make_folder(&settings.dir)?;
        Session::open(settings, progress)
    }

    /// The same in a folder that is there, whatever it holds.
    ///
    /// # Errors
    /// Those of [`Runner::open`].
    pub fn open(settings: Settings, progress: &Progress) -> Result<Self, Failure> {
        let Settings { dir, name, rig, limits, seed, notes, mode, on_full } = settings;
        // Two campaigns on one machine must not hear each other.
        let instance = format!("campaign-{}", std::process::id());
        let runner = Runner::open(&instance, limits, mode, on_full, progress)?;
        let safe_state = limits.safe_state;
        let campaign = Campaign { dir, name, rig, runs: Vec::new() };
        Ok(Session { campaign, others: Vec::new(), seed, notes, instance, safe_state, runner })
    }

    /// Runs one script to its end and adds its recording to the campaign. `knowledge` serves the targets other than voltages. Prints `NAME: N of N samples`.
    ///
    /// # Errors
    /// The script does not fit the rig (2), the device failed (4), the supervisor tripped (5), samples were lost or could
    /// not be written (6), a stop was asked for (130). Whatever was recorded stays in the folder, and is no run of the campaign.
    pub fn run(
        &mut self,
        script: &Script,
        device: &mut (dyn Device + Send),
        knowledge: &Knowledge,
        switches: &Switches,
        progress: &Progress,
    ) -> Result<Recorded, Failure> {
        let recorded = self.record(script, device, knowledge, switches, progress)?;
        self.campaign.runs.push(recorded.entry.clone());
        self.write_toml()?;
        Ok(recorded)
    }

    /// Runs one script to its end and records it. The campaign does not know of it yet: what fails here is the run's own.
    fn record(
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
        finished.judge(&script.name)?;
        Ok(Recorded { entry, certificate: finished.certificate })
    }

    /// What every recording from now on keeps of the rig.
    pub fn describe(&mut self, rig: RigRecord) {
        self.runner.describe(rig);
    }

    /// Runs that people added to `campaign.toml`: they stay in it, after those of the scripts. No run of the scripts is based on them.
    pub fn keep_others(&mut self, others: Vec<RunEntry>) {
        self.others = others;
    }

    /// Name under which the samples are published.
    pub fn instance(&self) -> &str {
        &self.instance
    }

    /// Where drivers get the journals from that the recordings take their events from.
    pub fn journals(&mut self) -> &mut JournalReader {
        self.runner.journals()
    }

    /// Runs the scripts in their order, but for those that are `there` already (one word for each). Each run has its place in the
    /// list as its number and knows what the runs before it measured: whether they were recorded by this call or by an earlier one makes no
    /// difference. What a run that fails has left is set aside.
    ///
    /// # Errors
    /// As [`Session::run`] and [`Known::before`]; a rig that is not ready (4). The runs that are done stay.
    pub fn run_all(
        &mut self,
        scripts: &[Script],
        there: &[bool],
        devices: &mut Devices,
        mut known: Known,
        switches: &Switches,
        progress: &Progress,
    ) -> Result<(), Failure> {
        let mut there = there.to_vec();
        let mut outlook = Outlook::new(scripts.iter().map(Script::duration_bound_s).collect(), there.clone());
        self.keep(scripts, &there)?;
        for (number, script) in scripts.iter().enumerate().filter(|(number, _)| !there[*number]).collect::<Vec<_>>() {
            operator::still_wanted(script, switches).map_err(|mut asked| {
                asked.message.push_str("; the same command goes on from there");
                asked
            })?;
            nothing_there(&self.campaign.dir, [script.name.as_str()].into_iter())?;
            progress.say(&outlook.announce(number, &script.name));
            let before = Campaign { runs: entries(&scripts[..number], &there)?, ..self.campaign.clone() };
            let knowledge = known.before(script, &before, progress)?;
            let outcome = self.run_number(number, script, devices, knowledge, switches, progress);
            if let Err(failure) = outcome {
                return Err(self.leave(script, failure));
            }
            there[number] = true;
            outlook.done(number);
            // Should this fail, the recording is whole and stays: the next call finds it.
            self.keep(scripts, &there)?;
        }
        Ok(())
    }

    fn run_number(
        &mut self,
        number: usize,
        script: &Script,
        devices: &mut Devices,
        knowledge: &Knowledge,
        switches: &Switches,
        progress: &Progress,
    ) -> Result<(), Failure> {
        self.runner.number_from(number as u32);
        self.runner.operated_by(devices.hands());
        self.runner.ask_to_prepare(script, switches, progress)?;
        let mut device =
            devices.prepare(script, self.seed, number, self.safe_state, self.runner.journals(), switches)?;
        self.record(script, &mut *device, knowledge, switches, progress).map(drop)
    }

    /// Sets aside what a run left that failed, and says so with the failure.
    fn leave(&self, script: &Script, failure: Failure) -> Failure {
        let said = match set_aside(&self.campaign.dir, &script.name, &failure.message) {
            Ok(Some(to)) => format!("{failure}; its recording is set aside as {}", to.display()),
            Ok(None) => failure.message,
            Err(refused) => format!("{failure}; {refused}"),
        };
        Failure::new(failure.kind, said)
    }

    /// The campaign is those of these runs that are there, in their order, and the others that it keeps; `campaign.toml` says so.
    ///
    /// # Errors
    /// The system refuses to write it (2).
    pub fn keep(&mut self, scripts: &[Script], there: &[bool]) -> Result<(), Failure> {
        self.campaign.runs = entries(scripts, there)?;
        self.campaign.runs.extend(self.others.iter().cloned());
        if self.campaign.runs.is_empty() { Ok(()) } else { self.write_toml() }
    }

    fn write_toml(&self) -> Result<(), Failure> {
        self.campaign.write_toml().map_err(|e| Failure::of(Kind::Input, &e))
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

/// The entries of the scripts that are there.
fn entries(scripts: &[Script], there: &[bool]) -> Result<Vec<RunEntry>, Failure> {
    let recorded = scripts.iter().zip(there).filter(|(_, there)| **there).map(|(script, _)| entry(script));
    recorded.collect::<Result<_, _>>().map_err(|e| Failure::of(Kind::Internal, &e))
}

/// The entry of a script's run in `campaign.toml`.
fn entry(script: &Script) -> Result<RunEntry, UnknownWord> {
    Ok(RunEntry {
        file: file_of(&script.name),
        protocol: FromStr::from_str(script.protocol.as_str())?,
        role: FromStr::from_str(script.role.as_str())?,
        plane: FromStr::from_str(script.plane.as_str())?,
    })
}
