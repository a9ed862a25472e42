//! `bench campaign --out DIR [PROFILE...]`

use super::results::aligned;
use super::run::{EMULATED, dry_run, listening, profile};
use super::time::TimeArgs;
use crate::campaign::known::Known;
use crate::campaign::outlook::span;
use crate::campaign::plan::PlannedRun;
use crate::campaign::{Folder, PLAN_FILE, Plan, Session, Settings};
use crate::devices::Devices;
use crate::emulation::builtin_scripts;
use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::operator;
use crate::progress::Progress;
use crate::recorder::OnFull;
use crate::rig_file::{DeviceSpec, Rig};
use crate::runner::Mode;
use crate::setup::Knowledge;
use model::ModelFile;
use profiles::{Context, Hands, Script};
use recordings::RunEntry;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Run profiles one after the other and leave a campaign folder; the same command goes on where it was interrupted
///
/// The order follows from what the profiles need: flows the pump's map, pressures and angles an identified model. The plan is written into
/// the folder first. What a run that was interrupted, tripped or lost samples has left is set aside, and the run is repeated by the next call.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Profiles, files or names of built-in ones [default: all experiments of the paper]
    profiles: Vec<String>,
    /// Folder to make, or to go on with
    #[arg(long, required_unless_present = "plan_only")]
    out: Option<PathBuf>,
    /// Only say what would be run: order, times, the operator's work
    #[arg(long)]
    plan_only: bool,
    #[command(flatten)]
    time: TimeArgs,
    /// Rig file [default: the emulated rig]
    #[arg(long)]
    rig: Option<PathBuf>,
    /// Nobody is at the rig: a profile that would need people is refused before anything moves
    #[arg(long)]
    no_operator: bool,
    /// Skip the dry runs on the rig's model, which come before the first run on wires
    #[arg(long)]
    no_dry_run: bool,
    /// When the disk runs full
    #[arg(long, value_enum, default_value = "stop")]
    on_full: OnFull,
    /// Seed of the profiles' random steps and of the emulated sensors
    #[arg(long, default_value_t = 1, value_parser = super::seed)]
    seed: u64,
    /// Print the plan, or the runs that are there at the end, as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let stdout = progress;
    let progress = &progress.beside(args.json);
    let rig = Rig::read(args.rig.as_deref())?;
    let mut scripts = if args.profiles.is_empty() {
        builtin_scripts()?
    } else {
        args.profiles.iter().map(|name| profile(name)).collect::<Result<_, _>>()?
    };
    let mode = args.time.mode();
    // Without one there is only a plan to be said.
    let dir = args.out.clone().unwrap_or_default();
    let settings = Settings {
        dir: dir.clone(),
        name: rig.name.clone(),
        rig: rig.facts,
        limits: rig.limits,
        seed: args.seed,
        notes: [("device".to_owned(), rig.name.clone())].into(),
        mode: mode.clone(),
        on_full: args.on_full,
    };
    // A campaign measures what it needs: of the emulated plant no more is known than of any other.
    let knowledge = match rig.device {
        DeviceSpec::Emulated(_) if !rig.names_model => Knowledge::Nothing,
        DeviceSpec::Emulated(_) | DeviceSpec::Wired(_) => rig.knowledge.clone(),
    };
    let record = rig.record()?;
    let plan = Plan::of(&settings, &files(&rig, &knowledge, record.files.clone()), &knowledge, &mut scripts)?;
    if args.plan_only {
        return match args.json {
            true => stdout.json(&planned(&plan, &scripts, &rig, args.seed)?),
            false => say_plan(&plan, &scripts, &rig, args.seed, progress),
        };
    }

    if matches!((&rig.device, &mode), (DeviceSpec::Wired(_), Mode::Lockstep)) {
        // Before the plan is written, which says whose time it is.
        let message = "expected real time, got virtual time: a rig on wires has its own time; add --realtime";
        return Err(Failure::new(Kind::Input, message));
    }
    if args.rig.is_none() {
        progress.say(EMULATED);
    }
    let folder = Folder::claim(&dir, &plan)?;
    let others = folder.others(&plan, progress)?;
    let there = folder.survey(&plan, &scripts, progress)?;
    let done = there.iter().filter(|there| **there).count();
    if folder.resumed() {
        progress.say(&format!("{}: {done} of {} runs are there already", dir.display(), plan.runs.len()));
    }
    if !args.no_dry_run {
        dry_runs(&scripts, &there, &rig, args.seed, progress)?;
    }
    let (switches, _driving) = interrupt::driving()?;
    let known = Known::at_first(knowledge, rig.loops);
    let mut session = Session::open(settings, progress)?;
    session.describe(record);
    session.keep_others(others);
    if done < plan.runs.len() {
        let mut devices = Devices::open(&rig.device, rig.limits.safe_state, &mode, session.journals())?;
        let context = Context { u_max_v: rig.facts.u_max_v, seed: args.seed, hands: devices.hands() };
        for (script, _) in scripts.iter().zip(&there).filter(|(_, there)| !**there) {
            operator::require(script, &context, args.no_operator, false)?;
        }
        let instance = session.instance().to_owned();
        listening(&instance, switches, progress, || {
            session.run_all(&scripts, &there, &mut devices, known, switches, progress)
        })?;
    } else {
        session.keep(&scripts, &there)?;
    }
    let campaign = session.finish()?;
    progress.result(&format!("campaign: {} runs in {}", campaign.runs.len(), dir.display()));
    if args.json {
        let run = |run: &RunEntry| json!({"file": run.file, "protocol": run.protocol.as_str(), "role": run.role.as_str(), "plane": run.plane.as_str()});
        let runs: Vec<Value> = campaign.runs.iter().map(run).collect();
        stdout.json(&json!({"dir": dir.display().to_string(), "name": campaign.name, "runs": runs}))?;
    }
    Ok(())
}

/// The files that decide what the rig does and what is known of it, by name.
fn files(rig: &Rig, knowledge: &Knowledge, mut files: BTreeMap<String, String>) -> BTreeMap<String, String> {
    if let DeviceSpec::Emulated(plant) = &rig.device {
        // Its checksum alone reaches the plan.
        files.insert("plant of the emulated rig".to_owned(), plant.to_toml());
    }
    let model: Option<&ModelFile> = match knowledge {
        Knowledge::Nothing => None,
        Knowledge::Pump(model) | Knowledge::Model(model, _) => Some(model),
    };
    files.extend(model.map(|model| ("model.toml".to_owned(), model.to_toml())));
    files
}

/// What the runs to come would do to a rig on wires, by the model that its file names.
fn dry_runs(scripts: &[Script], there: &[bool], rig: &Rig, seed: u64, progress: &Progress) -> Result<(), Failure> {
    for (script, _) in scripts.iter().zip(there).filter(|(_, there)| !**there) {
        dry_run(script, rig, seed, progress)?;
        if !matches!(rig.knowledge, Knowledge::Model(..)) {
            // Said once: without a model none of them is predicted.
            break;
        }
    }
    Ok(())
}

/// The plan for scripts.
fn planned(plan: &Plan, scripts: &[Script], rig: &Rig, seed: u64) -> Result<Value, Failure> {
    let context = Context { u_max_v: rig.facts.u_max_v, seed, hands: Hands::People };
    let run = |(run, script): (&PlannedRun, &Script)| {
        let requests = script.requests(&context).map_err(|e| Failure::of(Kind::Input, &e))?;
        Ok(json!({
            "name": run.name,
            "protocol": run.protocol,
            "role": run.role,
            "needs": run.needs,
            "at_least_s": script.duration_least_s(),
            "at_most_s": run.at_most_s,
            "requests": requests.len(),
            "prepared": script.preparation(),
        }))
    };
    let runs = plan.runs.iter().zip(scripts).map(run).collect::<Result<Vec<Value>, Failure>>()?;
    Ok(json!({"runs": runs, "at_most_s": plan.at_most_s(0)}))
}

fn say_plan(plan: &Plan, scripts: &[Script], rig: &Rig, seed: u64, progress: &Progress) -> Result<(), Failure> {
    let head = ["", "run", "protocol", "role", "needs", "at least", "at most", "requests", "prepared"];
    let mut rows = vec![head.map(String::from).to_vec()];
    for (n, (run, script)) in plan.runs.iter().zip(scripts).enumerate() {
        let context = Context { u_max_v: rig.facts.u_max_v, seed, hands: Hands::People };
        let requests = script.requests(&context).map_err(|e| Failure::of(Kind::Input, &e))?;
        rows.push(vec![
            (n + 1).to_string(),
            run.name.clone(),
            run.protocol.clone(),
            run.role.clone(),
            if run.needs == "nothing" { "-".to_owned() } else { run.needs.clone() },
            span(script.duration_least_s()),
            span(run.at_most_s),
            requests.len().to_string(),
            script.preparation(),
        ]);
    }
    aligned(&rows).iter().for_each(|line| progress.result(line));
    let sum = span(plan.at_most_s(0));
    progress.result("");
    progress.result(&format!("{} runs, at most {sum} of the rig's time; {PLAN_FILE} is not written", plan.runs.len()));
    progress.result(
        "requests: what the operator is asked for within the run where the rig does not do it itself; `bench profile check RUN` lists them",
    );
    Ok(())
}
