//! `bench simulate MODEL.toml RUN.csv --plane horizontal --out CSV`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::simulation::{added_effects, free_run};
use model::ModelFile;
use model::effects::EffectSet;
use recordings::{Plane, Protocol, Recording};
use std::path::PathBuf;

/// Simulate the model free from a run's first sample with its voltage and valves
///
/// The reference model alone; effects that MODEL.toml carries beside it act with --with-effects. The result has the run's
/// columns and times.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model file, as `identify` writes it
    model: PathBuf,
    /// Recorded run: .csv, .csv.gz or .mcap
    run: PathBuf,
    /// Plane in which the lever moves
    #[arg(long, value_parser = plane)]
    plane: Plane,
    /// Where the simulated run goes: .csv or .csv.gz
    #[arg(long)]
    out: PathBuf,
    /// Let the effects of MODEL.toml act too
    #[arg(long)]
    with_effects: bool,
}

fn plane(word: &str) -> Result<Plane, String> {
    word.parse().map_err(|e: recordings::UnknownWord| e.to_string())
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let input = |error: &dyn std::error::Error| Failure::of(Kind::Input, error);
    let model = ModelFile::read(&args.model).map_err(|e| input(&e))?;
    let effects = if args.with_effects {
        added_effects(&model).map_err(|e| located(&args.model, &e))?
    } else {
        if !model.effect.is_empty() {
            let ids: Vec<&str> = model.effect.iter().map(|e| e.id.as_str()).collect();
            progress.say(&format!("{}: reference model only, without {}", args.model.display(), ids.join(", ")));
        }
        EffectSet::none()
    };
    // A free run needs what the dynamic protocols record: angle and both pressures.
    let recording = Recording::read(&args.run, Protocol::RandomSteps).map_err(|e| input(&e))?;
    let simulated = free_run(&model, &effects, &recording, args.plane).map_err(|e| located(&args.run, &e))?;
    simulated.write_csv(&args.out).map_err(|e| input(&e))?;
    progress.say(&format!("{}: {} rows", args.out.display(), simulated.len()));
    Ok(())
}

fn located(file: &std::path::Path, error: &dyn std::error::Error) -> Failure {
    let mut failure = Failure::of(Kind::Input, error);
    failure.message = format!("{}: {}", file.display(), failure.message);
    failure
}
