//! A run or a whole campaign to another format.

use super::content::Content;
use super::format::Format;
use super::output::{Output, unwritten};
use super::source::Source;
use super::{csv_file, mdf_file, parquet_file};
use crate::failure::{Failure, Kind};
use recordings::{CAMPAIGN_FILE, Campaign, RunEntry};
use serde::Serialize;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Name of the list of runs beside files that no campaign can hold.
pub const RUNS_FILE: &str = "runs.toml";

/// Writes one run to `target`.
///
/// # Errors
/// The target exists, the run can't be read to its end, the system refuses, a table that the format can't hold (2). Nothing is left
/// behind.
pub fn export_run(source: &Source, content: Content, format: Format, target: &Path) -> Result<PathBuf, Failure> {
    match format {
        Format::Csv | Format::CsvGz => csv_file::write(source, content, target),
        Format::Parquet => parquet_file::write(source, content, target),
        Format::Mf4 if matches!(content, Content::Rows | Content::Raw) => mdf_file::write(source, content, target),
        Format::Mf4 => {
            let message = format!(
                "{}: expected samples, got --{}; an .mf4 file holds the events and the amplifier's reports anyway, leave the option out",
                target.display(),
                content.name()
            );
            Err(Failure::new(Kind::Input, message))
        }
    }
}

/// Writes every run of the campaign in `dir` to the folder `target`, and a list of them: `campaign.toml` where these are runs that a
/// campaign can hold (the contract's columns as CSV), `runs.toml` otherwise. `each` is told of every file.
///
/// # Errors
/// No campaign; the folder holds one already; as [`export_run`] (2). Runs that were written before the error stay.
pub fn export_campaign(
    dir: &Path,
    content: Content,
    format: Format,
    target: &Path,
    mut each: impl FnMut(&Path),
) -> Result<Campaign, Failure> {
    let campaign = Campaign::open(dir).map_err(|e| Failure::of(Kind::Input, &e))?;
    let runs = renamed(&campaign, format.extension())?;
    for list in [CAMPAIGN_FILE, RUNS_FILE] {
        super::output::refuse_existing(&target.join(list))?;
    }
    for (from, to) in campaign.runs.iter().zip(&runs) {
        let file = target.join(&to.file);
        make_parent(&file)?;
        let source = Source::of_campaign(dir, from)?;
        each(&export_run(&source, content, format, &file)?);
    }
    let exported = Campaign { dir: target.to_owned(), name: campaign.name, rig: campaign.rig, runs };
    if format.is_csv() && content == Content::Rows {
        exported.write_toml().map_err(|e| Failure::of(Kind::Input, &e))?;
        each(&target.join(CAMPAIGN_FILE));
    } else {
        each(&write_list(&exported)?);
    }
    Ok(exported)
}

/// The runs with this extension instead of their own.
///
/// # Errors
/// Two of them would have the same name (2).
pub fn renamed(campaign: &Campaign, extension: &str) -> Result<Vec<RunEntry>, Failure> {
    let mut runs: Vec<RunEntry> = Vec::new();
    for run in &campaign.runs {
        let stem = [".mcap", ".csv.gz", ".csv"].iter().find_map(|known| run.file.strip_suffix(known));
        let file = format!("{}.{extension}", stem.unwrap_or(&run.file));
        if let Some(same) = runs.iter().position(|before| before.file == file) {
            let message = format!(
                "{}: expected runs of different names, got {:?} and {:?}, which would both become {file:?}; rename one of them",
                campaign.dir.join(CAMPAIGN_FILE).display(),
                campaign.runs[same].file,
                run.file
            );
            return Err(Failure::new(Kind::Input, message));
        }
        runs.push(RunEntry { file, ..run.clone() });
    }
    Ok(runs)
}

/// Makes the folder in which `file` is to stand.
///
/// # Errors
/// The system refuses (2).
pub fn make_parent(file: &Path) -> Result<(), Failure> {
    let parent = file.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(|e| unwritten(parent, &e))
}

/// What `campaign.toml` says, for files that the bench does not read.
fn write_list(campaign: &Campaign) -> Result<PathBuf, Failure> {
    #[derive(Serialize)]
    struct List<'c> {
        name: &'c str,
        rig: Rig,
        run: Vec<Run<'c>>,
    }
    #[derive(Serialize)]
    #[allow(non_snake_case, reason = "the keys of campaign.toml")]
    struct Rig {
        J: f64,
        G: f64,
        u_max: f64,
    }
    #[derive(Serialize)]
    struct Run<'c> {
        file: &'c str,
        protocol: &'c str,
        role: &'c str,
        plane: &'c str,
    }
    let run = |run: &'_ RunEntry| (run.protocol.as_str(), run.role.as_str(), run.plane.as_str());
    let runs = campaign.runs.iter().map(|entry| {
        let (protocol, role, plane) = run(entry);
        Run { file: &entry.file, protocol, role, plane }
    });
    let rig = Rig { J: campaign.rig.inertia_kg_m2, G: campaign.rig.gravity_nm, u_max: campaign.rig.u_max_v };
    let list = List { name: &campaign.name, rig, run: runs.collect() };
    let text = toml::to_string(&list).map_err(|e| Failure::of(Kind::Internal, &e))?;
    let target = campaign.dir.join(RUNS_FILE);
    let mut output = Output::create(&target)?;
    output.write_all(text.as_bytes()).map_err(|e| unwritten(&target, &e))?;
    output.commit()
}
