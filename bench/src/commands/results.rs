//! What `identify`, `diagnose` and `demo` have in common: reading, analysing, leaving the results, saying them.

use crate::failure::{Failure, Kind};
use crate::next::{Designed, NEXT_FILE, design};
use crate::progress::Progress;
use crate::report::{Report, render};
use crate::rig_file::RIG_FILE;
use crate::rig_file::Rig;
use crate::setup::Knowledge;
use crate::simulation::effects_of;
use identify::analysis::{Analysis, Depth, WriteError, analyse_from, write_whole};
use identify::declared::Declared;
use identify::figures::text::{between, number};
use identify::findings::{Finding, UNRECOGNISED};
use identify::identification::{IdentifyError, Loaded};
use identify::torque_form::TorqueForm;
use model::ModelFile;
use recordings::McapReader;
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
    analyse_with(dir, out, &Wanted { depth, form, ..Wanted::default() }, progress).map(|r| r.analysis)
}

/// What is to be done with a campaign.
#[derive(Default)]
pub struct Wanted<'a> {
    /// How far.
    pub depth: Depth,
    /// Of the torque.
    pub form: TorqueForm,
    /// Model whose effects are part of what is identified.
    pub declared: Option<&'a Declared>,
    /// The rig that a next run would be made on; `None`: what the campaign says of its own.
    pub rig: Option<&'a Rig>,
}

/// An analysis with the next run, where its verdict leaves something open.
pub struct Results {
    /// The analysis.
    pub analysis: Analysis,
    /// What would settle it.
    pub next: Option<Designed>,
    /// The files that hold it.
    pub written: Vec<PathBuf>,
}

/// As [`analyse_folder`]; designs the next run where the verdict leaves something open.
pub fn analyse_with(dir: &Path, out: Option<&Path>, wanted: &Wanted, progress: &Progress) -> Result<Results, Failure> {
    let Wanted { depth, form, .. } = *wanted;
    let out = out.map_or_else(|| dir.join("analysis"), Path::to_owned);
    let step = progress.step("reading", 0);
    let loaded = Loaded::read(dir).map_err(|e| refused(&e))?;
    let rows: usize = loaded.runs.iter().map(|r| r.recording.len()).sum();
    step.done(&format!("{} runs, {rows} rows", loaded.runs.len()));
    let made = make(&out)?;

    for aside in &loaded.set_aside {
        progress.say(&format!("warning: {}: {}", aside.file, aside.said()));
    }
    let step = progress.step("analysis", 0);
    let result = analyse_from(&loaded, depth, form, wanted.declared, &|text| progress.say(text));
    step.finish();
    let mut analysis = result.map_err(|e| {
        if made {
            // Leaves no empty folder behind; what another program put there meanwhile stays.
            let _ = fs::remove_dir(&out);
        }
        refused(&e)
    })?;
    for failure in analysis.validation.iter().filter_map(|run| run.failure()) {
        progress.say(&format!("warning: {failure}"));
    }
    let next = next_run(&loaded, &mut analysis, wanted.rig, progress)?;
    let mut written = leave(&analysis, &out)?;
    let script = out.join(NEXT_FILE);
    match next.as_ref().and_then(|n| n.script.as_ref()) {
        Some(text) => written.push(write_whole(&script, text).map_err(|e| unwritten(&e))?),
        // one of an earlier analysis would be taken for this one's
        None => drop(fs::remove_file(&script)),
    }
    summary(&analysis).iter().for_each(|line| progress.result(line));
    progress.result("");
    written.iter().for_each(|file| progress.result(&format!("written: {}", file.display())));
    Ok(Results { analysis, next, written })
}

/// Designs the run that settles what is open, and says it in findings and headline.
fn next_run(
    loaded: &Loaded,
    analysis: &mut Analysis,
    rig: Option<&Rig>,
    progress: &Progress,
) -> Result<Option<Designed>, Failure> {
    let own;
    let rig = match rig {
        Some(rig) => rig,
        None => {
            own = surroundings(loaded)?;
            &own
        }
    };
    let designed = design(loaded, analysis, rig, &free_name(loaded), progress)?;
    if let Some(designed) = &designed {
        analysis.headline.retain(|line| !line.starts_with("Next experiment: "));
        analysis.headline.push(format!("Next experiment: {}.", designed.said));
        analysis.report.summary.clone_from(&analysis.headline);
        if let Some(findings) = &mut analysis.findings {
            findings.next_experiment = Some(designed.said.clone());
            findings.next_run.clone_from(&designed.run);
        }
    }
    Ok(designed)
}

/// A name that no run of the campaign has: `next_1`, `next_2`, ...
fn free_name(loaded: &Loaded) -> String {
    let taken = |name: &str| {
        let named = |file: &str| file.split('.').next() == Some(name);
        loaded.campaign.runs.iter().any(|r| named(&r.file)) || loaded.campaign.dir.join(format!("{name}.mcap")).exists()
    };
    (1..).map(|n| format!("next_{n}")).find(|name| !taken(name)).expect("there are more names than files")
}

/// What a campaign says of its rig: the facts of `campaign.toml`, and the limits that its recordings keep.
fn surroundings(loaded: &Loaded) -> Result<Rig, Failure> {
    let mut rig = Rig::read(None)?;
    rig.facts = loaded.campaign.rig;
    rig.knowledge = Knowledge::Nothing;
    rig.name.clone_from(&loaded.campaign.name);
    rig.limits.voltage_max_v = rig.facts.u_max_v * (1.0 + 1e-9);
    for run in loaded.campaign.runs.iter().filter(|r| r.file.ends_with(".mcap")) {
        let path = loaded.campaign.dir.join(&run.file);
        let kept = McapReader::open(&path).ok().and_then(|r| r.run().files.get(RIG_FILE).cloned());
        if let Some(kept) = kept.and_then(|text| Rig::parse(&text, RIG_FILE, Path::new("")).ok()) {
            rig.limits = kept.limits;
            break;
        }
    }
    Ok(rig)
}

/// A model file whose effects are part of what is identified.
pub fn declared_in(file: &Path) -> Result<Declared, Failure> {
    let model = ModelFile::read(file).map_err(|e| Failure::of(Kind::Input, &e))?;
    let effects = effects_of(&model).map_err(|e| Failure::new(Kind::Input, format!("{}: {e}", file.display())))?;
    Ok(Declared { parameters: model.parameters, effects })
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
        out.push(String::new());
        out.extend(added(&findings.effects));
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

/// What was added: every parameter of an effect, and of terms without a name those that are known to be other than zero. The others trade places with them
/// and with each other, so what they do is seen as a curve alone.
fn added(effects: &[Finding]) -> Vec<String> {
    let mut rows = vec![
        ["effect", "balance", "parameter", "value", "std. error", "95 % interval", "unit"].map(String::from).to_vec(),
    ];
    let mut open = 0;
    for effect in effects {
        for (name, v) in &effect.parameters.0 {
            if effect.id == UNRECOGNISED && (v.interval[0]..=v.interval[1]).contains(&0.0) {
                open += 1;
                continue;
            }
            let (id, balance) = (effect.id.to_string(), effect.balance.to_string());
            let known = between(v.interval, v.std);
            rows.push(vec![
                id,
                balance,
                name.to_string(),
                number(v.value, 4),
                number(v.std, 2),
                known,
                v.unit.to_string(),
            ]);
        }
    }
    let mut out = if rows.len() > 1 { aligned(&rows) } else { Vec::new() };
    if open > 0 {
        out.push(format!(
            "Terms without a name that may each be zero: {open}. What all terms do together is a curve in {REPORT_FILE}; their values are in findings.json."
        ));
    }
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
    use identify::findings::{Named, Value};

    #[test]
    fn numbers_stand_to_the_right_and_texts_to_the_left() {
        let rows = [["run", "RMSE"], ["a", "12.5"], ["square", "1e-3"]].map(|r| r.map(String::from).to_vec());
        assert_eq!(aligned(&rows), ["run     RMSE", "a       12.5", "square  1e-3"]);
        assert!(aligned(&[]).is_empty());
    }

    #[test]
    fn of_terms_without_a_name_those_are_told_that_are_known_to_be_other_than_zero() {
        let value = |value: f64, half: f64| Value {
            value,
            std: half / 2.0,
            unit: "Nm",
            interval: [value - half, value + half],
        };
        let of = |id: &'static str, known: f64, open: f64| Finding {
            id,
            balance: "torque",
            probability: 1.0,
            equivalent: Vec::new(),
            parameters: Named(vec![("sine", value(known, 0.1)), ("cosine", value(open, 0.3))]),
        };
        let told = |effect: Finding| added(&[effect]).join("\n");
        let named = told(of("tilt", 1.0, 0.2));
        assert!(named.contains("sine") && named.contains("cosine") && !named.contains("without a name"), "{named}");
        let some = told(of(UNRECOGNISED, 1.0, 0.2));
        assert!(
            some.contains(" sine")
                && !some.contains("cosine")
                && some.contains("\nTerms without a name that may each be zero: 1."),
            "{some}"
        );
        let none = told(of(UNRECOGNISED, 0.05, 0.2));
        assert!(none.starts_with("Terms without a name that may each be zero: 2.") && !none.contains("sine"), "{none}");
    }

    #[test]
    fn a_model_with_an_incomplete_effect_is_refused_with_its_file_and_what_it_lacks() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model.toml");
        let mut model = ModelFile::plain(model::Parameters::example());
        let parameters = [("k", 1.0), ("w_v", 0.1)].map(|(name, value)| (name.to_owned(), value));
        let added = model::parameters::AddedEffect { id: "stribeck_friction".into(), parameters: parameters.into() };
        model.effect.push(added);
        std::fs::write(&file, model.to_toml()).unwrap();
        let Err(refused) = declared_in(&file) else { panic!("its parameter w_s is missing") };
        assert_eq!(refused.kind, Kind::Input);
        for said in [&file.display().to_string(), "stribeck_friction", "\"w_s\""] {
            assert!(refused.message.contains(said), "{said}: {}", refused.message);
        }
    }
}
