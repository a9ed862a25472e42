//! From a campaign to its results: model, findings, figures and tables.

use std::path::{Path, PathBuf};

use model::ModelFile;
use model::effects::{Effect, LIBRARY};
use model::integrate::SimulationError;

use crate::consistency::{Check, Material, checks};
use crate::declared::Declared;
use crate::diagnose::{Diagnosis, Verdict, diagnose, diagnose_with};
use crate::figure::{Figure, Table};
use crate::figures::{self, Subject};
use crate::findings::{Findings, Unused};
use crate::fit::Effort;
use crate::identification::{Identified, IdentifyError, Loaded, PROMISE, identify_as};
use crate::judged::{self, not_judged};
use crate::model_file::{declared_fit, model_file};
use crate::rank::rank;
use crate::report::Report;
use crate::score::Scene;
use crate::simplify::uncertainty_of_simplified;
use crate::torque_form::TorqueForm;
use crate::uncertainty::Uncertainty;
use crate::validate::{Prepared, ValidatedRun, prepare_validation, validate};
use crate::whiteness::{Whiteness, whiteness};

/// Name of the model file.
pub const MODEL_FILE: &str = "model.toml";
/// Name of the report's twin for programs.
pub const REPORT_FILE: &str = "report.json";
/// Name of the file with the findings.
pub const FINDINGS_FILE: &str = "findings.json";

/// How far an analysis goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Depth {
    /// Identification and free-run validation of the reference model.
    #[default]
    Identification,
    /// And the diagnosis of what it leaves.
    Diagnosis,
}

/// The results of a campaign.
pub struct Analysis {
    /// Name of the campaign.
    pub campaign: String,
    /// The reference model.
    pub identified: Identified,
    /// What was found; `None` where only an identification was asked for.
    pub diagnosis: Option<Diagnosis>,
    /// The validation runs, simulated.
    pub validation: Vec<ValidatedRun>,
    /// What `model.toml` holds.
    pub model: ModelFile,
    /// What `findings.json` holds.
    pub findings: Option<Findings>,
    /// Checks of the reference model's physics.
    pub checks: Vec<Check>,
    /// What `report.json` holds.
    pub report: Report,
    /// For the report.
    pub figures: Vec<Figure>,
    /// For the report.
    pub tables: Vec<Table>,
    /// For the report: the first line says the verdict.
    pub headline: Vec<String>,
}

/// A result could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: expected to write it, got \"{source}\"; choose another folder with --out, or check its permissions and the free space", file.display())]
pub struct WriteError {
    /// The file or folder.
    pub file: PathBuf,
    /// The system's reason.
    pub source: std::io::Error,
}

/// Runs the analysis. `progress` is told each finished step. The same recordings give the same results.
///
/// # Errors
/// Before anything is computed: no run to be fitted or none to validate, a run that can't be used. Later: the model can't be
/// simulated on the runs that are fitted.
pub fn analyse(loaded: &Loaded, depth: Depth, progress: &dyn Fn(&str)) -> Result<Analysis, IdentifyError> {
    analyse_as(loaded, depth, TorqueForm::SecondEquation, progress)
}

/// As [`analyse`], with this form of the torque.
///
/// # Errors
/// As there.
pub fn analyse_as(
    loaded: &Loaded,
    depth: Depth,
    form: TorqueForm,
    progress: &dyn Fn(&str),
) -> Result<Analysis, IdentifyError> {
    analyse_from(loaded, depth, form, None, progress)
}

/// As [`analyse_as`], with the effects of a declared model as part of the model that is identified. The diagnosis proposes others.
///
/// # Errors
/// As there.
pub fn analyse_from(
    loaded: &Loaded,
    depth: Depth,
    form: TorqueForm,
    declared: Option<&Declared>,
    progress: &dyn Fn(&str),
) -> Result<Analysis, IdentifyError> {
    let prepared = prepare_validation(loaded)?;
    let simulation = |what: &str| {
        let what = what.to_string();
        move |source| IdentifyError::Simulation { what, source }
    };
    let mut identified = identify_as(loaded, form, progress)?;
    if let Some(declared) = declared.filter(|d| !d.effects.is_empty()) {
        let effort = Effort { iterations: 20, tolerance: 1e-6, promise: PROMISE, ..Effort::default() };
        let refitted = declared.refit(&identified.problem, &identified.fit, effort);
        identified.fit = refitted.map_err(simulation("the identify runs with the declared effects"))?;
        // the derivatives are those of the model without the effects
        identified.linear = None;
        progress("joint fit with the declared effects");
    }
    let diagnosis = match (depth, declared) {
        (Depth::Identification, _) => None,
        (Depth::Diagnosis, None) => Some(diagnose(&identified, progress)),
        (Depth::Diagnosis, Some(declared)) => Some(diagnose_with(&declared.open(), &identified, progress)),
    };
    let diagnosis = diagnosis.transpose().map_err(simulation("the identify runs during the diagnosis"))?;

    let analysis = conclude(loaded, prepared, identified, diagnosis).map_err(simulation("the identify runs"))?;
    progress("validation runs simulated, figures and tables made");
    Ok(analysis)
}

/// The results of what was identified and, where it was asked for, found: validation, files, figures and tables.
///
/// # Errors
/// The fitted model can't be simulated on the runs that it was fitted to.
pub fn conclude(
    loaded: &Loaded,
    prepared: Vec<Prepared>,
    mut identified: Identified,
    diagnosis: Option<Diagnosis>,
) -> Result<Analysis, SimulationError> {
    let verdict = diagnosis.as_ref().map(|d| d.verdict);
    let changed = diagnosis.as_ref().filter(|d| d.verdict != Verdict::None);
    let linear = identified.linear.take();
    let problem = &identified.problem;
    let scene = match linear {
        Some(pieces) => {
            let normal = problem.normal(&pieces, identified.fit.layout.len(), &identified.fit.point);
            Scene::of(problem, &identified.fit, pieces, normal)
        }
        None => Scene::new(problem, &identified.fit)?,
    };
    let uncertainty = Uncertainty::of_linear(problem, &identified.fit, &scene.pieces, &scene.normal);
    let carried =
        |e: &&&'static dyn Effect| !identified.fit.layout.effects.iter().any(|c| c.header().id == e.header().id);
    let open: Vec<&'static dyn Effect> = LIBRARY.iter().filter(carried).copied().collect();
    let misfit = identified.fit.cost / problem.targets().max(1) as f64;
    let hidden = match &diagnosis {
        Some(d) => not_judged(&open, problem, &scene, misfit, &d.shows),
        None => Vec::new(),
    };
    let (rank, checks) = {
        let material = Material { loaded, identified: &identified, uncertainty: &uncertainty, scene: &scene };
        let (rank, checks) = rayon::join(|| rank(problem, &identified.fit, &scene.normal), || checks(&material));
        (rank?, checks)
    };
    drop(scene);
    let uncertainty_after = match changed {
        Some(d) => Some(uncertainty_of_simplified(&identified.problem, &d.after)?),
        None => None,
    };
    let by_eq2 = identified.by_eq2.as_ref().map(|fit| validate(loaded, prepared.clone(), fit, None));
    let validation = validate(loaded, prepared, &identified.fit, diagnosis.as_ref().map(|d| &d.after));
    let whiteness = residual_analysis(loaded, &validation);
    let declared = declared_fit(&identified, diagnosis.as_ref());
    let own = match (&uncertainty_after, verdict) {
        (Some(after), Some(Verdict::Attributed)) => after,
        _ => &uncertainty,
    };
    let model = model_file(loaded, &identified, verdict, declared, own);
    let campaign = loaded.campaign.name.clone();
    let findings = diagnosis.as_ref().map(|d| Findings {
        not_judged: hidden.clone(),
        set_aside: loaded.set_aside.iter().map(Unused::of).collect(),
        ..Findings::of(&campaign, d, &validation)
    });
    let subject = Subject {
        loaded,
        identified: &identified,
        uncertainty: &uncertainty,
        diagnosis: diagnosis.as_ref(),
        uncertainty_after: uncertainty_after.as_ref(),
        validation: &validation,
        by_eq2: by_eq2.as_deref(),
        checks: &checks,
        rank: &rank,
        whiteness: &whiteness,
    };
    let (figures, mut tables) = (figures::figures(&subject), figures::tables(&subject));
    if !hidden.is_empty() {
        tables.push(judged::table(&hidden));
    }
    let mut headline = figures::headline(&subject);
    headline.extend(judged::said(&hidden));
    headline.extend(loaded.set_aside.iter().map(|s| format!("{}: {}.", s.file, s.said())));
    let report = Report::of(&subject, &headline);
    Ok(Analysis {
        campaign,
        identified,
        diagnosis,
        validation,
        model,
        findings,
        checks,
        report,
        figures,
        tables,
        headline,
    })
}

/// Of each validation run, with the last model that came to its end.
fn residual_analysis(loaded: &Loaded, validation: &[ValidatedRun]) -> Vec<Whiteness> {
    let last = |run: &ValidatedRun| match (&run.after, &run.before) {
        (Some(Ok(after)), _) => Some(after.clone()),
        (None, Ok(before)) => Some(before.clone()),
        _ => None,
    };
    let runs = validation.iter().filter_map(|run| Some((run, last(run)?)));
    runs.flat_map(|(run, simulated)| whiteness(run, &simulated, &loaded.runs[run.prepared.run].recording)).collect()
}

impl Analysis {
    /// Writes `model.toml`, `report.json` and, where there was a diagnosis, `findings.json` into `out`, which is made where it is missing.
    /// Returns what was written. A file that is there is replaced once the new one is complete.
    ///
    /// # Errors
    /// The system refuses.
    pub fn write(&self, out: &Path) -> Result<Vec<PathBuf>, WriteError> {
        std::fs::create_dir_all(out).map_err(|source| WriteError { file: out.to_owned(), source })?;
        let mut written = vec![write_whole(&out.join(MODEL_FILE), &self.model.to_toml())?];
        written.push(write_whole(&out.join(REPORT_FILE), &self.report.to_json())?);
        if let Some(findings) = &self.findings {
            written.push(write_whole(&out.join(FINDINGS_FILE), &findings.to_json())?);
        }
        Ok(written)
    }
}

/// Writes a text beside its place and moves it there: nobody reads half a file.
///
/// # Errors
/// The system refuses.
pub fn write_whole(file: &Path, text: &str) -> Result<PathBuf, WriteError> {
    let mut part = file.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    std::fs::write(&part, text)
        .and_then(|()| std::fs::rename(&part, file))
        .map_err(|source| WriteError { file: file.to_owned(), source })?;
    Ok(file.to_owned())
}
