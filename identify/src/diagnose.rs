//! From the residual to a named effect: score, refit, compare, accept or refuse.
//!
//! A candidate is added only when several judges agree: the score test's p-value over the whole library, the improvement
//! cluster by cluster, its size against the noise floor, its parameters' intervals and physical bounds. What is then left of
//! the residual decides between a known effect, two that can't be told apart, and none that is known.

use model::effects::empirical::EMPIRICAL;
use model::effects::{Balance, Effect, LIBRARY};
use model::integrate::SimulationError;

use crate::fit::{Effort, Fit};
use crate::identification::{Identified, covariance_of, standard_errors};
use crate::misfit::{self, Part};
use crate::problem::Problem;
use crate::refit::{Bases, Refit, advantage, refit};
use crate::score::{Direction, Gram, Scene};
use crate::significance::p_of_largest;
use crate::simplify::simplify;

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
/// Above this cost a target no candidate has come near the data, and polishing them is in vain.
const POOR: f64 = 20.0;
/// A rival explains at least this share of what the best candidate does.
const RIVAL: f64 = 0.95;
/// Most effects that are added one after the other.
const MOST_EFFECTS: usize = 3;

/// Candidates are screened and first refitted on this much of each run with a free lever, s; the leaders then on all.
const BRIEF_S: f64 = 40.0;
/// Horizon over which a start from the component experiments is led, s.
const SHORT_S: f64 = 8.0;
/// Structured residual (noise floors) from which an effect counts as gross.
const GROSS: f64 = 1.5;

/// A round of candidates at the current model.
struct Round<'a> {
    scene: Scene<'a>,
    directions: Vec<Direction>,
    gram: Gram,
}

impl<'a> Round<'a> {
    fn new(
        problem: &'a Problem,
        fit: &'a Fit,
        candidates: impl Iterator<Item = &'static dyn Effect>,
    ) -> Result<Self, SimulationError> {
        let scene = Scene::new(problem, fit)?;
        let directions: Vec<Direction> = candidates.flat_map(|e| scene.directions(e)).collect();
        let gram = Gram::new(&directions);
        Ok(Round { scene, directions, gram })
    }

    /// Positions of an effect's directions that may be used, the best first.
    fn of(&self, id: &str) -> Vec<usize> {
        let mut out: Vec<usize> = (0..self.directions.len())
            .filter(|&i| self.directions[i].effect.header().id == id && self.directions[i].gain() > 0.0)
            .collect();
        out.sort_by(|a, b| self.directions[*b].gain().total_cmp(&self.directions[*a].gain()));
        out
    }

    /// p-value of the largest statistic among the directions of these effects.
    fn p_value(&self, keep: impl Fn(&Direction) -> bool) -> f64 {
        let chosen: Vec<&Direction> = self.directions.iter().filter(|d| keep(d)).collect();
        let evidence: Vec<_> = chosen.iter().map(|d| self.scene.by_cluster(d)).collect();
        let one_sided: Vec<bool> =
            chosen.iter().map(|d| d.effect.header().parameters.iter().all(|p| !p.size || p.lower >= 0.0)).collect();
        p_of_largest(&evidence, &one_sided, 20)
    }

    /// Sets of one effect, and the best of two where two together explain far more than either, the best first.
    fn shortlist(&self, current: &[&'static str], most: usize) -> Vec<Vec<&'static dyn Effect>> {
        let candidates: Vec<&'static dyn Effect> =
            LIBRARY.iter().copied().filter(|e| !current.contains(&e.header().id)).collect();
        let mut singles: Vec<(f64, usize)> = candidates
            .iter()
            .enumerate()
            .map(|(n, e)| (self.gram.gain(&self.of(e.header().id)), n))
            .filter(|(g, _)| *g > 0.0)
            .collect();
        singles.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(&(top, _)) = singles.first() else { return Vec::new() };
        let mut out: Vec<Vec<&'static dyn Effect>> = singles
            .iter()
            .take(most)
            .enumerate()
            .filter(|(i, (g, _))| *i < 3 || *g > 0.1 * top)
            .map(|(_, (_, n))| vec![candidates[*n]])
            .collect();
        // a gross misfit in a few clusters misleads the gain: the two that most clusters agree on are tried as well
        let mut agreed: Vec<(f64, usize)> = (0..candidates.len())
            .map(|n| {
                let own = self.of(candidates[n].header().id);
                let most = own.iter().map(|&i| self.scene.by_cluster(&self.directions[i]).agreement());
                (most.fold(0.0, f64::max), n)
            })
            .collect();
        agreed.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, n) in agreed.into_iter().take(2) {
            if !out.iter().any(|set| set[0].header().id == candidates[n].header().id) {
                out.push(vec![candidates[n]]);
            }
        }
        let mut pair: Option<(f64, usize, usize)> = None;
        for i in 0..candidates.len() {
            for j in 0..i {
                let both = [self.of(candidates[i].header().id), self.of(candidates[j].header().id)].concat();
                let gain = self.gram.gain(&both);
                if pair.is_none_or(|(g, _, _)| gain > g) {
                    pair = Some((gain, i, j));
                }
            }
        }
        if let Some((gain, i, j)) = pair
            && gain > 1.5 * top
        {
            out.push(vec![candidates[i], candidates[j]]);
        }
        out
    }
}

/// Runs the whole chain.
pub fn diagnose(identified: &Identified, progress: &dyn Fn(&str)) -> Result<Diagnosis, SimulationError> {
    let problem = &identified.problem;
    let brief = &problem.shortened(BRIEF_S);
    let short = &problem.shortened(SHORT_S);
    let component = identified.fit.layout.vector_of(&identified.component);
    let mut current = identified.fit.clone();
    let mut added: Vec<Added> = Vec::new();
    let mut ranking: Vec<Ranked> = Vec::new();
    let mut next_experiment = None;
    let mut tie = false;

    let first = Round::new(brief, &identified.fit, LIBRARY.iter().copied())?;
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
            let open = LIBRARY.iter().copied().filter(|e| !ids.contains(&e.header().id));
            later = Round::new(brief, &current, open)?;
            &later
        };
        let p = round.p_value(|_| true);
        if p > LEVEL && largest < CLEAR {
            tracing::info!(p, "no candidate is significant");
            break;
        }
        let gross = largest > GROSS;
        let shortlist = round.shortlist(&ids, if gross { 6 } else { 5 });
        let bases = Bases { current: &current, component: &component, short, gross };
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
        let open = LIBRARY.iter().copied().filter(|e| !carried.contains(&e.header().id));
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
    if unexplained && let Some((effect, fit)) = empirical(brief, short, problem, identified, &component, progress)? {
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

/// Refits each set of the shortlist; the lowest cost first.
fn refit_all(
    problem: &Problem,
    bases: &Bases,
    round: &Round,
    shortlist: &[Vec<&'static dyn Effect>],
    progress: &dyn Fn(&str),
) -> Vec<Refit> {
    let mut out: Vec<Refit> = Vec::new();
    for set in shortlist {
        let best = out.iter().map(|r| r.fit.cost).fold(f64::INFINITY, f64::min);
        let added: Vec<(&'static dyn Effect, Vec<&Direction>)> = set
            .iter()
            .map(|e| (*e, round.of(e.header().id).into_iter().map(|i| &round.directions[i]).collect()))
            .collect();
        let effort = Effort {
            iterations: if bases.gross { 7 } else { 10 },
            tolerance: 3e-4,
            hopeless_above: best * 1.5,
            patience: 2,
        };
        if let Some(r) = refit(problem, bases, &added, effort) {
            let names: Vec<&str> = r.added.clone();
            progress(&format!("{} refitted: cost {:.0} from {:.0}", names.join(" + "), r.fit.cost, bases.current.cost));
            out.push(r);
        }
    }
    // those that come near the best are brought to their minimum before they are compared
    let best = out.iter().map(|r| r.fit.cost).fold(f64::INFINITY, f64::min);
    if best > POOR * problem.targets() as f64 {
        out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
        return out;
    }
    let near = best + 0.3 * (problem.cost(&bases.current.layout, &bases.current.point) - best).max(0.0);
    for r in out.iter_mut().filter(|r| r.fit.cost <= near) {
        let effort = Effort { iterations: 10, tolerance: 1e-6, ..Effort::default() };
        if let Ok(fit) = crate::fit::fit(problem, &r.fit.layout, r.fit.point.clone(), effort) {
            r.fit = fit;
        }
    }
    out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    out
}

/// Brings a fit of the brief runs to the whole ones. More must not come out as worse: where the brief fit's point does, the
/// current model's base with the effect's values leads instead.
fn on_the_whole(problem: &Problem, current: &Fit, brief: &Fit, effort: Effort) -> Option<Fit> {
    let led = crate::fit::fit(problem, &brief.layout, brief.point.clone(), effort).ok();
    if led.as_ref().is_some_and(|f| f.cost < current.cost) {
        return led;
    }
    let mut point = current.point.clone();
    point.theta.extend_from_slice(&brief.point.theta[current.point.theta.len()..]);
    let warm = crate::fit::fit(problem, &brief.layout, point, effort).ok();
    led.into_iter().chain(warm).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// The effect's sizes together are known to be other than zero, and none is pressed against a physical bound.
fn is_sound(fit: &Fit, covariance: &nalgebra::DMatrix<f64>, n: usize) -> bool {
    let first = fit.layout.first_of(n);
    let mut sizes = Vec::new();
    for (i, p) in fit.layout.effects[n].header().parameters.iter().enumerate().filter(|(_, p)| p.size) {
        let value = fit.point.theta[first + i];
        if value >= p.upper || (p.lower < 0.0 && value <= p.lower) {
            return false;
        }
        if covariance[(first + i, first + i)].is_finite() {
            sizes.push(first + i);
        }
    }
    // Wald's test of all sizes together: single ones may be exchangeable (the zeros of two sensors, say)
    let value = nalgebra::DVector::from_iterator(sizes.len(), sizes.iter().map(|&i| fit.point.theta[i]));
    let block = covariance.select_rows(&sizes).select_columns(&sizes);
    block.cholesky().is_some_and(|c| value.dot(&c.solve(&value)) > 12.0 + 2.0 * sizes.len() as f64)
}

/// Candidates that explain nearly as much as the best one and that the clusters don't tell from it. `before`: the cost
/// without any of them.
fn rivals(problem: &Problem, refits: &[Refit], before: f64) -> Result<Vec<Refit>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let best = problem.residuals(&refits[0].fit.layout, &refits[0].fit.point)?;
    let mut out = Vec::new();
    for r in &refits[1..] {
        // a set that contains the best one is a refinement, not a rival
        if r.added.iter().any(|id| refits[0].added.contains(id)) {
            continue;
        }
        if before - r.fit.cost < RIVAL * (before - refits[0].fit.cost) {
            continue;
        }
        let other = problem.residuals(&r.fit.layout, &r.fit.point)?;
        let (_, z) = advantage(&other, &best, &clusters, count);
        if z < PREFERRED {
            out.push(r.clone());
        }
    }
    Ok(out)
}

/// Probabilities of the refitted candidates from how far they stand behind the best, in standard errors.
fn rank(problem: &Problem, refits: &[Refit]) -> Result<Vec<Ranked>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let Some(first) = refits.first() else { return Ok(Vec::new()) };
    let best = problem.residuals(&first.fit.layout, &first.fit.point)?;
    let mut weights = Vec::new();
    for r in refits {
        let other = problem.residuals(&r.fit.layout, &r.fit.point)?;
        let (total, z) = advantage(&other, &best, &clusters, count);
        let weight = (-0.5 * z.max(0.0).powi(2)).exp().max((-0.5 * total.max(0.0)).exp());
        weights.push(weight);
    }
    let sum: f64 = weights.iter().sum();
    Ok(refits.iter().zip(weights).map(|(r, w)| Ranked { id: r.added.join("+"), probability: w / sum }).collect())
}

/// The run in which two models differ most, as advice.
fn where_they_differ(problem: &Problem, a: &Fit, b: &Fit) -> Result<String, SimulationError> {
    let ra = problem.residuals(&a.layout, &a.point)?;
    let rb = problem.residuals(&b.layout, &b.point)?;
    let mut by_run: std::collections::BTreeMap<usize, (f64, usize)> = Default::default();
    for ((s, x), y) in problem.stretches.iter().zip(&ra).zip(&rb) {
        let e = by_run.entry(s.run).or_default();
        for ((x, y), t) in x.iter().zip(y).zip(&s.targets) {
            e.0 += (x - y).powi(2);
            e.1 += t.samples;
        }
    }
    let (run, (sum, n)) = by_run
        .into_iter()
        .max_by(|a, b| (a.1.0 / a.1.1 as f64).total_cmp(&(b.1.0 / b.1.1 as f64)))
        .unwrap_or((0, (0.0, 1)));
    let protocol = problem.stretches.iter().find(|s| s.run == run).map_or("", |s| s.protocol.as_str());
    Ok(format!(
        "another {protocol} run, several times as long or with larger amplitude: there the leading candidates differ most ({:.2} noise floors RMS)",
        (sum / n as f64).sqrt()
    ))
}

/// The balance whose nameless terms explain most, refitted.
fn empirical(
    brief: &Problem,
    short: &Problem,
    problem: &Problem,
    identified: &Identified,
    component: &[f64],
    progress: &dyn Fn(&str),
) -> Result<Option<(&'static dyn Effect, Fit)>, SimulationError> {
    let round = Round::new(brief, &identified.fit, EMPIRICAL.iter().copied())?;
    let mut gains: Vec<(f64, &'static dyn Effect)> =
        EMPIRICAL.iter().map(|e| (round.gram.gain(&round.of(e.header().id)), *e)).collect();
    gains.sort_by(|a, b| b.0.total_cmp(&a.0));
    let bases = Bases { current: &identified.fit, component, short, gross: false };
    let sets: Vec<Vec<&'static dyn Effect>> = gains.into_iter().take(3).map(|(_, e)| vec![e]).collect();
    let Some(best) = refit_all(brief, &bases, &round, &sets, progress).into_iter().next() else { return Ok(None) };
    let effort = Effort { iterations: 8, tolerance: 1e-4, ..Effort::default() };
    let Ok(fit) = crate::fit::fit(problem, &best.fit.layout, best.fit.point, effort) else { return Ok(None) };
    let effect = fit.layout.effects[fit.layout.effects.len() - 1];
    Ok(Some((effect, fit)))
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
    let std = standard_errors(problem, fit)?;
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
