//! Which of many starts of a fit cost least.

use std::sync::{Mutex, PoisonError};

use model::integrate::SimulationError;

use crate::layout::Layout;
use crate::problem::{Point, Problem};

/// Relative slack of a sum of squares: its order is not that of another one.
const ROUNDING: f64 = 1e-9;

impl Problem {
    /// The cost at a point if it is no more than `most`, and else infinite: what costs more is not simulated to its end.
    pub(crate) fn cost_up_to(&self, layout: &Layout, point: &Point, most: f64) -> f64 {
        let so_far = Mutex::new(0.0);
        // a thread that panicked with it has left what was there before
        let sum = || so_far.lock().unwrap_or_else(PoisonError::into_inner);
        let own = |n: usize| {
            if *sum() > most * (1.0 + ROUNDING) {
                return Ok(f64::INFINITY);
            }
            let cost = self.cost_of_stretch(n, layout, &point.theta, &point.initial[n]);
            *sum() += cost;
            Ok::<_, SimulationError>(cost)
        };
        let cost = self.each(own).map_or(f64::INFINITY, |costs| costs.iter().sum());
        if cost <= most { cost } else { f64::INFINITY }
    }

    /// The `most` points of these that cost least, the cheapest first, with their costs; without those where the model can't be simulated.
    pub(crate) fn cheapest(
        &self,
        layout: &Layout,
        points: impl IntoIterator<Item = Point>,
        most: usize,
    ) -> Vec<(f64, Point)> {
        let mut out: Vec<(f64, Point)> = Vec::new();
        for point in points {
            let bound = if out.len() < most { f64::MAX } else { out.last().map_or(f64::MAX, |(cost, _)| *cost) };
            let cost = self.cost_up_to(layout, &point, bound);
            if cost.is_finite() {
                out.push((cost, point));
                out.sort_by(|a, b| a.0.total_cmp(&b.0));
                out.truncate(most);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use crate::common::{dynamic, layout, problem};
    use model::Parameters;

    #[test]
    fn the_cheapest_are_those_that_all_their_costs_say_and_what_cannot_be_simulated_is_none() {
        let truth = Parameters::example();
        let runs = [7, 8, 9].map(|seed| dynamic(&truth, None, 4.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        let at = |factor: f64| {
            let mut point = problem.point(layout.vector_of(&truth));
            point.theta[0] *= factor;
            point
        };
        let factors = [1.3, f64::NAN, 1.02, 0.9, 1.0, 1.1, 0.97];
        let found = problem.cheapest(&layout, factors.map(at), 3);
        let mut all: Vec<f64> = factors.iter().map(|f| problem.cost(&layout, &at(*f))).collect();
        all.retain(|cost| cost.is_finite());
        all.sort_by(f64::total_cmp);
        assert_eq!(all.len(), 6, "one can't be simulated");
        assert_eq!(found.iter().map(|(cost, _)| *cost).collect::<Vec<_>>(), all[..3]);
        for (cost, point) in &found {
            assert_eq!(*cost, problem.cost(&layout, point));
            assert_eq!(problem.cost_up_to(&layout, point, 0.99 * cost), f64::INFINITY);
        }
        assert_eq!(problem.cheapest(&layout, factors.map(at), 9).len(), 6);
    }
}
