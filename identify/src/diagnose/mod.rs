//! From the residual to a named effect: score, refit, compare, accept or refuse.
//!
//! A candidate is added only when several judges agree: the score test's p-value over the whole library, the improvement
//! cluster by cluster, its size against the noise floor, its parameters' intervals and physical bounds. What is then left of
//! the residual decides between a known effect, two that can't be told apart, and none that is known.

mod compare;
mod round;

use model::effects::{Balance, Effect, LIBRARY};
use model::integrate::SimulationError;

use crate::fit::{Effort, Fit};
use crate::identification::{Identified, covariance_of};
use crate::misfit::{self, Part};
use crate::problem::Problem;
use crate::refit::{Bases, advantage};
use crate::simplify::simplify;
use crate::uncertainty::Uncertainty;
use compare::{empirical, is_sound, on_the_whole, rank, refit_all, rivals, where_they_differ};
use round::Round;

/// What the diagnosis concludes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The declared model explains the data.
    None,
    /// The effects that were added explain it.
    Attributed,
    /// Leading candidates can't be told apart.
    Ambiguous,
    /// No known effect explains it.
    Unrecognised,
}

impl Verdict {
    /// Word in `findings.json`.
    pub fn as_str(self) -> &'static str {
        match self {
            Verdict::None => "none",
            Verdict::Attributed => "attributed",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Unrecognised => "unrecognised",
        }
    }
}

/// A candidate with how likely it is among those that were refitted.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// Id.
    pub id: String,
    /// Between 0 and 1.
    pub probability: f64,
}

/// An effect that was added.
#[derive(Clone, Debug)]
pub struct Added {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Among the candidates of its round.
    pub probability: f64,
    /// Ids that explain the data as well.
    pub equivalent: Vec<String>,
    /// Values in the order of the effect's header.
    pub values: Vec<f64>,
    /// Their standard errors.
    pub std: Vec<f64>,
}

/// The result.
pub struct Diagnosis {
    /// Conclusion.
    pub verdict: Verdict,
    /// What was added (with verdict `Unrecognised`: the empirical term).
    pub effects: Vec<Added>,
    /// Candidates of the first round, the likeliest first.
    pub ranking: Vec<Ranked>,
    /// p-value by balance.
    pub balances: Vec<(Balance, f64)>,
    /// The model with what was added.
    pub after: Fit,
    /// Structured residual by run and channel before.
    pub parts_before: Vec<Part>,
    /// And after.
    pub parts_after: Vec<Part>,
    /// Share of the structured residual that what was added explains; 1 where nothing was to be explained.
    pub explained: f64,
    /// Run that would tell the leading candidates apart.
    pub next_experiment: Option<String>,
}

/// Level of the score test over the whole library.
const LEVEL: f64 = 0.01;
/// Structured residual below this many noise floors (RMS) does not matter.
const MATERIAL: f64 = 0.1;
/// Structured residual (noise floors) that is certainly more than the sensors' own.
const CLEAR: f64 = 0.7;
/// An effect counts as found when it explains at least this share of the structured residual.
const EXPLAINED: f64 = 0.85;
/// Standard errors (by clusters) by which one model must be better than another to be preferred.
const PREFERRED: f64 = 3.0;
/// After a first effect that explains nearly all, a second is looked for from this structured residual on (noise floors).
const SECOND: f64 = 0.3;
/// Most effects that are added one after the other.
const MOST_EFFECTS: usize = 3;

/// Candidates are screened and first refitted on this much of each run with a free lever, s; the leaders then on all.
const BRIEF_S: f64 = 40.0;
/// Horizon over which a start from the component experiments is led, s.
const SHORT_S: f64 = 8.0;
/// Structured residual (noise floors) from which an effect counts as gross.
const GROSS: f64 = 1.5;

/// Runs the whole chain with the whole library.
///
/// # Errors
/// The identified model can't be simulated on the runs that are fitted.
pub fn diagnose(identified: &Identified, progress: &dyn Fn(&str)) -> Result<Diagnosis, SimulationError> {
    diagnose_with(LIBRARY, identified, progress)
}

/// Runs the whole chain with the effects of `library` alone.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_with(
    library: &[&'static dyn Effect],
    identified: &Identified,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, SimulationError> {
    let component = identified.fit.layout.vector_of(&identified.component);
    let declared = Declared { problem: &identified.problem, fit: &identified.fit, component: &component };
    diagnose_declared(library, &declared, progress)
}

/// The declared model of any plant, fitted: what the chain starts from.
pub struct Declared<'a> {
    /// What was fitted.
    pub problem: &'a Problem,
    /// The fit, without effects.
    pub fit: &'a Fit,
    /// Base values that no effect has bent: a second start for gross effects.
    pub component: &'a [f64],
}

/// Runs the whole chain on a plant's declared model with the effects of `library`.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_declared(
    library: &[&'static dyn Effect],
    identified: &Declared,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, SimulationError> {
    let problem = identified.problem;
    let brief = &problem.shortened(BRIEF_S);
    let short = &problem.shortened(SHORT_S);
    let component = identified.component;
    let mut current = identified.fit.clone();
    let mut added: Vec<Added> = Vec::new();
    let mut ranking: Vec<Ranked> = Vec::new();
    let mut next_experiment = None;
    let mut tie = false;

    let first = Round::new(brief, identified.fit, library.iter().copied())?;
    progress("candidates scored");
    let (clusters, count) = crate::score::clusters(problem);
    let residual_before = problem.residuals(&current.layout, &current.point)?;
    let parts_before = misfit::parts(problem, &residual_before, &clusters);

    for round_number in 0..MOST_EFFECTS {
        let residual = problem.residuals(&current.layout, &current.point)?;
        let parts = misfit::parts(problem, &residual, &clusters);
        let ids: Vec<&'static str> = current.layout.effects.iter().map(|e| e.header().id).collect();
        let largest = misfit::largest(&parts);
        tracing::info!(round_number, largest, "structured residual, noise floors");
        // what is left of an effect whose form differs a little is not a second effect
        if largest < MATERIAL
            || (!added.is_empty() && largest < SECOND && explained_share(&parts_before, &parts) > 0.95)
        {
            break;
        }
        let later;
        let round = if round_number == 0 {
            &first
        } else {
            let open = library.iter().copied().filter(|e| !ids.contains(&e.header().id));
            later = Round::new(brief, &current, open)?;
            &later
        };
        let p = round.p_value(|_| true);
        if p > LEVEL && largest < CLEAR {
            tracing::info!(p, "no candidate is significant");
            break;
        }
        let gross = largest > GROSS;
        let shortlist = round.shortlist(library, &ids, if gross { 6 } else { 5 });
        let bases = Bases { current: &current, component, short, gross };
        let refits = refit_all(brief, &bases, round, &shortlist, progress);
        let Some(best) = refits.first() else { break };
        let ranked = rank(brief, &refits)?;
        if ranking.is_empty() {
            ranking = ranked.clone();
        }
        let whole = Effort { iterations: 12, tolerance: 1e-6, ..Effort::default() };
        let Some(fit) = on_the_whole(problem, &current, &best.fit, whole) else { break };
        let after = problem.residuals(&fit.layout, &fit.point)?;
        let (_, better) = advantage(&residual, &after, &clusters, count);
        let remaining = misfit::parts(problem, &after, &clusters);
        let removed = (misfit::total(&parts) - misfit::total(&remaining)).max(0.0).sqrt();
        let covariance = covariance_of(problem, &fit)?;
        let position = |id: &str| fit.layout.effects.iter().position(|e| e.header().id == id);
        let sound = best.added.iter().all(|id| position(id).is_some_and(|n| is_sound(&fit, &covariance, n)));
        tracing::info!(names = ?best.added, better, removed, sound, cost = fit.cost, "best candidate");
        if better < PREFERRED || removed < MATERIAL || !sound {
            break;
        }
        let rivals = rivals(brief, &refits, brief.cost(&current.layout, &current.point))?;
        if let Some(rival) = rivals.first() {
            next_experiment = Some(where_they_differ(brief, &best.fit, &rival.fit)?);
            tie = true;
        }
        for id in &best.added {
            let Some(n) = position(id) else { continue };
            added.push(Added {
                effect: fit.layout.effects[n],
                probability: ranked.iter().find(|r| r.id == best.added.join("+")).map_or(0.0, |r| r.probability),
                equivalent: rivals.iter().map(|r| r.added.join("+")).collect(),
                values: Vec::new(),
                std: Vec::new(),
            });
        }
        progress(&format!("added {}", best.added.join(" and ")));
        current = fit;
    }

    let carried: Vec<&'static str> = current.layout.effects.iter().map(|e| e.header().id).collect();
    let last;
    let last = if carried.is_empty() {
        &first
    } else {
        let open = library.iter().copied().filter(|e| !carried.contains(&e.header().id));
        last = Round::new(brief, &current, open)?;
        &last
    };
    let residual_after = problem.residuals(&current.layout, &current.point)?;
    let mut parts_after = misfit::parts(problem, &residual_after, &clusters);
    let mut explained = explained_share(&parts_before, &parts_after);
    let mut verdict = match (added.is_empty(), tie) {
        (true, _) => Verdict::None,
        (false, true) => Verdict::Ambiguous,
        (false, false) => Verdict::Attributed,
    };
    let mut after = current.clone();
    let unexplained = misfit::largest(&parts_after) >= MATERIAL && (added.is_empty() || explained < EXPLAINED);
    if unexplained && let Some((effect, fit)) = empirical(brief, short, problem, identified, component, progress)? {
        let residual = problem.residuals(&fit.layout, &fit.point)?;
        let parts = misfit::parts(problem, &residual, &clusters);
        let share = explained_share(&parts_before, &parts);
        let (_, better) = advantage(&residual_before, &residual, &clusters, count);
        tracing::info!(balance = effect.header().balance.as_str(), share, explained, better, "empirical term");
        // a weak misfit that no term explains may be the sensors' own; a clear one is there, whether explained or not
        if (share > 0.3 && better > PREFERRED) || misfit::largest(&parts_after) > CLEAR {
            verdict = Verdict::Unrecognised;
            added =
                vec![Added { effect, probability: 1.0, equivalent: Vec::new(), values: Vec::new(), std: Vec::new() }];
            after = fit;
            parts_after = parts;
            explained = share;
        }
    }
    if verdict != Verdict::Unrecognised && !added.is_empty() {
        after = simplify(problem, after)?;
        let residual = problem.residuals(&after.layout, &after.point)?;
        parts_after = misfit::parts(problem, &residual, &clusters);
    }
    let balances = balance_p_values(&first, last, &added);
    fill_values(problem, &after, &mut added)?;
    if verdict == Verdict::None {
        explained = 1.0;
    }
    Ok(Diagnosis {
        verdict,
        effects: added,
        ranking,
        balances,
        after,
        parts_before,
        parts_after,
        explained,
        next_experiment,
    })
}

/// 1 - structured residual after / before, over the parts that decide.
fn explained_share(before: &[Part], after: &[Part]) -> f64 {
    let total = misfit::total(before);
    if total > 0.0 { 1.0 - misfit::total(after) / total } else { 1.0 }
}

/// p-value by balance: of a balance in which something was added, under the declared model; of the others, with that added,
/// so that one effect does not light up every balance.
fn balance_p_values(first: &Round, last: &Round, added: &[Added]) -> Vec<(Balance, f64)> {
    Balance::ALL
        .into_iter()
        .map(|b| {
            let own = added.iter().any(|a| a.effect.header().balance == b);
            let round = if own || added.is_empty() { first } else { last };
            (b, round.p_value(|d| d.effect.header().balance == b))
        })
        .collect()
}

/// Values and standard errors of what was added, from the final fit.
fn fill_values(problem: &Problem, fit: &Fit, added: &mut [Added]) -> Result<(), SimulationError> {
    if added.is_empty() {
        return Ok(());
    }
    let uncertainty = Uncertainty::of(problem, fit)?;
    let std: Vec<f64> = (0..fit.layout.len()).map(|i| uncertainty.of_entry(i)).collect();
    for a in added {
        let id = a.effect.header().id;
        if let Some(n) = fit.layout.effects.iter().position(|e| e.header().id == id) {
            let range = fit.layout.first_of(n)..fit.layout.first_of(n) + a.effect.header().parameters.len();
            a.values = fit.point.theta[range.clone()].to_vec();
            a.std = std[range].to_vec();
        }
    }
    Ok(())
}
