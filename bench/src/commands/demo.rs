//! `bench demo [--seed N] [--out DIR]`

use super::results::analyse_folder;
use crate::campaign::make_folder;
use crate::emulation::{draw, drawn_effects, record};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use identify::analysis::{Analysis, Depth};
use identify::diagnose::Verdict;
use identify::figures::text::number;
use model::ModelFile;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Run the paper's experiments on the emulated rig with an undeclared effect, identify the model, name the effect
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Draws the rig, its undeclared effect and its sensors' noise
    #[arg(long, default_value_t = 1, value_parser = super::seed)]
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
    // the recordings alone: the folder of the sealed truth is opened after the findings are written
    let analysis = analyse_folder(&dir, None, Depth::Diagnosis, progress)?;
    let truth = unseal(&dir)?;
    let said = compare(&truth, &analysis);
    said.lines.iter().for_each(|line| progress.result(line));
    if said.agrees {
        Ok(())
    } else {
        let message = format!("the diagnosis of seed {} does not name the sealed effect", args.seed);
        Err(Failure::new(Kind::Acceptance, message))
    }
}

/// What the opened truth says against the findings.
struct Said {
    lines: Vec<String>,
    /// The sealed effects, and no others, were named; or they are in the class that the data can't split.
    agrees: bool,
}

fn compare(truth: &ModelFile, analysis: &Analysis) -> Said {
    let sealed: BTreeSet<&str> = truth.effect.iter().map(|e| e.id.as_str()).collect();
    let mut lines = vec![String::new(), "sealed truth, opened now:".to_owned()];
    for effect in &truth.effect {
        let values = effect.parameters.iter().map(|(name, v)| format!("{name} = {}", number(*v, 4)));
        lines.push(format!("  {}: {}", effect.id, values.collect::<Vec<_>>().join(", ")));
    }
    let Some(diagnosis) = &analysis.diagnosis else { return Said { lines, agrees: false } };
    let named: BTreeSet<&str> = diagnosis.effects.iter().map(|a| a.effect.header().id).collect();
    let class: BTreeSet<&str> = diagnosis
        .effects
        .iter()
        .flat_map(|a| a.equivalent.iter().flat_map(|e| e.split('+')).chain([a.effect.header().id]))
        .collect();
    let agrees = match diagnosis.verdict {
        Verdict::Attributed => named == sealed,
        Verdict::Ambiguous => sealed.is_subset(&class),
        Verdict::None | Verdict::Unrecognised => false,
    };
    lines.push(match (agrees, diagnosis.verdict) {
        (true, Verdict::Attributed) => "the diagnosis named it".to_owned(),
        (true, _) => "the diagnosis named a class that holds it".to_owned(),
        (false, verdict) => format!("the diagnosis said {}, which is not it", verdict.as_str()),
    });
    Said { lines, agrees }
}

/// Reads the sealed truth back.
fn unseal(dir: &Path) -> Result<ModelFile, Failure> {
    ModelFile::read(&dir.join("sealed/truth.toml")).map_err(|e| Failure::of(Kind::Input, &e))
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
