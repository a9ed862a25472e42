//! `bench diagnose --plant ID --data FILE`: the diagnosis on a plant that is not the REC rig.

use super::results::{REPORT_FILE, aligned};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::report::{Report, render};
use identify::analysis::{FINDINGS_FILE, write_whole};
use identify::plants::analysis::{PlantAnalysis, analyse};
use identify::plants::{PLANTS, Table, find, report};
use std::path::{Path, PathBuf};

/// What a plant's data are.
#[derive(Debug, clap::Args)]
pub struct PlantArgs {
    /// Another plant than the REC rig (docs/PLANTS.md): silverbox, emps
    #[arg(long, value_name = "ID", requires = "data")]
    pub plant: Option<String>,
    /// The plant's recording, CSV or CSV in gzip
    #[arg(long, value_name = "FILE", requires = "plant")]
    pub data: Option<PathBuf>,
    /// A second recording, which is predicted and never fitted
    #[arg(long, value_name = "FILE", requires = "plant")]
    pub validate: Option<PathBuf>,
}

/// Diagnoses the data of the plant with this id; says the results, and leaves them in `out` if there is one.
pub(super) fn run(
    id: &str,
    data: &Path,
    validate: Option<&Path>,
    out: Option<&Path>,
    json: bool,
    progress: &Progress,
) -> Result<(), Failure> {
    let (stdout, progress) = (progress, &progress.beside(json));
    let known = || PLANTS.iter().map(|p| p.header().id).collect::<Vec<_>>().join(", ");
    let plant = find(id).ok_or_else(|| {
        Failure::new(
            Kind::Input,
            format!("--plant: expected one of {}, got {id}; a campaign of the REC rig needs no --plant", known()),
        )
    })?;
    let input = |e: &dyn std::error::Error| Failure::of(Kind::Input, e);
    let data = Table::read(data).map_err(|e| input(&e))?;
    let validation = validate.map(Table::read).transpose().map_err(|e| input(&e))?;
    progress.say(&format!("{id}: {}; {} rows", plant.header().summary, data.rows()));
    let analysis = analyse(plant, &data, validation.as_ref(), &|text| progress.say(text)).map_err(|e| input(&e))?;
    summary(&analysis).iter().for_each(|line| progress.result(line));
    if let Some(out) = out {
        let written = leave(&analysis, out)?;
        progress.result("");
        written.iter().for_each(|file| progress.result(&format!("written: {}", file.display())));
    }
    if json {
        // As it is in the file.
        stdout.result(analysis.findings.to_json().trim_end());
    }
    Ok(())
}

/// Verdict, effects with standard errors and classes, errors on what was never fitted.
fn summary(analysis: &PlantAnalysis) -> Vec<String> {
    let mut out = vec![format!("verdict: {}", analysis.diagnosis.verdict.as_str())];
    out.extend(report::headline(analysis));
    for table in report::tables(analysis).iter().filter(|t| !t.rows.is_empty()) {
        let mut rows = vec![table.columns.clone()];
        rows.extend(table.rows.iter().cloned());
        out.push(String::new());
        out.extend(aligned(&rows));
    }
    out
}

/// Writes `findings.json` and `report.html`.
fn leave(analysis: &PlantAnalysis, out: &Path) -> Result<Vec<PathBuf>, Failure> {
    let unwritten = |what: &Path, e: &dyn std::fmt::Display| {
        let what = what.display();
        Failure::new(
            Kind::Input,
            format!("{what}: expected to write it, got \"{e}\"; choose another folder with --out"),
        )
    };
    std::fs::create_dir_all(out).map_err(|e| unwritten(out, &e))?;
    let page = Report {
        title: format!("Plant {}", analysis.plant.header().id),
        headline: report::headline(analysis),
        figures: report::figures(analysis),
        tables: report::tables(analysis),
    };
    let files = [(FINDINGS_FILE, analysis.findings.to_json()), (REPORT_FILE, render(&page))];
    files
        .iter()
        .map(|(name, text)| write_whole(&out.join(name), text).map_err(|e| Failure::of(Kind::Input, &e)))
        .collect()
}
