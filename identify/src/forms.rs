//! More general forms of effects. A name is the claim; how its effect goes with pressure, speed, depth or time differs from rig to rig, and where the
//! library's form leaves more than noise a general one may tell.

use model::effects::Effect;

use crate::fit::{Effort, Fit, fit};
use crate::layout::Layout;
use crate::problem::{Point, Problem};

/// Which form an effect has: its id, and how many parameters. A general form has the id of the library's and more of them.
pub(crate) type Form = (&'static str, usize);

/// The form of an effect.
pub(crate) fn form_of(effect: &'static dyn Effect) -> Form {
    (effect.header().id, effect.header().parameters.len())
}

/// Share of the cost that a general form leaves at most where it is to be taken without a further judge.
pub const CLEARLY: f64 = 0.98;

/// So many starts that cost least are followed where something is left that a form may take,
pub const FOLLOWED: usize = 4;
/// if they cost at most so many times what the cheapest does,
const FURTHER: f64 = 100.0;
/// a few steps, which tell which of them leads down.
const FEW: Effort = Effort { iterations: 3, tolerance: 1e-3, promise: f64::INFINITY, creep: 0.0, ahead: false };

/// One that then leaves so many times what the library's form does is not brought to its minimum.
const BEHIND: f64 = 5.0;

/// The fit, or one that leaves at most the share `better` of its cost, in which those of these effects that have a general form carry it, brought to its
/// minimum with this effort, and still are what their names say. Of the starts of each the `followed` that cost least are, and where none comes down one beside the library's form. Effects that
/// a model had before keep theirs.
pub fn refined(problem: &Problem, found: Fit, added: &[&str], followed: usize, effort: Effort, better: f64) -> Fit {
    let mut best = found;
    for n in 0..best.layout.effects.len() {
        let form = best.layout.effects[n].refined().filter(|form| added.contains(&form.effect.header().id));
        let Some(form) = form else { continue };
        let own = best.layout.first_of(n)..best.layout.first_of(n + 1);
        let plain = &best.point.theta[own];
        // from the form that was found, and from those that such effects have
        let starts = form.all_starts(plain);
        let Some((layout, _)) = starts.first().map(|values| with_form(&best, n, values)) else { continue };
        let at = |values: &Vec<f64>| with_form(&best, n, values).1;
        let starts = problem.cheapest(&layout, starts.iter().map(at), followed);
        let most = starts.first().map_or(0.0, |(cost, _)| FURTHER * cost);
        let few = starts.into_iter().filter(|(cost, _)| *cost <= most);
        let led = |(_, point): (f64, Point)| fit(problem, &layout, point, FEW).ok();
        let lowest = few.filter_map(led).min_by(|a, b| a.cost.total_cmp(&b.cost));
        let ended = |led: Fit| fit(problem, &led.layout, led.point, effort).ok();
        let taken = |general: &Fit| general.cost < better * best.cost && general.are_themselves();
        let general = lowest.filter(|led| led.cost < BEHIND * best.cost).and_then(ended).filter(taken);
        // where no start comes down
        let general = general.or_else(|| {
            let beside = problem.cheapest(&layout, form.beside(plain).iter().map(at), 1).pop();
            let led = beside.and_then(led).filter(|led| led.cost < best.cost);
            led.and_then(ended).filter(taken)
        });
        if let Some(general) = general {
            let values = general.values_of(n);
            tracing::debug!(id = form.effect.header().id, ?values, from = best.cost, to = general.cost, "general form");
            best = general;
        }
    }
    best
}

/// The `n`-th effect in its general form, with these values.
fn with_form(fit: &Fit, n: usize, values: &[f64]) -> (Layout, Point) {
    let (mut layout, mut point) = (fit.layout.clone(), fit.point.clone());
    let old = layout.first_of(n)..layout.first_of(n + 1);
    if let Some(form) = layout.effects[n].refined() {
        layout.effects[n] = form.effect;
        let longer = values.len() - old.len();
        layout.held = layout.held.iter().map(|&i| if i < old.end { i } else { i + longer }).collect();
        point.theta.splice(old, values.iter().copied());
    }
    (layout, point)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use model::Parameters;
    use model::effects::find;

    /// Buffers that stiffen over several depths, none of which is one that its form starts with.
    #[test]
    fn a_stop_that_stiffens_exponentially_is_reached_from_a_linear_one() {
        let mut truth = Parameters::example();
        // so that the lever comes to its ends
        truth.pump.f1 *= 4.0;
        let stop = find("end_stop").unwrap();
        let rubber = stop.refined().unwrap().effect;
        for b in [0.03, 0.07, 0.15] {
            let sealed = vec![6.0, 6.0, 18.0, 20.0, 0.0, 0.0, b];
            let runs = [7, 8].map(|seed| dynamic(&truth, Some((rubber, sealed.clone())), 20.0, seed));
            let (problem, base) = (problem(&runs), layout(&truth));
            let start = [&base.vector_of(&truth)[..], &[10.0, 10.0, 22.0]].concat();
            let plain = fit(&problem, &base.with(stop), problem.point(start), Effort::default()).unwrap();
            let general = refined(&problem, plain.clone(), &["end_stop"], FOLLOWED, Effort::default(), CLEARLY);
            let targets = problem.targets() as f64;
            assert!(plain.cost > 1.2 * targets, "{b}: {}", plain.cost / targets);
            // four shapes trade places along a valley that bends
            let left = general.cost / targets;
            assert!(left < 1.03, "{b}: {left}");
        }
    }

    /// Friction that falls a little less steeply than the library's: that is much beside the noise, and from each start of the form far more.
    #[test]
    fn a_law_that_is_hardly_another_one_is_reached_from_beside_the_library_s() {
        let truth = Parameters::example();
        let friction = find("stribeck_friction").unwrap();
        let any_fall = friction.refined().unwrap().effect;
        let sealed = vec![2.0, 0.25, 0.017, 1.8, 0.0];
        let runs = [7, 8].map(|seed| dynamic(&truth, Some((any_fall, sealed.clone())), 20.0, seed));
        let (problem, base) = (problem(&runs), layout(&truth));
        let start = [&base.vector_of(&truth)[..], &sealed[..3]].concat();
        let plain = fit(&problem, &base.with(friction), problem.point(start), Effort::default()).unwrap();
        let general = refined(&problem, plain.clone(), &["stribeck_friction"], FOLLOWED, Effort::default(), CLEARLY);
        let targets = problem.targets() as f64;
        assert!(plain.cost > 1.1 * targets, "{}", plain.cost / targets);
        assert!(general.cost < 1.02 * targets, "{}", general.cost / targets);
        let own = &general.point.theta[base.len()..];
        assert!(own.len() == 5 && (own[3] - 1.8).abs() < 0.05, "{own:?}");
    }

    #[test]
    fn what_stands_behind_a_form_s_own_parameters_moves_up() {
        let mut layout = Layout::base(&Parameters::example());
        let base = layout.len();
        layout.effects = vec![find("end_stop").unwrap(), find("trapped_air").unwrap()];
        layout.held = [base + 2, base + 3].into();
        let mut theta = vec![0.5; base];
        theta.extend([10.0, 10.0, 30.0, 1.0, 2.0]);
        let point = Point { theta, initial: Vec::new() };
        let fit = Fit { layout, point, cost: 1.0, converged: true };
        let (layout, point) = with_form(&fit, 0, &[10.0, 10.0, 30.0, 1.5, 0.0, 0.0, 0.02]);
        assert_eq!(point.theta[base..], [10.0, 10.0, 30.0, 1.5, 0.0, 0.0, 0.02, 1.0, 2.0]);
        assert_eq!(layout.held, [base + 2, base + 7].into(), "of the air's sizes the first");
        assert_eq!(layout.names()[base + 3], "end_stop.n");
        assert_eq!(layout.len(), point.theta.len());
    }
}
