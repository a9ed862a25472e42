//! `bench demo [--seed N] [--out DIR]`

use crate::campaign::make_folder;
use crate::emulation::{draw, drawn_effects, record};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use model::ModelFile;
use std::path::{Path, PathBuf};

/// Run the paper's experiments on the emulated rig with an undeclared effect, identify the model, name the effect
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Draws the rig, its undeclared effect and its sensors' noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Campaign folder to make [default: a new one under recordings/data]
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let dir = args.out.clone().unwrap_or_else(|| free_folder(args.seed));
    let truth = draw(args.seed, drawn_effects());
    make_folder(&dir)?;
    seal(&dir, &truth)?;
    let campaign = record(&dir, &truth, args.seed, progress)?;
    progress.result(&format!("campaign: {} runs in {}", campaign.runs.len(), dir.display()));
    Err(Failure::new(Kind::Internal, "the diagnosis is not connected yet"))
}

/// Puts the truth where nothing that diagnoses looks.
fn seal(dir: &Path, truth: &ModelFile) -> Result<(), Failure> {
    let sealed = dir.join("sealed");
    let written =
        std::fs::create_dir_all(&sealed).and_then(|()| std::fs::write(sealed.join("truth.toml"), truth.to_toml()));
    written.map_err(|error| {
        let message = format!(
            "{}: expected to write the sealed truth, got \"{error}\"; check the folder and the free space",
            sealed.display()
        );
        Failure::new(Kind::Loss, message)
    })
}

/// A folder that is not there yet: each demo leaves its own.
fn free_folder(seed: u64) -> PathBuf {
    let name = |n: u32| {
        let again = if n > 1 { format!("-{n}") } else { String::new() };
        PathBuf::from(format!("recordings/data/demo-seed{seed}{again}"))
    };
    (1..).map(name).find(|dir| !dir.exists()).expect("there are more names than folders")
}
