//! From a plant's data file to findings: the same chain as for a campaign of the REC rig.

use model::integrate::SimulationError;
use recordings::Role;

use super::classes::{complete_classes, equivalents, keep_what_beats_surrogates, verdict};
use super::{DataError, Section, Source, Table, TablePlant};
use crate::diagnose::{Declared, Diagnosis, Verdict, diagnose_declared};
use crate::false_minimum::left_behind;
use crate::findings::{Findings, UNRECOGNISED, Validation, finding};
use crate::fit::{Effort, Fit, fit};
use crate::kept::Kept;
use crate::layout::Layout;
use crate::noise::{mean, white_std_of_adjacent};
use crate::plant::{Plant, Quantity};
use crate::prepare::Stretch;
use crate::problem::Problem;
use crate::simplify::uncertainty_of_simplified;

/// What can go wrong from a file to findings.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The file can't be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// There is nothing to fit, or nothing to validate on.
    #[error("plant {plant}: {why}")]
    Missing {
        /// The plant.
        plant: &'static str,
        /// Expected, got, remedy.
        why: String,
    },
    /// The model could not be simulated.
    #[error("simulation of {what}: {source}")]
    Simulation {
        /// Which section.
        what: String,
        /// Why.
        source: SimulationError,
    },
}

/// How well a model predicts one channel of a section in free run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Error {
    /// Root mean square, in the channel's unit.
    pub rmse: f64,
    /// Norm of the error over the norm of what was measured.
    pub relative: f64,
}

/// One channel of a section that was never fitted.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The section.
    pub section: &'static str,
    /// The channel.
    pub channel: Quantity,
    /// Rows that were compared.
    pub rows: usize,
    /// The declared model's; `None` where its free run ended before the data did.
    pub before: Option<Error>,
    /// With what was added.
    pub after: Option<Error>,
}

/// A section beside both models, for the report: time (s), measured, before, after of each channel.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// The section.
    pub section: &'static str,
    /// The channel.
    pub channel: Quantity,
    /// Rows: time (s), measured, declared model, model with what was added.
    pub rows: Vec<[f64; 4]>,
}

/// The results.
pub struct PlantAnalysis {
    /// Whose.
    pub plant: &'static dyn TablePlant,
    /// What was fitted.
    pub problem: Problem,
    /// The declared model.
    pub declared: Fit,
    /// Standard errors of its parameters.
    pub declared_std: Vec<f64>,
    /// What was found; equivalents included.
    pub diagnosis: Diagnosis,
    /// Standard errors of the parameters with what was added.
    pub after_std: Vec<f64>,
    /// By section and channel.
    pub scored: Vec<Scored>,
    /// By section and channel.
    pub overlays: Vec<Overlay>,
    /// `findings.json`.
    pub findings: Findings,
}

/// The problem of the sections that are fitted, and those that are predicted.
///
/// # Errors
/// A file can't be used, or there is nothing of one kind.
pub fn sections(
    plant: &'static dyn TablePlant,
    data: &Table,
    validation: Option<&Table>,
) -> Result<(Problem, Vec<Section>), PlantError> {
    let mut all = plant.sections(data, Source::Data)?;
    if let Some(table) = validation {
        // whatever a file for validation holds is never fitted
        all.extend(plant.sections(table, Source::Validation)?.into_iter().filter(|s| s.role == Role::Validate));
    }
    let (fitted, predicted): (Vec<Section>, Vec<Section>) = all.into_iter().partition(|s| s.role == Role::Identify);
    let missing = |why: &str| PlantError::Missing { plant: plant.header().id, why: why.to_string() };
    if fitted.is_empty() {
        return Err(missing("expected a section that is fitted in the data file, got none"));
    }
    if predicted.is_empty() {
        return Err(missing("expected data that are never fitted, got none; give a second file with --validate"));
    }
    Ok((problem_from(plant, fitted.into_iter().flat_map(|s| s.stretches).collect()), predicted))
}

/// The problem of what is fitted alone.
///
/// # Errors
/// The file can't be used, or holds nothing that is fitted.
pub fn problem_of(plant: &'static dyn TablePlant, data: &Table) -> Result<Problem, PlantError> {
    let all = plant.sections(data, Source::Data)?;
    let fitted: Vec<Stretch> = all.into_iter().filter(|s| s.role == Role::Identify).flat_map(|s| s.stretches).collect();
    if fitted.is_empty() {
        let why = "expected a section that is fitted in the data file, got none".to_string();
        return Err(PlantError::Missing { plant: plant.header().id, why });
    }
    Ok(problem_from(plant, fitted))
}

/// Stretches with weights: the noise that a channel shows, and the plant's resolution of its RMS.
pub fn problem_from(plant: &'static dyn TablePlant, stretches: Vec<Stretch>) -> Problem {
    let channels = plant.header().channels.len();
    let std: Vec<f64> = (0..channels)
        .map(|c| {
            let mut series = Vec::new();
            for s in &stretches {
                series.extend(s.measured.get(c).into_iter().flatten().copied());
                series.push(f64::NAN);
            }
            let (middle, _) = mean(series.iter().copied());
            let (square, _) = mean(series.iter().map(|v| (v - middle).powi(2)));
            // a sampled signal moves between its samples as well: no noise is more than what is left of the signal
            let noise = white_std_of_adjacent(&series).unwrap_or(0.0).min(plant.resolution() * square.sqrt());
            noise.hypot(plant.resolution() * square.sqrt()).max(f64::MIN_POSITIVE)
        })
        .collect();
    let steps = vec![vec![0.0; channels]; stretches.len()];
    Problem { plant, std: vec![std; stretches.len()], steps, stretches, kept: Kept::default() }
}

/// Fits the declared model, looks for what it lacks in the plant's whole library, and predicts what was never fitted.
///
/// # Errors
/// See [`PlantError`].
pub fn analyse(
    plant: &'static dyn TablePlant,
    data: &Table,
    validation: Option<&Table>,
    progress: &dyn Fn(&str),
) -> Result<PlantAnalysis, PlantError> {
    let (problem, predicted) = sections(plant, data, validation)?;
    let fitting = |source| PlantError::Simulation { what: "what is fitted".into(), source };
    let declared = fit_declared(plant, &problem).map_err(fitting)?;
    progress("declared model fitted");
    let start = Layout::of_plant(plant).fixed;
    let base = Declared { problem: &problem, fit: &declared, component: &start };
    let library = plant.header().library;
    let mut diagnosis = diagnose_declared(library, &base, progress).map_err(fitting)?;
    let unrecognised = diagnosis.verdict == Verdict::Unrecognised;
    if !unrecognised {
        complete_classes(&problem, &mut diagnosis, library).map_err(fitting)?;
        keep_what_beats_surrogates(&problem, &mut diagnosis, library).map_err(fitting)?;
        progress("effects held against surrogates");
        for added in &mut diagnosis.effects {
            added.equivalent = equivalents(&problem, &diagnosis.after, added, library).map_err(fitting)?;
        }
        diagnosis.verdict = verdict(&diagnosis);
    }
    let errors = |fit: &Fit| -> Result<Vec<f64>, SimulationError> {
        let uncertainty = uncertainty_of_simplified(&problem, fit)?;
        Ok((0..fit.layout.len()).map(|i| uncertainty.of_entry(i)).collect())
    };
    let (declared_std, after_std) = (errors(&declared).map_err(fitting)?, errors(&diagnosis.after).map_err(fitting)?);
    progress("predicting what was never fitted");
    let (mut scored, mut overlays) = (Vec::new(), Vec::new());
    for section in &predicted {
        predict(plant, section, &declared, &diagnosis.after, &mut scored, &mut overlays);
    }
    let findings = findings(plant, &problem, &diagnosis, &scored);
    Ok(PlantAnalysis { plant, problem, declared, declared_std, diagnosis, after_std, scored, overlays, findings })
}

/// The declared model's fit, from the header's start values.
///
/// # Errors
/// It can't be simulated there.
pub fn fit_declared(plant: &'static dyn TablePlant, problem: &Problem) -> Result<Fit, SimulationError> {
    let layout = Layout::of_plant(plant);
    let to_the_end = Effort { iterations: 60, tolerance: 1e-9, ..Effort::default() };
    let reached = fit(problem, &layout, problem.point(layout.fixed.clone()), to_the_end)?;
    let cost = reached.cost;
    let lowest = left_behind(problem, reached, &layout.fixed);
    if lowest.cost < cost { fit(problem, &layout, lowest.point, to_the_end) } else { Ok(lowest) }
}

/// Free run of a section with both models.
fn predict(
    plant: &dyn Plant,
    section: &Section,
    before: &Fit,
    after: &Fit,
    scored: &mut Vec<Scored>,
    overlays: &mut Vec<Overlay>,
) {
    let run = |fit: &Fit| -> Option<Vec<Vec<Vec<f64>>>> {
        let free = |s: &Stretch| plant.rows(s, &fit.layout, &fit.point.theta, &vec![0.0; s.initial.len()]);
        section.stretches.iter().map(free).collect::<Result<_, _>>().ok()
    };
    let (first, second) = (run(before), run(after));
    for (c, channel) in plant.header().channels.iter().enumerate() {
        let mut overlay = Vec::new();
        for (n, s) in section.stretches.iter().enumerate() {
            let Some(measured) = s.measured.get(c).filter(|m| !m.is_empty()) else { continue };
            let of = |rows: &Option<Vec<Vec<Vec<f64>>>>, i: usize| rows.as_ref().map_or(f64::NAN, |r| r[n][i][c]);
            let compared = (0..s.rows()).filter(|&i| measured[i].is_finite());
            overlay.extend(compared.map(|i| [s.time_s[i], measured[i], of(&first, i), of(&second, i)]));
        }
        let norm: f64 = overlay.iter().map(|r: &[f64; 4]| r[1] * r[1]).sum();
        let error = |column: usize| {
            let square: f64 = overlay.iter().map(|r| (r[1] - r[column]).powi(2)).sum();
            let rmse = (square / overlay.len() as f64).sqrt();
            rmse.is_finite().then(|| Error { rmse, relative: (square / norm).sqrt() })
        };
        let (before, after) = (error(2), error(3));
        scored.push(Scored { section: section.name, channel: *channel, rows: overlay.len(), before, after });
        overlays.push(Overlay { section: section.name, channel: *channel, rows: overlay });
    }
}

fn findings(plant: &dyn Plant, problem: &Problem, diagnosis: &Diagnosis, scored: &[Scored]) -> Findings {
    let header = plant.header();
    let mut out = Findings::of(header.id, diagnosis, &[]);
    let word = |b| header.balances.iter().find(|(own, _)| *own == b).map(|(_, word)| *word);
    out.effects = diagnosis
        .effects
        .iter()
        .map(|a| {
            let id = if diagnosis.verdict == Verdict::Unrecognised { UNRECOGNISED } else { a.effect.header().id };
            let mut f = finding(id, diagnosis, a);
            f.balance = word(a.effect.header().balance).unwrap_or(f.balance);
            f
        })
        .collect();
    out.balances.0.retain_mut(|(name, _)| {
        let own = header.balances.iter().find(|(b, _)| b.as_str() == *name);
        own.inspect(|(_, word)| *name = word).is_some()
    });
    let channel = |q: Quantity| header.channels.iter().position(|c| *c == q).unwrap_or(0);
    out.validation = scored
        .iter()
        .filter_map(|s| {
            Some(Validation {
                run: s.section.to_string(),
                channel: s.channel.name,
                rmse_before: s.before?.rmse,
                rmse_after: s.after?.rmse,
                noise_floor: problem.std[0][channel(s.channel)],
            })
        })
        .collect();
    out
}
