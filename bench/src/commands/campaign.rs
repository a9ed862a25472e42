//! `bench campaign --out DIR [PROFILE...]`

use super::run::{listening, profile};
use super::time::TimeArgs;
use crate::campaign::{Session, Settings};
use crate::devices::Devices;
use crate::emulation::builtin_scripts;
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use crate::rig_file::{DeviceSpec, Rig};
use crate::setup::Knowledge;
use std::path::PathBuf;

/// Run profiles one after the other and leave a campaign folder
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Profiles, files or names of built-in ones, in their order [default: all experiments of the paper]
    profiles: Vec<String>,
    /// Folder to make; must not hold a campaign
    #[arg(long)]
    out: PathBuf,
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
    let scripts = if args.profiles.is_empty() {
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
    let (switches, _driving) = interrupt::driving()?;
    let mut session = Session::create(settings, progress)?;
    let mut devices = Devices::open(&rig.device, rig.limits.safe_state, &mode, session.journals())?;
    // A campaign measures what it needs: of the emulated plant no more is known than of any other.
    let knowledge = match rig.device {
        DeviceSpec::Emulated(_) => Knowledge::Nothing,
        DeviceSpec::Wired(_) => rig.knowledge,
    };
    let instance = session.instance().to_owned();
    listening(&instance, switches, progress, || {
        session.run_all(&scripts, &mut devices, knowledge, switches, progress)
    })?;
    drop(devices);
    let campaign = session.finish()?;
    progress.result(&format!("campaign: {} runs in {}", campaign.runs.len(), args.out.display()));
    Ok(())
}
