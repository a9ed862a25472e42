//! How a round's refits compare: which look alike, which explain the data as well, and which is sound.

use model::effects::Effect;
use model::integrate::SimulationError;

use super::refits::ALIKE;
use super::round::Round;
use super::{PREFERRED, Ranked};
use crate::colour::colours;
use crate::fit::Fit;
use crate::misfit;
use crate::problem::Problem;
use crate::refit::{Refit, advantage};

/// A rival explains at least this share of what the best candidate does,
const RIVAL: f64 = 0.95;
/// or at least this, if it leaves nothing but noise and stands no further behind than chance may put it (standard errors): of a weak
/// effect chance explains a part.
const HALF: f64 = 0.5;
const CHANCE: f64 = 2.0;
/// What counts as nothing but noise here, noise floors.
const NOISE: f64 = 0.3;

/// Candidates that were not brought to their minimum, and whose directions hold nearly all of what the best one does: linearly they look like it, so
/// what they leave there must be known.
pub(super) fn look_alikes(
    round: &Round,
    refits: &[Refit],
    open: &[&'static dyn Effect],
) -> Vec<Vec<&'static dyn Effect>> {
    let Some(best) = refits.first() else { return Vec::new() };
    let Some(id) = best.only() else { return Vec::new() };
    open.iter()
        .copied()
        .filter(|e| e.header().id != id)
        // beside one that creeps far from the noise nothing can be told apart, however far it is fitted
        .filter(|e| {
            !refits.iter().any(|r| r.added.contains(&e.header().id) && (r.fit.converged || !best.fit.converged))
        })
        .filter(|e| round.share_held(id, e.header().id).is_some_and(|held| held > ALIKE))
        .map(|e| vec![e])
        .collect()
}

/// Refits and further ones together, the lowest cost first; of the same names the cheapest alone.
pub(super) fn joined(mut refits: Vec<Refit>, more: Vec<Refit>) -> Vec<Refit> {
    refits.extend(more);
    refits.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    let mut seen = std::collections::BTreeSet::new();
    refits.retain(|r| seen.insert(r.added.clone()));
    refits
}

/// Two names of which one alone does all but nothing less stand behind that one: what the other takes is chance, and a second effect that is there shows in the
/// next round. `before`: the cost without any of them.
pub(super) fn fewest_first(
    problem: &Problem,
    mut refits: Vec<Refit>,
    before: f64,
) -> Result<Vec<Refit>, SimulationError> {
    let Some(best) = refits.first().filter(|r| r.only().is_none()) else { return Ok(refits) };
    let part = |r: &Refit| r.only().is_some_and(|id| best.added.contains(&id));
    let Some(place) = refits.iter().position(part) else { return Ok(refits) };
    let residuals = |r: &Refit| problem.residuals(&r.fit.layout, &r.fit.point);
    let (clusters, count) = crate::score::clusters(problem);
    let (_, worse) = advantage(&residuals(&refits[place])?, &residuals(best)?, &clusters, count);
    tracing::debug!(names = ?best.added, worse, "one of two names alone");
    if does_as_well(before, refits[place].fit.cost, best.fit.cost, worse) {
        refits[..=place].rotate_right(1);
    }
    Ok(refits)
}

/// One name, which leaves `alone`, does what two do that leave `both` of what was there `before`, and is so many standard errors `worse`: few clusters tell
/// nothing apart, however much the second name does, and of a great misfit a small second effect is little.
fn does_as_well(before: f64, alone: f64, both: f64, worse: f64) -> bool {
    before - alone >= RIVAL * (before - both) && worse < PREFERRED
}

/// Refits with the best single name first, where two stand first and that is one of them: what is asked where those two are refused, for of two names the second
/// may be chance, or not known to be other than zero, when the first is certain. Where another single name is better neither is clear.
pub(super) fn better_half(refits: &[Refit]) -> Option<Vec<Refit>> {
    let two = refits.first().filter(|r| r.only().is_none())?;
    let place = refits.iter().position(|r| r.only().is_some())?;
    refits[place].only().filter(|id| two.added.contains(id))?;
    let mut out = refits.to_vec();
    out[..=place].rotate_right(1);
    Some(out)
}

/// The effect is what its name says, its sizes together are known to be other than zero, and none is pressed against a physical bound.
pub(super) fn is_sound(fit: &Fit, covariance: &nalgebra::DMatrix<f64>, n: usize) -> bool {
    if !fit.layout.effects[n].is_itself(fit.values_of(n)) {
        return false;
    }
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
pub(super) fn rivals(problem: &Problem, refits: &[Refit], before: f64) -> Result<Vec<Refit>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let best = problem.residuals(&refits[0].fit.layout, &refits[0].fit.point)?;
    let noise = colours(problem, &best);
    let mut out = Vec::new();
    for r in &refits[1..] {
        // a set that contains the best one is a refinement, not a rival
        if r.added.iter().any(|id| refits[0].added.contains(id)) {
            continue;
        }
        let share = (before - r.fit.cost) / (before - refits[0].fit.cost);
        if share < HALF {
            continue;
        }
        let other = problem.residuals(&r.fit.layout, &r.fit.point)?;
        let (_, z) = advantage(&other, &best, &clusters, count);
        let alike = share >= RIVAL && z < PREFERRED;
        let by_chance = || z < CHANCE && misfit::largest(&misfit::parts(problem, &other, &noise)) < NOISE;
        if alike || by_chance() {
            out.push(r.clone());
        }
    }
    Ok(out)
}

/// Probabilities of the refitted candidates from how far they stand behind the best, in standard errors. What holds the best and more is none of them.
pub(super) fn rank(problem: &Problem, refits: &[Refit]) -> Result<Vec<Ranked>, SimulationError> {
    let (clusters, count) = crate::score::clusters(problem);
    let Some(first) = refits.first() else { return Ok(Vec::new()) };
    let best = problem.residuals(&first.fit.layout, &first.fit.point)?;
    let holds_it = |r: &Refit| first.added.iter().all(|id| r.added.contains(id));
    let refits: Vec<&Refit> = refits.iter().filter(|r| r.added == first.added || !holds_it(r)).collect();
    let mut weights = Vec::new();
    for r in &refits {
        let other = problem.residuals(&r.fit.layout, &r.fit.point)?;
        let (total, z) = advantage(&other, &best, &clusters, count);
        let weight = (-0.5 * z.max(0.0).powi(2)).exp().max((-0.5 * total.max(0.0)).exp());
        weights.push(weight);
    }
    let sum: f64 = weights.iter().sum();
    Ok(refits.iter().zip(weights).map(|(r, w)| Ranked { id: r.added.join("+"), probability: w / sum }).collect())
}

/// The run in which two models differ most, as advice.
pub(super) fn where_they_differ(problem: &Problem, a: &Fit, b: &Fit) -> Result<String, SimulationError> {
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
    let protocol = problem.stretches.iter().find(|s| s.run == run).and_then(|s| s.protocol).map_or("", |p| p.as_str());
    Ok(format!(
        "another {protocol} run, several times as long or with larger amplitude: there the leading candidates differ most ({:.2} noise floors RMS)",
        (sum / n as f64).sqrt()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Effort;
    use crate::layout::Layout;
    use crate::problem::Point;
    use model::effects::find;

    /// Refits of a lag with a wall that creeps and of the lag alone, on runs of a rig with these effects, and their ranking.
    fn refits_of_lag_and_creep(acting: Vec<(&'static dyn Effect, Vec<f64>)>) -> (Vec<Vec<&'static str>>, Vec<Ranked>) {
        let truth = model::Parameters::example();
        let runs = [7, 8, 9, 10].map(|seed| crate::common::run(&truth, acting.clone(), 20.0, seed));
        let (problem, plain) = (crate::common::problem(&runs), crate::common::layout(&truth));
        let of = |ids: &[&'static str], values: &[f64]| {
            let layout = ids.iter().fold(plain.clone(), |layout, id| layout.with(find(id).unwrap()));
            let point = problem.point([plain.vector_of(&truth), values.to_vec()].concat());
            let fit = crate::fit::fit(&problem, &layout, point, Effort::default()).unwrap();
            Refit { added: ids.to_vec(), fit, led: None }
        };
        let refits = vec![of(&["pump_lag", "wall_creep"], &[0.02, 0.01, 1.0]), of(&["pump_lag"], &[0.02])];
        let before = problem.cost(&plain, &problem.point(plain.vector_of(&truth)));
        let refits = fewest_first(&problem, refits, before).unwrap();
        let ranked = rank(&problem, &refits).unwrap();
        (refits.into_iter().map(|r| r.added).collect(), ranked)
    }

    #[test]
    fn two_names_stand_behind_the_one_that_does_as_well_and_before_one_that_does_not() {
        let lag = |tau_s: f64| (find("pump_lag").unwrap(), vec![tau_s]);
        let (order, ranked) = refits_of_lag_and_creep(vec![lag(0.02)]);
        assert_eq!(order, [vec!["pump_lag"], vec!["pump_lag", "wall_creep"]]);
        let told: Vec<(&str, f64)> = ranked.iter().map(|r| (&r.id[..], r.probability)).collect();
        assert_eq!(told, [("pump_lag", 1.0)], "the two are no other candidate");
        let creep = (find("wall_creep").unwrap(), vec![0.6, 1.3]);
        let (order, ranked) = refits_of_lag_and_creep(vec![lag(0.02), creep]);
        assert_eq!(order, [vec!["pump_lag", "wall_creep"], vec!["pump_lag"]]);
        assert!(ranked.len() == 2 && ranked[0].probability > 0.9);
    }

    #[test]
    fn one_name_does_as_well_as_two_by_share_and_by_clusters() {
        assert!(does_as_well(100.0, 20.1, 20.0, 1.0));
        assert!(!does_as_well(100.0, 60.0, 20.0, 2.8), "half of it is missing, in few clusters");
        assert!(!does_as_well(100.0, 21.0, 20.0, 4.0), "little, and certain");
    }

    /// A refit of this cost with these names.
    fn of(added: &[&'static str], cost: f64) -> Refit {
        let point = Point { theta: Vec::new(), initial: Vec::new() };
        let layout = Layout::base(&model::Parameters::example());
        Refit { added: added.to_vec(), fit: Fit { layout, point, cost, converged: true }, led: None }
    }

    #[test]
    fn where_two_are_refused_the_better_of_them_is_asked_unless_a_third_is_better() {
        let ids = |refits: Option<Vec<Refit>>| refits.map(|r| r.iter().map(|r| r.added.join("+")).collect::<Vec<_>>());
        let (lag, tilt) = (of(&["pump_lag"], 20.0), of(&["tilt"], 50.0));
        let two = of(&["tilt", "pump_lag"], 19.0);
        let asked = ids(better_half(&[two.clone(), lag.clone(), tilt.clone()]));
        assert_eq!(asked.unwrap(), ["pump_lag", "tilt+pump_lag", "tilt"]);
        let third = of(&["backlash"], 19.5);
        assert!(better_half(&[two.clone(), third, lag.clone()]).is_none(), "neither is clear");
        assert!(better_half(&[lag, two.clone()]).is_none(), "a single one was refused");
        assert!(better_half(&[two]).is_none() && better_half(&[]).is_none());
    }

    #[test]
    fn of_the_same_names_the_cheapest_refit_stands() {
        let first = vec![of(&["torque_cubic"], 10.0), of(&["tilt"], 15.0), of(&["tilt", "end_stop"], 16.0)];
        let all = joined(first, vec![of(&["tilt"], 9.0)]);
        let told: Vec<(&[&str], f64)> = all.iter().map(|r| (&r.added[..], r.fit.cost)).collect();
        assert_eq!(told, [(&["tilt"][..], 9.0), (&["torque_cubic"][..], 10.0), (&["tilt", "end_stop"][..], 16.0)]);
    }
}
