//! Joint refits of base parameters and candidate effects, and how two of them compare.

use model::effects::Effect;

use crate::fit::{Effort, Fit, fit};
use crate::forms::form_of;
use crate::guided::Guided;
use crate::problem::{Point, Problem};
use crate::score::{Direction, Scene};

/// A candidate set of effects, refitted.
#[derive(Clone)]
pub struct Refit {
    /// Ids of what was added to the model before.
    pub added: Vec<&'static str>,
    /// The fit.
    pub fit: Fit,
    /// What it left under the tightest guide where it was led from all starts of its effect there: other shapes need not be tried.
    pub led: Option<f64>,
}

impl Refit {
    /// What was added, where it is one effect.
    pub fn only(&self) -> Option<&'static str> {
        if let [id] = self.added[..] { Some(id) } else { None }
    }
}

/// Where a refit may start, and on what.
pub struct Bases<'a> {
    /// The current fit, linearised: the right place for a small effect, and for one that what was fitted has taken up.
    pub scene: &'a Scene<'a>,
    /// Base values from the component experiments, in the layout's order: the right place for a gross effect, which bends
    /// the current fit far off.
    pub component: &'a [f64],
    /// The first seconds of each run: a short horizon has fewer false minima, so a start from the component experiments is
    /// led over it.
    pub short: &'a Problem,
    /// The current model where its simulation follows what was measured: there single effects are led from all of their starts.
    pub guided: Option<&'a Guided>,
    /// What the best one led so far leaves under the tightest guide; infinite where there is none.
    pub beside: f64,
    /// The effect may be gross: all these starts are tried.
    pub gross: bool,
}

/// Brings a start near its minimum.
const LEAD: Effort = Effort { iterations: 10, tolerance: 1e-3, promise: f64::INFINITY, creep: 0.0, ahead: false };

/// Refits `current` with these effects added, from the best of their starts, with this effort from each base.
pub fn refit(
    problem: &Problem,
    bases: &Bases,
    added: &[(&'static dyn Effect, Vec<&Direction>)],
    effort: Effort,
) -> Option<Refit> {
    let added = &in_leading_form(added)[..];
    let current = bases.scene.fit;
    let mut layout = current.layout.clone();
    for (effect, _) in added {
        layout.effects.push(*effect);
    }
    let starts = starts(added);
    let cheapest = |problem: &Problem, points: Vec<Point>| problem.cheapest(&layout, points, 1).pop();
    let at_current = |size: f64| {
        let each = starts.iter().flat_map(|start| {
            let values = sized(added, start, size);
            let mut plain = current.point.clone();
            plain.theta.extend(&values);
            [Some(plain), bases.scene.taken_back(&layout, &values)]
        });
        each.flatten().collect()
    };
    let at_component = || {
        let each = starts.iter().map(|start| {
            let mut point = current.point.clone();
            point.theta[..bases.component.len()].copy_from_slice(bases.component);
            point.initial.iter_mut().for_each(|values| values.fill(0.0));
            point.theta.extend(start);
            point
        });
        each.collect()
    };
    // a few steps tell which start leads down
    let mut tried: Vec<Fit> = Vec::new();
    // a start at which the effect is far too large leads to a minimum of its own, above the model without it
    let descends = |(cost, _): &(f64, Point)| *cost < current.cost;
    let mut best: Option<(f64, Point)> = None;
    for size in SIZES {
        let begun = cheapest(problem, at_current(size));
        best = [best, begun].into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
        if best.as_ref().is_some_and(descends) {
            break;
        }
    }
    if let Some((_, point)) = best {
        tried.extend(fit(problem, &layout, point, effort).ok());
    }
    let led = match added {
        [(effect, _)] => bases.guided.and_then(|guided| guided.led(*effect, bases.beside)),
        _ => None,
    };
    let left = led.as_ref().map(|led| led.cost);
    if let Some(led) = led {
        let from = fit(problem, &layout, problem.point(led.theta), effort).ok();
        // a lever that has been let go sticks elsewhere at first
        let above = |fit: &Fit| fit.cost > current.cost;
        let further =
            from.as_ref().filter(|f| above(f)).and_then(|f| fit(problem, &layout, f.point.clone(), LEAD).ok());
        tried.extend(further.or(from));
    } else if bases.gross
        && !out_of_question(bases, added)
        && let Some((_, point)) = cheapest(bases.short, at_component())
    {
        let led = fit(bases.short, &layout, point, LEAD).ok();
        // where the model does as well without the effect the start leads nowhere
        let without = bases.short.cost(&current.layout, &current.point);
        if let Some(led) = led.filter(|led| led.cost < without) {
            tried.extend(fit(problem, &layout, led.point, effort).ok());
        }
    }
    tracing::debug!(last = ?added.last().map(|(e, _)| e.header().id), costs = ?tried.iter().map(|f| f.cost).collect::<Vec<_>>(), "starts");
    let fit = tried.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    Some(Refit { added: added.iter().map(|(e, _)| e.header().id).collect(), fit, led: left })
}

/// These effects in the form of their first direction, with the directions of that form alone: those of another have other parameters.
fn in_leading_form<'d>(
    added: &[(&'static dyn Effect, Vec<&'d Direction>)],
) -> Vec<(&'static dyn Effect, Vec<&'d Direction>)> {
    let each = added.iter().map(|(effect, directions)| {
        let form = directions.first().map_or(*effect, |d| d.effect);
        let own = directions.iter().copied().filter(|d| form_of(d.effect) == form_of(form));
        (form, own.collect())
    });
    each.collect()
}

/// What is missing shows under a guide, a single effect leads nowhere there, and does not do most of it in free run either (what is slow, a guide follows):
/// the base values of the component experiments lead it nowhere.
fn out_of_question(bases: &Bases, added: &[(&'static dyn Effect, Vec<&Direction>)]) -> bool {
    let [(_, directions)] = added else { return false };
    let most = directions.iter().map(|d| d.gain()).fold(0.0, f64::max);
    bases.guided.is_some_and(Guided::shows) && most < MOST * bases.scene.fit.cost
}

/// Share of the cost that is most of it.
const MOST: f64 = 0.5;

/// Sizes of a start that are tried one after the other until one leads down.
const SIZES: [f64; 4] = [1.0, 0.3, 0.1, 0.03];

/// A start of these effects with their sizes times `size`.
fn sized(added: &[(&'static dyn Effect, Vec<&Direction>)], start: &[f64], size: f64) -> Vec<f64> {
    let mut rest = start;
    let each = added.iter().flat_map(|(effect, _)| {
        let (own, others) = rest.split_at(effect.header().parameters.len());
        rest = others;
        effect.header().scaled(own, size)
    });
    each.collect()
}

/// Starts of the effects' parameters: each one's best directions as they stand and scaled to what the residual asks for.
fn starts(added: &[(&'static dyn Effect, Vec<&Direction>)]) -> Vec<Vec<f64>> {
    let each: Vec<Vec<Vec<f64>>> = added
        .iter()
        .map(|(effect, directions)| {
            let mut out = Vec::new();
            for d in directions.iter().take(2) {
                let scale = d.scale().clamp(SMALL, LARGE);
                out.push(effect.header().scaled(&d.start, scale));
                if !(0.3..3.0).contains(&scale) {
                    out.push(d.start.clone());
                }
                if let Some(far) = far(d) {
                    out.push(effect.header().scaled(&d.start, far));
                }
            }
            if out.is_empty() {
                out.push(effect.header().starts[0].to_vec());
            }
            out
        })
        .collect();
    match &each[..] {
        [one] => one.clone(),
        [a, b] => vec![[a[0].clone(), b[0].clone()].concat()],
        more => vec![more.iter().flat_map(|m| m[0].clone()).collect()],
    }
}

/// Scales of a start between which it is taken at its word: an effect bends what follows from it, and what is linear in its size far off is another matter.
const SMALL: f64 = 0.05;
const LARGE: f64 = 20.0;

/// The scale that the residual asks for where it is larger or has the other sign, for an effect that acts in either direction.
fn far(direction: &Direction) -> Option<f64> {
    let one_sided = direction.effect.header().parameters.iter().any(|p| p.size && p.lower >= 0.0);
    let scale = direction.scale();
    (!one_sided && scale.is_finite() && !(-SMALL..=LARGE).contains(&scale)).then_some(scale)
}

/// By how much the second residual is smaller: difference of the sums of squares, and its significance in standard errors.
///
/// Sums of squares are compared cluster by cluster, so that colour widens the error instead of feigning certainty. A misfit
/// that sits in few clusters leaves the mean of the differences uncertain however often the rest agrees: relative
/// differences, which are bounded, speak for the many, and the stronger of the two counts.
pub fn advantage(before: &[Vec<f64>], after: &[Vec<f64>], clusters: &[Vec<usize>], count: usize) -> (f64, f64) {
    let (mut first, mut second) = (vec![0.0; count], vec![0.0; count]);
    for ((b, a), c) in before.iter().zip(after).zip(clusters) {
        for ((b, a), c) in b.iter().zip(a).zip(c) {
            first[*c] += b * b;
            second[*c] += a * a;
        }
    }
    let significance = |v: &[f64]| {
        let error = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if error > 0.0 { v.iter().sum::<f64>() / error } else { 0.0 }
    };
    let absolute: Vec<f64> = first.iter().zip(&second).map(|(b, a)| b - a).collect();
    let relative: Vec<f64> =
        first.iter().zip(&second).map(|(b, a)| if b.max(*a) > 0.0 { (b - a) / b.max(*a) } else { 0.0 }).collect();
    let total: f64 = absolute.iter().sum();
    let (mean, many) = (significance(&absolute), significance(&relative));
    (total, if total > 0.0 { mean.max(many) } else { mean.min(many) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals (before, after) of one cluster each.
    fn with(pairs: &[(f64, f64)]) -> f64 {
        let before: Vec<Vec<f64>> = pairs.iter().map(|p| vec![p.0]).collect();
        let after: Vec<Vec<f64>> = pairs.iter().map(|p| vec![p.1]).collect();
        let clusters: Vec<Vec<usize>> = (0..pairs.len()).map(|n| vec![n]).collect();
        advantage(&before, &after, &clusters, pairs.len()).1
    }

    /// Parameters of the form that a pump whose slip follows its warmth is refitted with, and what that leaves (cost a target): warm by running, or by its losses.
    fn warmed(by_losses: f64) -> (usize, f64) {
        let truth = model::Parameters::example();
        let plain = model::effects::find("pump_warming").unwrap();
        let general = plain.refined().unwrap().effect;
        let runs = [7, 8].map(|seed| {
            crate::common::dynamic(&truth, Some((general, vec![0.5, 12.0, 0.0, by_losses, 0.0])), 30.0, seed)
        });
        let (problem, layout) = (crate::common::problem(&runs), crate::common::layout(&truth));
        let component = layout.vector_of(&truth);
        let base = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
        let scene = Scene::new(&problem, &base).unwrap();
        let directions = crate::equivalence::best(&scene, plain);
        let bases = Bases {
            scene: &scene,
            component: &component,
            short: &problem,
            guided: None,
            beside: f64::INFINITY,
            gross: false,
        };
        let refit = refit(&problem, &bases, &[(plain, directions.iter().collect())], Effort::default()).unwrap();
        assert_eq!(refit.only(), Some("pump_warming"));
        let last = refit.fit.layout.effects.last().unwrap();
        assert!(base.cost > 1.5 * problem.targets() as f64, "{}", base.cost / problem.targets() as f64);
        (last.header().parameters.len(), refit.fit.cost / problem.targets() as f64)
    }

    #[test]
    fn an_effect_is_refitted_in_the_form_whose_direction_leads() {
        let (plain, left) = warmed(0.0);
        assert!(plain == 2 && left < 1.05, "by running: {plain} parameters, {left}");
        let (general, left) = warmed(1.0);
        assert!(general == 5 && left < 1.05, "by its losses: {general} parameters, {left}");
    }

    #[test]
    fn what_acts_in_either_direction_starts_also_as_far_off_as_the_residual_asks() {
        let starting = |id: &str, start: &[f64], scale: f64| {
            let effect = model::effects::find(id).expect("an effect of the library");
            let (raw, secant) = (Vec::new(), Vec::new());
            let direction =
                Direction { effect, start: start.to_vec(), raw, secant, square: 2.0, with_residual: 2.0 * scale };
            starts(&[(effect, vec![&direction])])
        };
        let held = |starts: &[Vec<f64>], value: f64| starts.iter().any(|s| (s[0] - value).abs() < 1e-12);
        assert_eq!(starting("tilt", &[0.05, 0.0], 2.0), [[0.1, 0.0]], "taken at its word");
        let far = starting("tilt", &[0.05, 0.0], 90.0);
        assert!(held(&far, 4.5) && held(&far, 1.0) && held(&far, 0.05), "{far:?}");
        assert!(held(&starting("tilt", &[0.05, 0.0], -90.0), -4.5), "the other way");
        assert!(held(&starting("tilt", &[0.05, 0.0], 900.0), 5.0), "no further than its bound");
        let leak = starting("cross_leakage", &[0.5, 1.0], -90.0);
        assert!(leak.iter().all(|s| s[0] > 0.0), "{leak:?}");
    }

    #[test]
    fn agreement_of_many_counts_also_where_one_cluster_dominates() {
        let (better, worse) = ((5.0, 4.0), (4.0, 5.0));
        let mut clusters = vec![better; 30];
        assert!(with(&clusters) > 4.0);
        clusters[7] = (80.0, 4.0);
        assert!(with(&clusters) > 4.0);
        let mut mixed: Vec<(f64, f64)> = (0..30).map(|i| if i % 2 == 0 { better } else { worse }).collect();
        assert!(with(&mixed).abs() < 2.0, "{}", with(&mixed));
        // one cluster alone convinces nobody
        mixed[3] = (80.0, 4.0);
        assert!(with(&mixed) < 2.0, "{}", with(&mixed));
        // nor do clusters of noise take the voice from twenty that agree
        let few: Vec<(f64, f64)> = (0..170)
            .map(|i| {
                if i < 20 {
                    (9.0, 3.0)
                } else if i % 2 == 0 {
                    (3.01, 3.0)
                } else {
                    (3.0, 3.01)
                }
            })
            .collect();
        assert!(with(&few) > 4.0, "{}", with(&few));
    }
}
