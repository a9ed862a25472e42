//! Diagnosis that goes on by itself: the next run is made on an emulated rig, added to a copy of the campaign, and diagnosed again.
//!
//! The campaign it began with is never touched. Below the folder of the results stands `auto/campaign`, which holds its recordings (linked
//! where the file system can, copied where not) and grows by a run a round; `auto/round-N` holds the results of each.

use super::Designed;
use super::design::SEED;
use crate::commands::results::{Results, Wanted, analyse_with};
use crate::devices::Devices;
use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::progress::Progress;
use crate::recorder::OnFull;
use crate::rig_file::{DeviceSpec, Rig, RigRecord};
use crate::runner::{Mode, Plan, Runner};
use crate::setup::Knowledge;
use identify::analysis::Depth;
use identify::declared::Declared;
use identify::diagnose::Verdict;
use identify::torque_form::TorqueForm;
use model::ModelFile;
use profiles::Script;
use recordings::{Campaign, Role, RunEntry};
use rt_core::Limits;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What further runs may cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    seconds: f64,
    runs: usize,
}

impl Budget {
    /// Minutes of rig time and number of runs.
    ///
    /// # Errors
    /// No time at all (2).
    pub fn new(minutes: f64, runs: usize) -> Result<Budget, Failure> {
        if minutes.is_finite() && minutes > 0.0 {
            return Ok(Budget { seconds: 60.0 * minutes, runs });
        }
        Err(Failure::new(Kind::Input, format!("--budget-min: expected minutes above 0, got {minutes}")))
    }
}

/// What is to be settled.
pub struct Auto<'a> {
    /// The campaign.
    pub dir: &'a Path,
    /// Folder of the results; `None`: `analysis` in the campaign's.
    pub out: Option<&'a Path>,
    /// Model whose effects are declared.
    pub declared: Option<&'a Declared>,
    /// For all rounds together.
    pub budget: Budget,
    /// Of the emulated sensors.
    pub seed: u64,
}

/// Where a demo seals what its emulated rig is.
const SEALED: &str = "sealed/truth.toml";

impl Auto<'_> {
    /// Rounds until the verdict stands or the budget is spent.
    ///
    /// # Errors
    /// No rig that can run by itself, a rig other than the campaign's, results of an earlier call (2); the budget is spent and the verdict
    /// does not stand (3); those of a run.
    pub fn run(&self, rig: Option<&Path>, progress: &Progress) -> Result<(), Failure> {
        let out = self.out.map_or_else(|| self.dir.join("analysis"), Path::to_owned);
        let auto = out.join("auto");
        if auto.exists() {
            let message = format!(
                "{}: expected no rounds of an earlier --auto, got some; nothing is overwritten: choose another --out, or move that folder away",
                auto.display()
            );
            return Err(Failure::new(Kind::Input, message));
        }
        let begun = Campaign::open(self.dir).map_err(|e| Failure::of(Kind::Input, &e))?;
        let rig = self.rig(rig, &begun)?;
        let by_itself = matches!(rig.device, DeviceSpec::Emulated(_));
        if !by_itself {
            progress.say(
                "--auto: this rig is on wires and needs people; the next run is only proposed: check next.toml with `bench profile check`, run it with \
                 `bench run`, and add its recording to the campaign",
            );
        }
        let wanted =
            Wanted { depth: Depth::Diagnosis, form: TorqueForm::default(), declared: self.declared, rig: Some(&rig) };
        let mut results = analyse_with(self.dir, Some(&out), &wanted, progress)?;
        let mut folder: Option<Extended> = None;
        let (mut spent_s, mut round) = (0.0, 0);
        loop {
            progress.result(&said(round, &results));
            let Some(next) = results.next.take() else {
                progress.result(&format!("the verdict stands after {round} further runs, {spent_s:.0} s of rig time"));
                return Ok(());
            };
            let open = |why: String| {
                Err(Failure::new(
                    Kind::Acceptance,
                    format!("the verdict does not stand after {round} further runs: {why}"),
                ))
            };
            let Designed { script: Some(text), seconds, said, .. } = next else {
                // a class that no run within the limits splits is as far as an attribution gets
                if verdict(&results) == Verdict::Attributed {
                    progress
                        .result(&format!("the verdict stands as a class after {round} further runs: {}", next.said));
                    return Ok(());
                }
                return open(next.said);
            };
            if !by_itself {
                return open(format!("{said}; the rig is on wires and needs people for it"));
            }
            if round >= self.budget.runs {
                return open(format!("--most-runs {} are made; it would go on with {said}", self.budget.runs));
            }
            if spent_s + seconds > self.budget.seconds {
                let minutes = self.budget.seconds / 60.0;
                return open(format!("--budget-min {minutes} are spent ({spent_s:.0} s); it would go on with {said}"));
            }
            round += 1;
            let extended = match folder.take() {
                Some(extended) => extended,
                None => Extended::begin(&begun, &auto.join("campaign"))?,
            };
            let extended = folder.insert(extended);
            spent_s += extended.record(&text, &rig, self.seed, progress)?;
            let into = auto.join(format!("round-{round}"));
            results = analyse_with(&extended.campaign.dir, Some(&into), &wanted, progress)?;
        }
    }

    /// The rig of the further runs.
    fn rig(&self, path: Option<&Path>, begun: &Campaign) -> Result<Rig, Failure> {
        let sealed = self.dir.join(SEALED);
        let mut rig = match path {
            Some(path) => Rig::read(Some(path))?,
            None if sealed.is_file() => {
                let plant = ModelFile::read(&sealed).map_err(|e| Failure::of(Kind::Input, &e))?;
                let limits = Limits { pressure_min_bar: 0.3, pressure_max_bar: 9.0, ..Limits::default() };
                Rig { device: DeviceSpec::Emulated(Box::new(plant)), facts: begun.rig, limits, ..Rig::read(None)? }
            }
            None => {
                let message = format!(
                    "--auto: expected --rig RIG.toml of an emulated rig, got none, and {} is no folder of a demo; the next run without --auto is next.toml",
                    self.dir.display()
                );
                return Err(Failure::new(Kind::Input, message));
            }
        };
        // the next run drives with voltages alone, so nothing of the plant is known to a controller
        rig.knowledge = Knowledge::Nothing;
        for (what, campaign, own) in [
            ("J (kg m2)", begun.rig.inertia_kg_m2, rig.facts.inertia_kg_m2),
            ("G (Nm)", begun.rig.gravity_nm, rig.facts.gravity_nm),
            ("u_max (V)", begun.rig.u_max_v, rig.facts.u_max_v),
        ] {
            if (campaign - own).abs() > 1e-6 * campaign.abs().max(own.abs()) {
                let message = format!(
                    "--rig: expected the rig of the campaign, got another one: {what} is {own}, in {} it is {campaign}",
                    begun.dir.join(recordings::CAMPAIGN_FILE).display()
                );
                return Err(Failure::new(Kind::Input, message));
            }
        }
        Ok(rig)
    }
}

/// One line a round.
fn said(round: usize, results: &Results) -> String {
    let effects: Vec<String> =
        results.analysis.findings.iter().flat_map(|f| &f.effects).map(|e| e.id.to_owned()).collect();
    let named = if effects.is_empty() { String::new() } else { format!(" ({})", effects.join(", ")) };
    let next = results.next.as_ref().map_or("nothing is left open".to_owned(), |n| n.said.clone());
    format!("round {round}: {}{named}; {next}", verdict(results).as_str())
}

fn verdict(results: &Results) -> Verdict {
    results.analysis.diagnosis.as_ref().map_or(Verdict::None, |d| d.verdict)
}

/// The copy of a campaign that grows.
pub struct Extended {
    /// The copy as it is now.
    pub campaign: Campaign,
}

impl Extended {
    /// Links or copies the recordings of a campaign into a new folder.
    ///
    /// # Errors
    /// The system refuses (2).
    pub fn begin(begun: &Campaign, dir: &Path) -> Result<Extended, Failure> {
        let refuse = |path: &Path, error: &std::io::Error| {
            let message = format!(
                "{}: expected to copy the campaign there, got \"{error}\"; choose another --out, or check the free space",
                path.display()
            );
            Failure::new(Kind::Input, message)
        };
        fs::create_dir_all(dir).map_err(|e| refuse(dir, &e))?;
        for run in &begun.runs {
            let (from, to) = (begun.dir.join(&run.file), dir.join(&run.file));
            if let Some(folder) = to.parent() {
                fs::create_dir_all(folder).map_err(|e| refuse(&to, &e))?;
            }
            // recordings are never changed, so a link is as good as a copy
            fs::hard_link(&from, &to).or_else(|_| fs::copy(&from, &to).map(drop)).map_err(|e| refuse(&to, &e))?;
        }
        let campaign = Campaign { dir: dir.to_owned(), ..begun.clone() };
        campaign.write_toml().map_err(|e| Failure::of(Kind::Input, &e))?;
        Ok(Extended { campaign })
    }

    /// Makes the run of this script on the emulated rig and adds it with role identify; returns its rig time, s.
    ///
    /// # Errors
    /// Those of a run.
    pub fn record(&mut self, text: &str, rig: &Rig, seed: u64, progress: &Progress) -> Result<f64, Failure> {
        let script = Script::parse(text, super::NEXT_FILE).map_err(|e| Failure::of(Kind::Internal, &e))?;
        let file = format!("{}.mcap", script.name);
        let path: PathBuf = self.campaign.dir.join(&file);
        let word = |e: recordings::UnknownWord| Failure::of(Kind::Internal, &e);
        let entry = RunEntry {
            file,
            protocol: FromStr::from_str(script.protocol.as_str()).map_err(word)?,
            role: Role::Identify,
            plane: FromStr::from_str(script.plane.as_str()).map_err(word)?,
        };
        let instance = format!("auto-{}", std::process::id());
        let notes = [("device".to_owned(), "emulated rig".to_owned())].into();
        let (switches, _driving) = interrupt::driving()?;
        let mut runner = Runner::open(&instance, rig.limits, Mode::Lockstep, OnFull::GoOn, progress)?;
        runner.describe(RigRecord::of_emulated(&rig.name, &rig.facts, &rig.limits));
        let number = self.campaign.runs.len();
        runner.number_from(number as u32);
        let mut devices = Devices::open(&rig.device, rig.limits.safe_state, &Mode::Lockstep, runner.journals())?;
        let plan = Plan {
            script: &script,
            seed: SEED,
            u_max_v: rig.facts.u_max_v,
            knowledge: &rig.knowledge,
            path: &path,
            notes: &notes,
        };
        let finished = {
            let mut device =
                devices.prepare(&script, seed, number, rig.limits.safe_state, runner.journals(), switches)?;
            runner.run(&plan, &mut *device, switches, progress)?
        };
        runner.finish()?;
        finished.judge(&script.name)?;
        progress.result(&format!("recorded: {}, {}", path.display(), finished.certificate));
        self.campaign.runs.push(entry);
        self.campaign.write_toml().map_err(|e| Failure::of(Kind::Input, &e))?;
        Ok(finished.certificate.expected as f64 * rt_core::PERIOD_NS as f64 * 1e-9)
    }
}
