//! Starts for gross effects, found where the simulation follows what was measured ([`crate::guide`]).
//!
//! There the misfit says when and where an effect acts, all starts of an effect can be tried, and what they lead to depends little on how far the missing
//! effect has bent the base parameters. The guide then lets go step by step, and the last step is the free run.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use model::effects::{Effect, empirical};

use crate::fit::{Effort, Fit, fit};
use crate::forms::{Form, form_of};
use crate::guide::Guide;
use crate::layout::Layout;
use crate::problem::{Point, Problem};
use crate::score::{Gram, Scene};

/// A model fitted where its simulation follows what was measured.
pub struct Guided {
    /// What is fitted, the tightest guide first.
    problems: Vec<Problem>,
    /// The model under the tightest.
    fit: Fit,
    /// Where no effect that it lacks has bent it.
    unbent: Point,
    /// First steps of the effects that were asked for: who takes away much is led on from there.
    stepped: Mutex<BTreeMap<Form, Option<FirstSteps>>>,
}

/// A few steps from the best starts at each place, and the other starts with what they cost.
type FirstSteps = (Fit, Vec<(f64, Point)>);

/// Where an effect was led.
pub struct Led {
    /// Parameters where the guide has let go.
    pub theta: Vec<f64>,
    /// What was left under the tightest guide.
    pub cost: f64,
}

/// A start is led on this much of each run where the simulation follows what was measured, s.
pub const GUIDED_S: f64 = 10.0;

/// Guides that let go step by step. The first is short against all that a lever does, and still long against the noise: an error of 0.1 Nm at
/// 0.1 kg m2 leaves the lever 0.05 degrees off.
const GUIDES: [Guide; 2] = [Guide { lever_s: 0.03, pressure_s: 0.1 }, Guide { lever_s: 0.1, pressure_s: 0.5 }];
/// Under a guide a start leads far, if it leads anywhere.
const LEAD: Effort = Effort { iterations: 30, tolerance: 1e-3, promise: f64::INFINITY, creep: 0.0, ahead: false };
/// A few steps tell which start that is.
const FEW: Effort = Effort { iterations: 8, ..LEAD };
/// Sizes of an effect's starts that are tried, for a gross effect the usual ones and more.
const SIZES: [f64; 3] = [1.0, 0.3, 3.0];
/// So many of the best starts are followed a few steps, at the fit and at the unbent values.
const FIRST: [usize; 2] = [2, 1];
/// An effect that takes away less than this share of what is missing under the tightest guide is not it, and is not led: the other starts are as good.
pub const LEADS: f64 = 0.1;
/// Nor is one led to the end that takes away less than this share after those steps: of two effects the better one does about half, or more.
const PART: f64 = 1.0 / 3.0;
/// An effect that leads is led from at most so many starts more: friction in one form is a false minimum of friction in another.
const MORE: usize = 5;
/// Of those, what so many steps leave tells which are worth more,
const GLANCE: Effort = Effort { iterations: 3, ..LEAD };
/// and so many are.
const WORTH: usize = 2;
/// Where what is missing does not show, an effect that takes away less than this share of it from each start in a glance, and does not lead linearly, is not
/// followed further.
const HOPE: f64 = 0.02;
/// Cost a target under the tightest guide from which what is missing shows there; noise alone leaves 1.
pub const SHOWS: f64 = 5.0;
/// Cost a target there from which something is missing at all.
const LACKS: f64 = 2.0;
/// An effect that leaves so many times what another one leaves under the tightest guide, after a few steps, does not catch up with it.
const BEHIND: f64 = 5.0;
/// One that leaves so many times as much is led from no more starts.
const LAGS: f64 = 2.0;
/// Factors by which a shape leaps to where another minimum may be,
const LEAPS: [f64; 4] = [1.0 / 16.0, 0.25, 4.0, 16.0];
/// which it is where a glance leaves less than so many times as much,
const NEAR: f64 = 4.0;
/// and so many of them are followed.
const FOLLOWED: usize = 3;
/// Share by which a shape differs at least between two places.
const ONE_PLACE: f64 = 0.1;
/// From no more where a few steps take away this share of what is missing: a false minimum leaves more.
const ALL_BUT: f64 = 0.95;

impl Guided {
    /// A model under guides on this problem, from its fit or from values that no lacking effect has bent, whichever leads further; `None` where the
    /// plant's simulation can't be guided.
    pub fn new(problem: &Problem, layout: &Layout, fitted: &[f64], unbent: &[f64]) -> Option<Self> {
        let problems = GUIDES.iter().map(|guide| problem.guided(*guide)).collect::<Option<Vec<_>>>()?;
        let tight = problems.first()?;
        let unbent = tight.point(unbent.to_vec());
        let from = [tight.point(fitted.to_vec()), unbent.clone()];
        let fit = best(from.into_iter().filter_map(|point| fit(tight, layout, point, LEAD).ok()))?;
        Some(Guided { problems, fit, unbent, stepped: Mutex::default() })
    }

    /// The tightest guide's problem, and the model's fit to it.
    pub fn tightest(&self) -> Option<(&Problem, &Fit)> {
        self.problems.first().map(|problem| (problem, &self.fit))
    }

    /// Parameters of the model where the guide lets go: from its fit, and from where a leap in one of its effects' shapes leads.
    ///
    /// Two frictions that both turn round at rest have a minimum where each takes the other's velocity. Under the guide it is hardly higher; in free run the lever
    /// then rests elsewhere, so only that can tell which one it is.
    pub fn let_go(&self) -> Vec<Vec<f64>> {
        let tight = [self.fit.clone()].into_iter().chain(self.in_other_shapes());
        places(tight.filter_map(|led| self.let_go_from(led))).into_iter().map(|led| led.point.theta).collect()
    }

    /// The model with one shape of an effect far from where it is, a few steps on under the tightest guide: those that may lead to another minimum.
    fn in_other_shapes(&self) -> Vec<Fit> {
        let Some((tight, here)) = self.tightest() else { return Vec::new() };
        let bounds = here.layout.bounds();
        let leaps = here.layout.shapes().into_iter().flat_map(|i| {
            let (lower, upper) = bounds[i];
            let mut values = LEAPS.map(|factor| (factor * here.point.theta[i]).clamp(lower, upper)).to_vec();
            values.dedup();
            values.retain(|value| *value != here.point.theta[i]);
            values.into_iter().map(move |value| (i, value))
        });
        let landed = leaps.filter_map(|(i, value)| {
            let mut point = here.point.clone();
            point.theta[i] = value;
            fit(tight, &here.layout, point, GLANCE).ok()
        });
        let mut landed: Vec<Fit> = landed.filter(|led| led.cost < NEAR * here.cost).collect();
        landed.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        tracing::debug!(here = here.cost, landed = ?landed.iter().map(|led| led.cost).collect::<Vec<_>>(), "leaps");
        // one that is on its way back leads nowhere else
        let elsewhere = places([here.clone()].into_iter().chain(landed)).into_iter().skip(1).take(FOLLOWED);
        elsewhere.filter_map(|led| fit(tight, &here.layout, led.point, FEW).ok()).collect()
    }

    /// What is missing shows under the tightest guide.
    pub fn shows(&self) -> bool {
        self.tightest().is_some_and(|(problem, fit)| fit.cost > SHOWS * problem.targets() as f64)
    }

    /// What a model that is fitted without the guide leaves under the tightest one; infinite where it can't be simulated.
    pub fn cost_of(&self, free: &Fit) -> f64 {
        let of = |tight: &Problem| fit(tight, &free.layout, tight.point(free.point.theta.clone()), GLANCE).ok();
        self.problems.first().and_then(of).map_or(f64::INFINITY, |led| led.cost)
    }

    /// As much is missing under the tightest guide as noise leaves there.
    pub fn lacks(&self) -> bool {
        self.tightest().is_some_and(|(problem, fit)| fit.cost > LACKS * problem.targets() as f64)
    }

    /// An effect added, led from the best of its starts, where the guide lets go; `None` where it leads nowhere, or far less far than one that leaves
    /// `beside` under the tightest guide.
    pub fn led(&self, effect: &'static dyn Effect, beside: f64) -> Option<Led> {
        let tight = self.problems.first()?;
        // where nothing shows there is nothing to be led by, but for an effect that shows, or one whose first steps were asked for
        let asked = self.stepped.lock().unwrap_or_else(PoisonError::into_inner).contains_key(&form_of(effect));
        if !asked && !self.shows() && self.linearly(effect)? < LEADS {
            return None;
        }
        let leads = |led: &Fit| self.share_of_missing(led.cost) > LEADS && led.cost < BEHIND * beside;
        let (lowest, mut others) = self.first_steps(effect).filter(|(led, _)| leads(led))?;
        let lags = lowest.cost > LAGS * beside;
        let more = if lags || self.is_all_but_explained(lowest.cost) { 0 } else { MORE };
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        let layout = lowest.layout.clone();
        let glance = |(_, point): (f64, Point)| fit(tight, &layout, point, GLANCE).ok();
        let mut glanced: Vec<Fit> = others.into_iter().take(more).filter_map(glance).collect();
        glanced.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let more = glanced.into_iter().take(WORTH).filter_map(|led| fit(tight, &layout, led.point, FEW).ok());
        let lowest = best([lowest].into_iter().chain(more)).filter(|led| self.share_of_missing(led.cost) > PART)?;
        let led = fit(tight, &layout, lowest.point, LEAD).ok()?;
        tracing::debug!(id = effect.header().id, from = self.fit.cost, to = led.cost, "led");
        Some(Led { cost: led.cost, theta: self.let_go_from(led)?.point.theta })
    }

    /// Share of the cost under the tightest guide that an effect takes away there, linearly.
    fn linearly(&self, effect: &'static dyn Effect) -> Option<f64> {
        let (problem, fit) = self.tightest()?;
        let directions = Scene::new(problem, fit).ok()?.directions(effect);
        let usable: Vec<usize> = (0..directions.len()).filter(|&i| directions[i].gain() > 0.0).collect();
        Some(Gram::new(&directions).gain(&usable) / fit.cost)
    }

    /// A fit of this cost under the tightest guide takes away all but nothing of what is missing there.
    pub fn is_all_but_explained(&self, cost: f64) -> bool {
        self.share_of_missing(cost) > ALL_BUT
    }

    /// Share of what is missing under the tightest guide that a fit of this cost takes away.
    fn share_of_missing(&self, cost: f64) -> f64 {
        self.tightest().map_or(0.0, |(problem, fit)| taken_away(fit.cost, cost, problem.targets()))
    }

    /// Share of what is missing under the tightest guide that a few steps from an effect's best starts take away.
    pub fn takes_away(&self, effect: &'static dyn Effect) -> f64 {
        self.first_steps(effect).map_or(0.0, |(led, _)| self.share_of_missing(led.cost))
    }

    fn first_steps(&self, effect: &'static dyn Effect) -> Option<FirstSteps> {
        let form = form_of(effect);
        // a thread that panicked with it has left what was there before
        let known = || self.stepped.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(steps) = known().get(&form) {
            return steps.clone();
        }
        let steps = self.step_from_starts(effect);
        known().insert(form, steps.clone());
        steps
    }

    fn step_from_starts(&self, effect: &'static dyn Effect) -> Option<FirstSteps> {
        let tight = self.problems.first()?;
        let scene = Scene::new(tight, &self.fit).ok()?;
        let layout = self.fit.layout.with(effect);
        let at_fit = |values: Vec<f64>| scene.taken_back(&layout, &values);
        let unbent = |values: Vec<f64>| {
            let mut point = self.unbent.clone();
            point.theta.extend(values);
            Some(point)
        };
        let mut starts = [self.starts(&layout, effect, at_fit), self.starts(&layout, effect, unbent)];
        let first = starts.iter_mut().zip(FIRST).flat_map(|(s, n)| s.drain(..n.min(s.len())).collect::<Vec<_>>());
        let points: Vec<Point> = first.map(|(_, point)| point).collect();
        let lowest = if self.shows() {
            best(points.into_iter().filter_map(|point| fit(tight, &layout, point, FEW).ok()))?
        } else {
            let glanced: Vec<Fit> = points.into_iter().filter_map(|p| fit(tight, &layout, p, GLANCE).ok()).collect();
            // a first step that gains little ends a glance; of what leads linearly it tells nothing
            let hopeless = glanced.iter().all(|led| self.share_of_missing(led.cost) < HOPE)
                && self.linearly(effect).is_none_or(|share| share < LEADS);
            let further = |led: Fit| if hopeless { Some(led) } else { fit(tight, &layout, led.point, FEW).ok() };
            best(glanced.into_iter().filter_map(further))?
        };
        Some((lowest, starts.concat()))
    }

    /// Starts of an effect that may be led from, as `place` puts them, by what they cost under the tightest guide, the best first.
    fn starts(
        &self,
        layout: &Layout,
        effect: &'static dyn Effect,
        place: impl Fn(Vec<f64>) -> Option<Point>,
    ) -> Vec<(f64, Point)> {
        let Some(tight) = self.problems.first() else { return Vec::new() };
        let header = effect.header();
        let each: Vec<Vec<f64>> = if empirical::is_nameless(effect) {
            // a sum of terms has one minimum, whatever it starts from
            header.starts.iter().take(1).map(|s| header.scaled(s, 0.0)).collect()
        } else {
            header.starts.iter().flat_map(|s| SIZES.map(|size| header.scaled(s, size))).collect()
        };
        // beside the first ones no more are led
        tight.cheapest(layout, each.into_iter().filter_map(place), FIRST[0] + MORE)
    }

    fn let_go_from(&self, tight: Fit) -> Option<Fit> {
        let looser = &self.problems[1..];
        looser.iter().try_fold(tight, |led, problem| fit(problem, &led.layout, led.point, LEAD).ok())
    }
}

/// The first fit at each place, for fits of one layout: where no shape differs by a tenth they are on the way to one minimum.
fn places(fits: impl IntoIterator<Item = Fit>) -> Vec<Fit> {
    let mut out: Vec<Fit> = Vec::new();
    for fit in fits {
        let shapes = fit.layout.shapes();
        let alike = |a: f64, b: f64| (a - b).abs() <= ONE_PLACE * a.abs().max(b.abs());
        let known = |other: &Fit| shapes.iter().all(|&i| alike(fit.point.theta[i], other.point.theta[i]));
        if !out.iter().any(known) {
            out.push(fit);
        }
    }
    out
}

/// Share that a cost `after` takes away of what `before` holds beside noise, of which a target costs 1; 0 where nothing but noise is there.
pub fn taken_away(before: f64, after: f64, targets: usize) -> f64 {
    let missing = before - targets as f64;
    if missing > 0.0 { (before - after) / missing } else { 0.0 }
}

/// The fit of the lowest cost.
fn best(fits: impl IntoIterator<Item = Fit>) -> Option<Fit> {
    fits.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::effects::find;

    #[test]
    fn fits_whose_shapes_hardly_differ_are_at_one_place_whatever_their_sizes() {
        let layout = Layout::base(&model::Parameters::example()).with(find("stribeck_friction").expect("an effect"));
        let at = |cost: f64, [size, w_v, w_s]: [f64; 3]| {
            let mut theta = vec![0.5; layout.first_of(0)];
            theta.extend([size, w_v, w_s]);
            Fit { layout: layout.clone(), point: Point { theta, initial: Vec::new() }, cost, converged: true }
        };
        let all = [[1.0, 0.2, 0.01], [2.0, 0.21, 0.0101], [1.0, 0.2, 0.02], [1.0, 0.8, 0.01], [1.1, 0.2, 0.0199]];
        let found = places(all.into_iter().zip(1..).map(|(values, cost)| at(f64::from(cost), values)));
        assert_eq!(found.iter().map(|fit| fit.cost).collect::<Vec<_>>(), [1.0, 3.0, 4.0], "the first of each");
    }

    #[test]
    fn what_an_effect_takes_away_is_a_share_of_what_noise_does_not_explain() {
        assert_eq!(taken_away(1200.0, 1100.0, 1000), 0.5);
        assert_eq!(taken_away(1200.0, 1000.0, 1000), 1.0);
        let far = taken_away(1e6, 5e5, 1000);
        assert!((far - 0.5).abs() < 1e-3, "far from the noise a share of the cost: {far}");
        assert!(taken_away(1200.0, 1300.0, 1000) < 0.0, "a worse fit");
        assert_eq!(taken_away(990.0, 980.0, 1000), 0.0, "where nothing is missing nothing leads");
    }
}
