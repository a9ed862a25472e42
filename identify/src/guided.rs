//! Starts for gross effects, found where the simulation follows what was measured ([`crate::guide`]).
//!
//! There the misfit says when and where an effect acts, all starts of an effect can be tried, and what they lead to depends little on how far the missing
//! effect has bent the base parameters. The guide then lets go step by step, and the last step is the free run.

use model::effects::Effect;

use crate::fit::{Effort, Fit, fit};
use crate::guide::Guide;
use crate::layout::Layout;
use crate::problem::{Point, Problem};

/// A model fitted where its simulation follows what was measured.
pub struct Guided {
    /// What is fitted, the tightest guide first.
    problems: Vec<Problem>,
    /// The model under the tightest.
    fit: Fit,
    /// Where no effect that it lacks has bent it.
    unbent: Point,
}

/// Guides that let go step by step. The first is short against all that a lever does, and still long against the noise: an error of 0.1 Nm at
/// 0.1 kg m2 leaves the lever 0.05 degrees off.
const GUIDES: [Guide; 2] = [Guide { lever_s: 0.03, pressure_s: 0.1 }, Guide { lever_s: 0.1, pressure_s: 0.5 }];
/// Under a guide a start leads far, if it leads anywhere.
const LEAD: Effort = Effort { iterations: 30, tolerance: 1e-3, promise: f64::INFINITY, creep: 0.0, ahead: false };
/// A few steps tell which start that is.
const FEW: Effort = Effort { iterations: 8, ..LEAD };
/// Sizes of an effect's starts that are tried, for a gross effect the usual ones and more.
const SIZES: [f64; 3] = [1.0, 0.3, 3.0];
/// An effect that takes away less than this share of the cost under the tightest guide is not what is missing, and is not led: the other starts are as good.
pub const LEADS: f64 = 0.1;
/// An effect that leads is led from at most so many starts more: friction in one form is a false minimum of friction in another.
const MORE: usize = 5;

impl Guided {
    /// A model under guides on this problem, from its fit or from values that no lacking effect has bent, whichever leads further; `None` where the
    /// plant's simulation can't be guided.
    pub fn new(problem: &Problem, layout: &Layout, fitted: &[f64], unbent: &[f64]) -> Option<Self> {
        let problems = GUIDES.iter().map(|guide| problem.guided(*guide)).collect::<Option<Vec<_>>>()?;
        let tight = problems.first()?;
        let unbent = tight.point(unbent.to_vec());
        let from = [tight.point(fitted.to_vec()), unbent.clone()];
        let fit = best(from.into_iter().filter_map(|point| fit(tight, layout, point, LEAD).ok()))?;
        Some(Guided { problems, fit, unbent })
    }

    /// The tightest guide's problem, and the model's fit to it.
    pub fn tightest(&self) -> Option<(&Problem, &Fit)> {
        self.problems.first().map(|problem| (problem, &self.fit))
    }

    /// Parameters of the model where the guide lets go.
    pub fn let_go(&self) -> Option<Vec<f64>> {
        self.let_go_from(self.fit.clone())
    }

    /// Parameters with an effect added, led from the best of its starts, where the guide lets go; `None` where it leads nowhere.
    pub fn led(&self, effect: &'static dyn Effect) -> Option<Vec<f64>> {
        let tight = self.problems.first()?;
        let (lowest, mut others) =
            self.first_steps(effect).filter(|(led, _)| led.cost < (1.0 - LEADS) * self.fit.cost)?;
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        let layout = lowest.layout.clone();
        let more = others.into_iter().take(MORE).filter_map(|(_, point)| fit(tight, &layout, point, FEW).ok());
        let lowest = best([lowest].into_iter().chain(more))?;
        let led = fit(tight, &layout, lowest.point, LEAD).ok()?;
        tracing::debug!(id = effect.header().id, from = self.fit.cost, to = led.cost, "led");
        self.let_go_from(led)
    }

    /// Share of the cost under the tightest guide that a few steps from an effect's best starts take away.
    pub fn takes_away(&self, effect: &'static dyn Effect) -> f64 {
        self.first_steps(effect).map_or(0.0, |(led, _)| 1.0 - led.cost / self.fit.cost)
    }

    /// A few steps from the best start at each place, and the other starts with what they cost.
    fn first_steps(&self, effect: &'static dyn Effect) -> Option<(Fit, Vec<(f64, Point)>)> {
        let tight = self.problems.first()?;
        let layout = self.fit.layout.with(effect);
        let mut starts = [&self.fit.point, &self.unbent].map(|place| self.starts(&layout, place, effect));
        let firsts: Vec<Point> = starts.iter_mut().filter_map(|s| s.pop()).map(|(_, point)| point).collect();
        let lowest = best(firsts.into_iter().filter_map(|point| fit(tight, &layout, point, FEW).ok()))?;
        Some((lowest, starts.concat()))
    }

    /// Starts of an effect at a place by what they cost under the tightest guide, the best last.
    fn starts(&self, layout: &Layout, place: &Point, effect: &'static dyn Effect) -> Vec<(f64, Point)> {
        let Some(tight) = self.problems.first() else { return Vec::new() };
        let header = effect.header();
        let each = header.starts.iter().flat_map(|s| SIZES.map(|size| header.scaled(s, size)));
        let costly = each.map(|values| {
            let mut point = place.clone();
            point.theta.extend(values);
            (tight.cost(layout, &point), point)
        });
        let mut out: Vec<(f64, Point)> = costly.filter(|(cost, _)| cost.is_finite()).collect();
        out.sort_by(|a, b| b.0.total_cmp(&a.0));
        out
    }

    fn let_go_from(&self, tight: Fit) -> Option<Vec<f64>> {
        let looser = &self.problems[1..];
        let last = looser.iter().try_fold(tight, |led, problem| fit(problem, &led.layout, led.point, LEAD).ok())?;
        Some(last.point.theta)
    }
}

/// The fit of the lowest cost.
fn best(fits: impl IntoIterator<Item = Fit>) -> Option<Fit> {
    fits.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
}
