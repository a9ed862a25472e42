//! One case from its draw to its judgement.

use super::case::{Case, Figures, Seconds};
use super::forms::name_of;
use super::judge::{Acting, Named, Outcome, Said, judge};
use super::plan::{Kind, Planned, Stream, chance, plan};
use super::rig::{Rig, Truth, draw};
use super::runs::{Recorded, record};
use super::sensors::in_log;
use super::yardstick::{ChannelError, Yardstick, largest, resized, sized};
use crate::failure::{self, Failure};
use identify::analysis::write_whole;
use identify::diagnose::{Diagnosis, diagnose_with};
use identify::fit::Fit;
use identify::identification::{Identified, IdentifyError, Loaded, identify};
use identify::misfit::{self, Part};
use identify::problem::Problem;
use identify::validate::prepare_validation;
use model::ModelFile;
use model::effects::{Effect, LIBRARY};
use model::integrate::SimulationError;
use model::parameters::AddedEffect;
use std::path::Path;
use std::time::Instant;

/// Commit that last changed what a trial's result comes from; `None` where the program was not built out of a repository.
pub const DIAGNOSIS: Option<&str> = option_env!("REC_BENCH_DIAGNOSIS");
/// Rigs that are drawn for a case until one can run its experiments.
const ATTEMPTS: u64 = 8;
/// Runs with a free lever are this long where sizes are chosen, s.
const BRIEF_S: f64 = 25.0;

/// Why a case came to nothing: a rig or a model that can't be simulated.
#[derive(Debug, thiserror::Error)]
enum Hitch {
    #[error(transparent)]
    Rig(#[from] Failure),
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    #[error("simulation {0}")]
    Simulation(#[from] SimulationError),
    #[error(
        "no sizes found at which the effects have the strength of their kind; the last ones show {0:.1?} noise floors"
    )]
    Strength(Vec<f64>),
}

/// Draws, records, diagnoses and judges the case of this number. `keep`: a folder that gets the campaign and, beside it, the truth.
///
/// # Errors
/// None of the drawn rigs can run the experiments, or the folder can't be written.
pub fn trial(seed: u64, case: usize, keep: Option<&Path>) -> Result<Case, Failure> {
    let planned = plan(seed, case);
    let began = Instant::now();
    let mut hitches = Vec::new();
    for attempt in 0..ATTEMPTS {
        let rig = draw(seed, case, attempt);
        match prepare(seed, &planned, &rig, attempt) {
            Ok(sealed) => {
                if let Some(dir) = keep {
                    leave(dir, &sealed.recorded, &sealed.truth, case)?;
                }
                let drawn = began.elapsed().as_secs_f64();
                return Ok(diagnose_sealed(&planned, attempt, rig, &sealed, drawn));
            }
            Err(hitch) => hitches.push(hitch.to_string()),
        }
    }
    let message = format!("case {case} of seed {seed}: none of {ATTEMPTS} rigs can run it: {}", hitches.join("; "));
    Err(Failure::new(failure::Kind::Internal, message))
}

/// A case before it is diagnosed.
struct Sealed {
    truth: Truth,
    recorded: Recorded,
    /// By effect: the model with all others, fitted; empty where the sizes were taken as they are.
    without: Vec<Fit>,
}

/// The case's effects in their sizes, and its campaign. On the first [`STRICT`] attempts an effect that misses its kind's range of
/// strengths is a hitch; each later one asks for half as much, for there are effects with which no lever stands still any more.
fn prepare(seed: u64, planned: &Planned, rig: &Rig, attempt: u64) -> Result<Sealed, Hitch> {
    let Planned { case, kind, ref effects } = *planned;
    let strict = attempt < STRICT;
    let milder = 0.5f64.powi((attempt + 1).saturating_sub(STRICT) as i32);
    let mut truth = Truth { parameters: rig.parameters, effects: Vec::new() };
    let mut recorded = record(&truth, rig, seed, case)?;
    if effects.is_empty() {
        return Ok(Sealed { truth, recorded, without: Vec::new() });
    }
    let mut rng = chance(seed, Stream::Sizes, u64::MAX - case as u64);
    let (low, high) = (milder * kind.strength().start(), milder * kind.strength().end());
    let wanted: Vec<f64> = effects.iter().map(|_| in_log(&mut rng, low * 1.08, high / 1.08)).collect();
    let yardstick = Yardstick::new(&recorded, BRIEF_S)?;
    for (number, (effect, wanted)) in effects.iter().zip(&wanted).enumerate() {
        let values = sized(&yardstick, &truth, *effect, (seed, case, number), *wanted);
        truth.effects.push((*effect, values));
    }
    // What was computed beside a campaign without the effects is measured in one with them, and put right.
    let mut last = Vec::new();
    for _ in 0..CORRECTIONS {
        recorded = record(&truth, rig, seed, case)?;
        let yardstick = Yardstick::new(&recorded, f64::INFINITY)?;
        last.clear();
        let mut without = Vec::new();
        let mut changed = false;
        for (number, wanted) in wanted.iter().enumerate() {
            let fit = yardstick.best_fit(&truth, |n| n != number)?;
            let shown = largest(&yardstick.errors(&fit)?);
            without.push(fit);
            last.push(shown);
            let (effect, values) = truth.effects[number].clone();
            let next = resized(&truth, effect, &values, (wanted / shown).clamp(0.2, 5.0));
            if !(low..=high).contains(&shown) && next != values {
                truth.effects[number].1 = next;
                changed = true;
            }
        }
        if !changed {
            return if !strict || last.iter().all(|shown| (low * TOLERANCE..=high / TOLERANCE).contains(shown)) {
                Ok(Sealed { truth, recorded, without })
            } else {
                Err(Hitch::Strength(last))
            };
        }
    }
    if strict {
        return Err(Hitch::Strength(last));
    }
    recorded = record(&truth, rig, seed, case)?;
    Ok(Sealed { truth, recorded, without: Vec::new() })
}

/// Rigs on which the effects must have the strength of their kind; on a later one they may be milder, and the table says how strong they
/// are.
const STRICT: u64 = 3;
/// How often sizes are put right by what they show.
const CORRECTIONS: usize = 4;
/// An effect whose sizes are at a bound may miss its kind's range of strengths by this factor.
const TOLERANCE: f64 = 0.7;

fn diagnose_sealed(planned: &Planned, attempt: u64, rig: Rig, sealed: &Sealed, drawn: f64) -> Case {
    let mut out = Case {
        case: planned.case,
        diagnosis: DIAGNOSIS.map(str::to_owned),
        kind: planned.kind,
        attempt,
        rig,
        rig_seconds: sealed.recorded.seconds,
        acting: Vec::new(),
        strength: f64::NAN,
        said: None,
        error: None,
        outcome: Outcome::Failed,
        figures: Figures::default(),
        seconds: Seconds { record: drawn, ..Seconds::default() },
    };
    if let Err(hitch) = fill(&mut out, sealed) {
        out.error = Some(hitch.to_string());
    }
    out
}

fn fill(out: &mut Case, Sealed { truth, recorded, without }: &Sealed) -> Result<(), Hitch> {
    let mut began = Instant::now();
    let mut lap = || std::mem::replace(&mut began, Instant::now()).elapsed().as_secs_f64();
    let yardstick = Yardstick::new(recorded, f64::INFINITY)?;
    let base = match &without[..] {
        [only] => only.clone(),
        _ => yardstick.best_fit(truth, |_| false)?,
    };
    let with = if truth.effects.is_empty() { base.clone() } else { yardstick.best_fit(truth, |_| true)? };
    let (of_base, of_truth) = (yardstick.errors(&base)?, yardstick.errors(&with)?);
    out.strength = largest(&of_base);
    let mut lacking = Vec::new();
    for (number, (effect, values)) in truth.effects.iter().enumerate() {
        let fit = match (truth.effects.len(), without.get(number)) {
            (1, _) => base.clone(),
            (_, Some(known)) => known.clone(),
            (_, None) => yardstick.best_fit(truth, |n| n != number)?,
        };
        out.acting.push(acting(*effect, values, largest(&yardstick.errors(&fit)?)));
        lacking.push(fit);
    }
    out.figures.truth = Some(most(&of_truth));
    out.seconds.measure = lap();

    // From here on until the judge nothing of the truth is used but which effects the library is said to lack.
    let way = std::sync::Mutex::new(Vec::new());
    let note = |text: &str| way.lock().map(|mut w| w.push(text.to_owned())).unwrap_or(());
    let (identified, diagnosis) = diagnosed(out.kind, truth, &recorded.loaded, &note, &mut |seconds| {
        out.seconds.identify = seconds;
    })?;
    out.seconds.diagnose = lap() - out.seconds.identify;
    out.figures.way = way.into_inner().unwrap_or_default();

    // what the declared model makes of the validation is no part of the verdict: it may lead out of what can be simulated
    out.figures.before = yardstick.errors(&identified.fit).ok().map(|errors| most(&errors));
    let cost = |fit: &Fit| cost_by(&identified.problem, fit);
    out.figures.cost_identified = cost(&identified.fit);
    out.figures.cost_after = cost(&diagnosis.after);
    out.figures.cost_base = cost(&base);
    for (acting, fit) in out.acting.iter_mut().zip(&lacking) {
        acting.cost = cost(fit);
        acting.left = left_by(&identified.problem, fit);
    }
    out.figures.cost_truth = cost(&with);
    out.figures.residual_before = Some(misfit::largest(&diagnosis.parts_before));
    out.figures.residual_after = Some(misfit::largest(&diagnosis.parts_after));
    out.figures.left = left(&recorded.loaded, &diagnosis.parts_after);
    out.figures.ranking = diagnosis.ranking.iter().map(|r| (r.id.clone(), r.probability)).collect();
    out.figures.balances = diagnosis.balances.iter().map(|(b, p)| (b.as_str().to_owned(), *p)).collect();
    out.figures.values = values_of(&diagnosis);
    out.figures.intervals = intervals_of(&diagnosis);
    let after = yardstick.errors(&diagnosis.after);
    if let Ok(after) = &after {
        out.figures.after = Some(most(after));
        let ratio = after.iter().zip(&of_truth).map(|(a, t)| a.rmse / t.rmse).fold(0.0, f64::max);
        out.figures.against_truth = Some(ratio);
    }
    let said = said(&diagnosis);
    out.outcome = judge(out.kind, &out.acting, &said, out.figures.as_good());
    out.said = Some(said);
    Ok(())
}

/// The diagnosis of a sealed campaign.
fn diagnosed(
    kind: Kind,
    truth: &Truth,
    loaded: &Loaded,
    note: &dyn Fn(&str),
    identified_after: &mut dyn FnMut(f64),
) -> Result<(Identified, Diagnosis), Hitch> {
    let lacking = |e: &&'static dyn Effect| {
        kind == Kind::Outside && truth.effects.iter().any(|(t, _)| t.header().id == e.header().id)
    };
    let library: Vec<&'static dyn Effect> = LIBRARY.iter().copied().filter(|e| !lacking(e)).collect();
    let began = Instant::now();
    // A command would refuse such a campaign here as well.
    prepare_validation(loaded)?;
    let identified = identify(loaded, note)?;
    identified_after(began.elapsed().as_secs_f64());
    let diagnosis = diagnose_with(&library, &identified, note)?;
    Ok((identified, diagnosis))
}

/// The parts of a residual that are more than noise, the largest first.
fn left(loaded: &Loaded, parts: &[Part]) -> Vec<(String, String, f64, f64)> {
    const MOST: usize = 6;
    let mut parts: Vec<&Part> = parts.iter().filter(|p| p.significance > 3.0).collect();
    parts.sort_by(|a, b| b.structured.total_cmp(&a.structured));
    let one = |p: &&Part| {
        let (file, column) = (&loaded.runs[p.run].entry.file, p.channel.column());
        (file.clone(), column.to_owned(), p.structured.max(0.0).sqrt(), p.significance)
    };
    parts.iter().take(MOST).map(one).collect()
}

/// Cost a target by the weights that the identification found: 1 is noise alone.
fn cost_by(problem: &Problem, fit: &Fit) -> Option<f64> {
    let fits = problem.stretches.len() == fit.point.initial.len();
    let cost = fits.then(|| problem.cost(&fit.layout, &fit.point) / problem.targets() as f64);
    cost.filter(|c| c.is_finite())
}

/// The largest structured residual by the weights that the identification found, noise floors.
fn left_by(problem: &Problem, fit: &Fit) -> Option<f64> {
    let fits = problem.stretches.len() == fit.point.initial.len();
    fits.then(|| misfit::left_by(problem, fit).ok()).flatten()
}

/// The largest error against what was recorded.
fn most(errors: &[ChannelError]) -> f64 {
    errors.iter().map(|e| e.rmse).fold(0.0, f64::max)
}

fn acting(effect: &dyn Effect, values: &[f64], strength: f64) -> Acting {
    let header = effect.header();
    let parameters = header.parameters.iter().zip(values).map(|(p, v)| (p.name.to_owned(), *v)).collect();
    Acting {
        id: name_of(effect).to_owned(),
        balance: header.balance.as_str().to_owned(),
        form: header.id.to_owned(),
        parameters,
        strength,
        cost: None,
        left: None,
    }
}

fn said(diagnosis: &Diagnosis) -> Said {
    let named = diagnosis.effects.iter().map(|a| Named {
        id: a.effect.header().id.to_owned(),
        balance: a.effect.header().balance.as_str().to_owned(),
        probability: a.probability,
        equivalent: a.equivalent.clone(),
    });
    Said { verdict: diagnosis.verdict.as_str().to_owned(), effects: named.collect() }
}

fn values_of(diagnosis: &Diagnosis) -> Vec<(String, f64, Option<f64>)> {
    let each = diagnosis.effects.iter().flat_map(|a| {
        let header = a.effect.header();
        let known = header.parameters.iter().zip(a.values.iter().zip(&a.known));
        known.map(move |(p, (v, known))| {
            (format!("{}.{}", header.id, p.name), *v, Some(known.std).filter(|s| s.is_finite()))
        })
    });
    each.collect()
}

fn intervals_of(diagnosis: &Diagnosis) -> Vec<(String, f64, f64)> {
    let each = diagnosis.effects.iter().flat_map(|a| {
        let header = a.effect.header();
        let known = header.parameters.iter().zip(a.values.iter().zip(&a.known));
        let known =
            known.map(|(p, (v, known))| (p.name, *v, known.half_interval)).filter(|(_, _, half)| half.is_finite());
        known.map(move |(name, v, half)| (format!("{}.{name}", header.id), v - half, v + half))
    });
    each.collect()
}

/// Writes the campaign into `dir/case-K` and the truth into `dir/case-K-truth.toml`.
fn leave(dir: &Path, recorded: &Recorded, truth: &Truth, case: usize) -> Result<(), Failure> {
    let folder = dir.join(format!("case-{case}"));
    let refused = |what: &Path, error: &dyn std::fmt::Display| {
        let message =
            format!("{}: expected to write it, got \"{error}\"; choose another folder with --keep", what.display());
        Failure::new(failure::Kind::Input, message)
    };
    std::fs::create_dir_all(&folder).map_err(|e| refused(&folder, &e))?;
    for run in &recorded.loaded.runs {
        let path = folder.join(&run.entry.file);
        run.recording.write_csv(&path).map_err(|e| refused(&path, &e))?;
    }
    let campaign = recordings::Campaign { dir: folder.clone(), ..recorded.loaded.campaign.clone() };
    campaign.write_toml().map_err(|e| refused(&folder, &e))?;
    let mut file = ModelFile::plain(truth.parameters);
    for (effect, values) in &truth.effects {
        let header = effect.header();
        let parameters = header.parameters.iter().zip(values).map(|(p, v)| (p.name.to_owned(), *v)).collect();
        file.effect.push(AddedEffect { id: header.id.to_owned(), parameters });
    }
    let path = dir.join(format!("case-{case}-truth.toml"));
    write_whole(&path, &file.to_toml()).map_err(|e| Failure::of(failure::Kind::Input, &e))?;
    Ok(())
}
