//! `bench simulate MODEL.toml RUN.mcap|RUN.csv --out CSV`

use crate::exchange::csv_file::write_run;
use crate::exchange::format::Format;
use crate::exchange::output::refuse_existing;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::simulation::{added_effects, free_run};
use model::ModelFile;
use model::effects::EffectSet;
use recordings::{McapReader, Plane, Protocol, Recording, RunMetadata};
use std::path::{Path, PathBuf};

/// Simulate the model free from a run's first sample with its voltage and valves
///
/// The reference model alone; effects that MODEL.toml carries beside it act with --with-effects. The result has the run's
/// columns and times. Nothing is ever overwritten.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model file, as `identify` writes it
    model: PathBuf,
    /// Recorded run: .mcap, .csv or .csv.gz
    run: PathBuf,
    /// Plane in which the lever moves; needed for a CSV file, an .mcap recording says it itself
    #[arg(long, value_parser = plane)]
    plane: Option<Plane>,
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
    // What would be refused only at the end is refused before anything is simulated.
    free_csv(&args.out)?;
    let (protocol, plane) = what_it_is(args)?;
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
    let recording = Recording::read(&args.run, protocol).map_err(|e| input(&e))?;
    let simulated = free_run(&model, &effects, &recording, plane).map_err(|e| located(&args.run, &e))?;
    let written = write_run(&simulated, &args.out)?;
    progress.say(&format!("{}: {} rows", written.display(), simulated.len()));
    Ok(())
}

/// Whether the name is one of a CSV file, and free.
fn free_csv(out: &Path) -> Result<(), Failure> {
    if !Format::of_file(out, None).is_ok_and(Format::is_csv) {
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        let message = format!(
            "--out {}: expected a file name that ends in .csv or .csv.gz, got {name:?}; name it so",
            out.display()
        );
        return Err(Failure::new(Kind::Input, message));
    }
    refuse_existing(out)
}

/// Which experiment the run is, and how the lever's plane lies: a recording says so itself, a CSV file does not.
fn what_it_is(args: &Args) -> Result<(Protocol, Plane), Failure> {
    let run = args.run.display();
    if args.run.extension().is_none_or(|extension| extension != "mcap") {
        let plane = args.plane.ok_or_else(|| {
            let message = format!(
                "{run}: expected --plane horizontal or --plane vertical, got neither; a CSV file does not say how the lever's plane lies"
            );
            Failure::new(Kind::Input, message)
        })?;
        // A free run needs what the dynamic protocols record: angle and both pressures.
        return Ok((Protocol::RandomSteps, plane));
    }
    let reader = McapReader::open(&args.run).map_err(|e| Failure::of(Kind::Input, &e))?;
    let RunMetadata { protocol, plane, .. } = *reader.run();
    match args.plane {
        Some(asked) if asked != plane => {
            let message = format!(
                "{run}: expected the plane of the recording, \"{plane}\", got --plane {asked}; leave --plane out, or name the recording that was meant"
            );
            Err(Failure::new(Kind::Input, message))
        }
        _ => Ok((protocol, plane)),
    }
}

fn located(file: &Path, error: &dyn std::error::Error) -> Failure {
    let mut failure = Failure::of(Kind::Input, error);
    failure.message = format!("{}: {}", file.display(), failure.message);
    failure
}
