//! `bench campaign --out DIR [PROFILE...]`

use super::results::aligned;
use super::run::{listening, profile};
use super::time::TimeArgs;
use crate::campaign::known::Known;
use crate::campaign::outlook::span;
use crate::campaign::{Folder, PLAN_FILE, Plan, Session, Settings};
use crate::devices::Devices;
use crate::emulation::builtin_scripts;
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use crate::rig_file::{DeviceSpec, Rig};
use crate::setup::Knowledge;
use model::ModelFile;
use profiles::Script;
use rt_core::Fixture;
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
    #[arg(long, required_unless_present = "plan_only", default_value = "")]
    out: PathBuf,
    /// Only say what would be run: order, times, the operator's work
    #[arg(long)]
    plan_only: bool,
    #[command(flatten)]
    time: TimeArgs,
    /// Rig file [default: the emulated rig]
    #[arg(long)]
    rig: Option<PathBuf>,
    /// Seed of the profiles' random steps and of the emulated sensors
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let rig = Rig::read(args.rig.as_deref())?;
    let mut scripts = if args.profiles.is_empty() {
        builtin_scripts()?
    } else {
        args.profiles.iter().map(|name| profile(name)).collect::<Result<_, _>>()?
    };
    let mode = args.time.mode();
    let settings = Settings {
        dir: args.out.clone(),
        name: rig.name.clone(),
        rig: rig.facts,
        limits: rig.limits,
        seed: args.seed,
        notes: [("device".to_owned(), rig.name.clone())].into(),
        mode: mode.clone(),
    };
    // A campaign measures what it needs: of the emulated plant no more is known than of any other.
    let knowledge = match rig.device {
        DeviceSpec::Emulated(_) if !rig.names_model => Knowledge::Nothing,
        DeviceSpec::Emulated(_) | DeviceSpec::Wired(_) => rig.knowledge.clone(),
    };
    let record = rig.record()?;
    let plan = Plan::of(&settings, &files(&rig, &knowledge, record.files.clone()), &knowledge, &mut scripts)?;
    if args.plan_only {
        say_plan(&plan, &scripts, progress);
        return Ok(());
    }

    let folder = Folder::claim(&args.out, &plan)?;
    let there = folder.survey(&plan, &scripts, progress)?;
    let done = there.iter().filter(|there| **there).count();
    if folder.resumed() {
        progress.say(&format!("{}: {done} of {} runs are there already", args.out.display(), plan.runs.len()));
    }
    let (switches, _driving) = interrupt::driving()?;
    let known = Known::at_first(knowledge, rig.loops);
    let mut session = Session::open(settings, progress)?;
    session.describe(record);
    if done < plan.runs.len() {
        let mut devices = Devices::open(&rig.device, rig.limits.safe_state, &mode, session.journals())?;
        let instance = session.instance().to_owned();
        listening(&instance, switches, progress, || {
            session.run_all(&scripts, &there, &mut devices, known, switches, progress)
        })?;
    } else {
        session.keep(&scripts, &there)?;
    }
    let campaign = session.finish()?;
    progress.result(&format!("campaign: {} runs in {}", campaign.runs.len(), args.out.display()));
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

fn say_plan(plan: &Plan, scripts: &[Script], progress: &Progress) {
    let head = ["", "run", "protocol", "role", "needs", "at most", "prepared by the operator"].map(String::from);
    let mut rows = vec![head.to_vec()];
    for (n, (run, script)) in plan.runs.iter().zip(scripts).enumerate() {
        let needs = if run.needs == "nothing" { "-" } else { &run.needs };
        rows.push(vec![
            (n + 1).to_string(),
            run.name.clone(),
            run.protocol.clone(),
            run.role.clone(),
            needs.to_owned(),
            span(run.at_most_s),
            preparation(script),
        ]);
    }
    aligned(&rows).iter().for_each(|line| progress.result(line));
    progress.result("");
    let sum = span(plan.at_most_s(0));
    progress.result(&format!("{} runs, at most {sum} of the rig's time; {PLAN_FILE} is not written", plan.runs.len()));
}

/// The rig before the first step, in words.
fn preparation(script: &Script) -> String {
    let start = script.start();
    let valve = |open| if open { "open" } else { "closed" };
    let fill = script.fill_bar.map_or(String::new(), |bar| format!(", chambers at {bar} bar"));
    format!(
        "{}, {} plane, brake {}, bypass {}{fill}",
        fixture(&start.fixture),
        script.plane.as_str(),
        valve(start.brake_open),
        valve(start.bypass_open),
    )
}

fn fixture(fixture: &Fixture) -> String {
    match fixture {
        Fixture::Free => "lever free".to_owned(),
        Fixture::Clamped { angle_deg } => format!("lever clamped at {angle_deg} deg"),
        Fixture::Driven { angle_deg } => format!("lever led to {angle_deg} deg"),
        Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } => {
            format!("lever held at {angle_deg} deg, chambers filled to {pressure1_bar} and {pressure2_bar} bar")
        }
        Fixture::Released { angle_deg, flow_ml_s } => {
            format!("lever held at {angle_deg} deg, {flow_ml_s} ml/s out of chamber 1")
        }
        Fixture::PumpBench { pressure1_bar, pressure2_bar } => {
            format!("pump between reservoirs at {pressure1_bar} and {pressure2_bar} bar")
        }
    }
}
