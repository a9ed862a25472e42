//! What `identify`, `diagnose` and `demo` have in common: reading, analysing, leaving the results, saying them.

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::report::{Report, render};
use identify::analysis::{Analysis, Depth, WriteError, analyse_as, write_whole};
use identify::figures::text::number;
use identify::identification::{IdentifyError, Loaded};
use identify::torque_form::TorqueForm;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the report.
pub const REPORT_FILE: &str = "report.html";

/// Analyses the campaign in `dir` and leaves the results in `out` (default: `dir/analysis`): bad input ends it before anything
/// is computed or written. Says the results on stdout.
pub fn analyse_folder(dir: &Path, out: Option<&Path>, depth: Depth, progress: &Progress) -> Result<Analysis, Failure> {
    analyse_folder_as(dir, out, depth, TorqueForm::default(), progress)
}

/// As [`analyse_folder`], with this form of the torque.
pub fn analyse_folder_as(
    dir: &Path,
    out: Option<&Path>,
    depth: Depth,
    form: TorqueForm,
    progress: &Progress,
) -> Result<Analysis, Failure> {
    let out = out.map_or_else(|| dir.join("analysis"), Path::to_owned);
    let step = progress.step("reading", 0);
    let loaded = Loaded::read(dir).map_err(|e| refused(&e))?;
    let rows: usize = loaded.runs.iter().map(|r| r.recording.len()).sum();
    step.done(&format!("{} runs, {rows} rows", loaded.runs.len()));
    let made = make(&out)?;

    let step = progress.step("analysis", 0);
    let result = analyse_as(&loaded, depth, form, &|text| progress.say(text));
    step.finish();
    let analysis = result.map_err(|e| {
        if made {
            // Leaves no empty folder behind; what another program put there meanwhile stays.
            let _ = fs::remove_dir(&out);
        }
        refused(&e)
    })?;
    for failure in analysis.validation.iter().filter_map(|run| run.failure()) {
        progress.say(&format!("warning: {failure}"));
    }
    let written = leave(&analysis, &out)?;
    summary(&analysis).iter().for_each(|line| progress.result(line));
    progress.result("");
    written.iter().for_each(|file| progress.result(&format!("written: {}", file.display())));
    Ok(analysis)
}

/// Writes `model.toml`, `report.json`, `findings.json` (where there was a diagnosis) and `report.html`.
fn leave(analysis: &Analysis, out: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut written = analysis.write(out).map_err(|e| unwritten(&e))?;
    let report = Report {
        title: format!("Campaign {}", analysis.campaign),
        headline: analysis.headline.clone(),
        figures: analysis.figures.clone(),
        tables: analysis.tables.clone(),
    };
    written.push(write_whole(&out.join(REPORT_FILE), &render(&report)).map_err(|e| unwritten(&e))?);
    Ok(written)
}

/// Makes the folder of the results; whether it was missing.
fn make(out: &Path) -> Result<bool, Failure> {
    let missing = !out.exists();
    fs::create_dir_all(out).map_err(|source| unwritten(&WriteError { file: out.to_owned(), source }))?;
    Ok(missing)
}

fn refused(error: &IdentifyError) -> Failure {
    Failure::of(Kind::Input, error)
}

fn unwritten(error: &WriteError) -> Failure {
    Failure::of(Kind::Input, error)
}

/// The results in a few lines: verdict, effects with values and standard errors, errors of the validation runs.
pub fn summary(analysis: &Analysis) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(d) = &analysis.diagnosis {
        out.push(format!("verdict: {}", d.verdict.as_str()));
    }
    out.extend(analysis.headline.iter().cloned());
    if let Some(findings) = &analysis.findings
        && !findings.effects.is_empty()
    {
        let mut rows =
            vec![["effect", "balance", "parameter", "value", "std. error", "unit"].map(String::from).to_vec()];
        for effect in &findings.effects {
            rows.extend(effect.parameters.0.iter().map(|(name, v)| {
                let (id, balance) = (effect.id.to_string(), effect.balance.to_string());
                vec![id, balance, name.to_string(), number(v.value, 4), number(v.std, 2), v.unit.to_string()]
            }));
        }
        out.push(String::new());
        out.extend(aligned(&rows));
    }
    let diagnosed = analysis.diagnosis.is_some();
    let mut rows = vec![vec!["run".to_string(), "channel".to_string()]];
    let heads: &[&str] =
        if diagnosed { &["RMSE before", "RMSE after", "noise floor"] } else { &["RMSE", "noise floor"] };
    rows[0].extend(heads.iter().map(|h| h.to_string()));
    for run in &analysis.validation {
        for c in run.compared() {
            let mut row =
                vec![run.prepared.file.clone(), c.before.channel.column().to_string(), number(c.before.rmse, 3)];
            row.extend(c.after.filter(|_| diagnosed).map(|after| number(after.rmse, 3)));
            row.push(number(c.noise_floor, 3));
            rows.push(row);
        }
    }
    out.push(String::new());
    out.extend(aligned(&rows));
    out
}

/// Rows as columns of equal width; texts to the left, numbers to the right.
pub(super) fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |c: usize| rows.iter().filter_map(|r| r.get(c)).map(|cell| cell.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let numbers: Vec<bool> = (0..columns)
        .map(|c| rows.iter().skip(1).filter_map(|r| r.get(c)).all(|cell| cell.parse::<f64>().is_ok()))
        .collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().enumerate().map(|(c, cell)| {
            let w = widths[c];
            if numbers[c] { format!("{cell:>w$}") } else { format!("{cell:<w$}") }
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_string()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_to_the_right_and_texts_to_the_left() {
        let rows = [["run", "RMSE"], ["a", "12.5"], ["square", "1e-3"]].map(|r| r.map(String::from).to_vec());
        assert_eq!(aligned(&rows), ["run     RMSE", "a       12.5", "square  1e-3"]);
        assert!(aligned(&[]).is_empty());
    }
}
