//! `bench diagnose DIR [--out OUT] [--model MODEL.toml] [--rig RIG.toml] [--auto]`,
//! `bench diagnose --plant ID --data FILE [--validate FILE] [--out OUT]`

use super::diagnose_plant::{self, PlantArgs};
use super::results::{Wanted, analyse_with, declared_in};
use super::results_json::as_json;
use crate::failure::{Failure, Kind};
use crate::next::auto::{Auto, Budget};
use crate::progress::Progress;
use crate::rig_file::Rig;
use identify::analysis::Depth;
use identify::torque_form::TorqueForm;
use std::path::PathBuf;

/// Identify, find the residual, name the effect: model.toml, findings.json and report.html
///
/// Where the verdict leaves something open, next.toml is the run that would settle it. With --auto an emulated rig makes that run, and the
/// diagnosis is repeated until its verdict stands (exit code 0) or the budget is spent (3).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign folder with campaign.toml
    #[arg(required_unless_present = "plant", conflicts_with = "plant")]
    dir: Option<PathBuf>,
    /// Where the results go [default: DIR/analysis; with --plant nowhere]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Model whose effects ([[effect]]) are part of the declared model; others are looked for
    #[arg(long, value_name = "MODEL.toml", conflicts_with = "plant")]
    model: Option<PathBuf>,
    /// Rig of the next run: its limits, and with --auto its device [default: limits as recorded; with --auto the rig of a demo's folder]
    #[arg(long, conflicts_with = "plant")]
    rig: Option<PathBuf>,
    /// Make the next run on the emulated rig, add it to a copy of the campaign, diagnose again
    #[arg(long, conflicts_with = "plant")]
    auto: bool,
    /// With --auto: rig time of all further runs at most, minutes
    #[arg(long, default_value_t = 15.0, requires = "auto")]
    budget_min: f64,
    /// With --auto: further runs at most
    #[arg(long, default_value_t = 4, requires = "auto")]
    most_runs: usize,
    /// With --auto: seed of the emulated sensors
    #[arg(long, default_value_t = 1, requires = "auto", value_parser = super::seed)]
    seed: u64,
    /// Print the findings as one JSON object
    #[arg(long, conflicts_with = "auto")]
    json: bool,
    #[command(flatten)]
    plant: PlantArgs,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    if let (Some(id), Some(data)) = (&args.plant.plant, &args.plant.data) {
        return diagnose_plant::run(id, data, args.plant.validate.as_deref(), args.out.as_deref(), args.json, progress);
    }
    let dir = args
        .dir
        .as_deref()
        .ok_or_else(|| Failure::new(Kind::Input, "expected a campaign folder, or --plant with --data"))?;
    let declared = args.model.as_deref().map(declared_in).transpose()?;
    if !args.auto {
        let rig = args.rig.as_deref().map(|path| Rig::read(Some(path))).transpose()?;
        let wanted = Wanted {
            depth: Depth::Diagnosis,
            form: TorqueForm::default(),
            declared: declared.as_ref(),
            rig: rig.as_ref(),
        };
        let results = analyse_with(dir, args.out.as_deref(), &wanted, &progress.beside(args.json))?;
        return if args.json { progress.json(&as_json(&results)?) } else { Ok(()) };
    }
    let budget = Budget::new(args.budget_min, args.most_runs)?;
    let auto = Auto { dir, out: args.out.as_deref(), declared: declared.as_ref(), budget, seed: args.seed };
    auto.run(args.rig.as_deref(), progress)
}
