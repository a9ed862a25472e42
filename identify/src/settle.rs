//! Initial values of single stretches that must not hold up a fit.
//!
//! Given the parameters the stretches know nothing of each other, so the initial values of each go their own way. Their whole step may overshoot:
//! two pressures that level out through an open valve tell little of their difference but its sign (flow by the root of it), and one such
//! stretch of a dozen targets would have every step of all parameters refused.

use rayon::prelude::*;

use crate::layout::Layout;
use crate::normal::Normal;
use crate::predict::Initial;
use crate::problem::{Piece, Point, Problem};

/// Shares of the step of a stretch's initial values (their own, and what follows from the parameters' step) that are tried where none of it is better than all.
const SHARES: [f64; 4] = [0.5, 0.25, 0.125, 0.03125];

impl Problem {
    /// By stretch: weighted sum of squares with what the initial values' prior says.
    pub(crate) fn cost_by_stretch(&self, pieces: &[Piece], point: &Point) -> Vec<f64> {
        pieces.iter().enumerate().map(|(n, piece)| self.cost_with(n, &piece.residual, &point.initial[n])).collect()
    }

    /// The same at a point; infinite of a stretch that can't be simulated there.
    pub(crate) fn cost_by_stretch_at(&self, layout: &Layout, point: &Point) -> Vec<f64> {
        let own = |n: usize| Ok(self.cost_of_stretch(n, layout, &point.theta, &point.initial[n]));
        self.each(own).unwrap_or_else(|_| vec![f64::INFINITY; self.stretches.len()])
    }

    fn cost_with(&self, n: usize, residual: &[f64], initial: &Initial) -> f64 {
        residual.iter().map(|r| r * r).sum::<f64>() + self.prior_of(n, initial)
    }

    /// A stretch's part of the cost; infinite where it can't be simulated.
    pub(crate) fn cost_of_stretch(&self, n: usize, layout: &Layout, theta: &[f64], initial: &Initial) -> f64 {
        let residual = self.residual_of(n, layout, theta, initial);
        let cost = residual.map_or(f64::INFINITY, |residual| self.cost_with(n, &residual, initial));
        if cost.is_finite() { cost } else { f64::INFINITY }
    }

    /// `trial`, a step from `from`, with shorter steps of those stretches' initial values that have spoilt it: whose whole step has promised more than
    /// `worth` and made the stretch's cost larger than it was (`before`), `whole`, and a shorter one of which, or none, makes less of it. `None` where the
    /// trial costs no less than `from` even so.
    pub(crate) fn settled(
        &self,
        layout: &Layout,
        (from, before): (&Point, &[f64]),
        (trial, whole): (&Point, &[f64]),
        normal: &Normal,
        worth: f64,
    ) -> Option<Point> {
        let own = |n: usize, initial: &Initial| self.cost_of_stretch(n, layout, &trial.theta, initial);
        let promised = normal.promised_by_initial();
        let shorter: Vec<(usize, f64, Initial)> = (0..self.stretches.len())
            .into_par_iter()
            .filter(|&n| promised[n] > worth && whole[n] > before[n])
            .filter_map(|n| {
                let (start, end) = (&from.initial[n], &trial.initial[n]);
                let mut best = (own(n, start), start.clone());
                if best.0 >= whole[n] {
                    return None;
                }
                for share in SHARES {
                    let part: Initial = start.iter().zip(end).map(|(a, b)| a + share * (b - a)).collect();
                    let cost = own(n, &part);
                    if cost < best.0 {
                        best = (cost, part);
                    }
                }
                Some((n, best.0, best.1))
            })
            .collect();
        let mut costs = whole.to_vec();
        let mut out = trial.clone();
        for (n, cost, initial) in shorter {
            costs[n] = cost;
            out.initial[n] = initial;
        }
        (costs.iter().sum::<f64>() < before.iter().sum()).then_some(out)
    }
}

#[cfg(test)]
mod tests {
    use model::Parameters;
    use model::effects::EffectSet;
    use model::rec::{self, Circuit, Input, Lever, STATES, state};
    use recordings::{Plane, Protocol, Recording};

    use crate::common::{dynamic, layout, problem};
    use crate::fit::{Effort, fit};
    use crate::prepare::{Stand, Stretch, stretches};
    use crate::problem::Problem;

    /// A clamped lever at rest, the chambers joined through the open bypass.
    fn joined(truth: &Parameters, unexplained_nm: f64) -> Stretch {
        const PRESSURE_BAR: f64 = 3.0;
        let effects = EffectSet::new(STATES, []);
        let mut x = vec![0.0; STATES];
        (x[state::ANGLE], x[state::PRESSURE1], x[state::PRESSURE2]) = (-0.35, PRESSURE_BAR, PRESSURE_BAR);
        let lever = Lever::Led { velocity_rad_s: 0.0 };
        let (voltage_v, brake_open, bypass_open, vertical) = (0.0, true, true, false);
        let input = Input { voltage_v, brake_open, bypass_open, vertical, lever, circuit: Circuit::Pump };
        let torque_nm = rec::derivative(&input, &truth.to_vector(), &effects, 0.0, &x, &mut x.clone()).torque_nm;
        let mut r = Recording::default();
        for i in 0..100 {
            r.time_s.push(f64::from(i) * 0.01);
            r.voltage_v.push(voltage_v);
            r.angle_deg.push(x[state::ANGLE].to_degrees());
            r.pressure1_bar.push(PRESSURE_BAR);
            r.pressure2_bar.push(PRESSURE_BAR);
            r.torque_nm.push(torque_nm + unexplained_nm);
            r.volume_ml.push(f64::NAN);
            r.brake_open.push(brake_open);
            r.bypass_open.push(bypass_open);
            r.segment.push(0);
        }
        let mut cut = stretches(1, "torque.csv", Protocol::TorqueMap, Plane::Horizontal, &r).unwrap();
        assert!(cut.len() == 1 && cut[0].stand == Stand::Led && !cut[0].targets.is_empty());
        cut.remove(0)
    }

    /// A run, and a stretch whose pressures level out, and whose torque is off by so much.
    fn run_and_joined(truth: &Parameters, unexplained_nm: f64) -> Problem {
        let mut problem = problem(&[dynamic(truth, None, 12.0, 7)]);
        problem.stretches.push(joined(truth, unexplained_nm));
        problem.std.push(problem.std[0].clone());
        problem.steps.push(problem.steps[0].clone());
        problem
    }

    /// Cost a target of a fit from 2 % beside the truth and from pressures that level out from where they are not.
    fn fitted(effort: Effort) -> f64 {
        let truth = Parameters::example();
        let (problem, layout) = (run_and_joined(&truth, 0.0), layout(&truth));
        let mut start = problem.point(layout.vector_of(&truth));
        start.theta[1] *= 1.02;
        *start.initial.last_mut().unwrap() = vec![0.0, 0.11, -0.22];
        fit(&problem, &layout, start, effort).unwrap().cost / problem.targets() as f64
    }

    #[test]
    fn a_stretch_that_gains_nothing_by_its_initial_values_keeps_them_and_the_rest_of_the_step_is_taken() {
        let truth = Parameters::example();
        let (problem, layout) = (run_and_joined(&truth, 0.3), layout(&truth));
        let mut from = problem.point(layout.vector_of(&truth));
        from.theta[1] *= 1.02;
        let pieces = problem.linearise(&layout, &from).unwrap();
        let normal = problem.normal(&pieces, layout.len(), &from);
        assert!(normal.promised_by_initial().last().is_some_and(|promised| *promised > 0.0));
        let before = problem.cost_by_stretch(&pieces, &from);
        // the step of the parameters is right, that of the pressures far off: whatever share of it is tried is worse than none
        let mut trial = from.clone();
        trial.theta = layout.vector_of(&truth);
        *trial.initial.last_mut().unwrap() = vec![0.0, 40.0, -1.5];
        let whole = problem.cost_by_stretch_at(&layout, &trial);
        let total = |costs: &[f64]| costs.iter().sum::<f64>();
        assert!(total(&whole) > total(&before), "{} and {}", total(&whole), total(&before));
        let settled = problem.settled(&layout, (&from, &before), (&trial, &whole), &normal, 0.0).unwrap();
        assert_eq!(settled.initial.last(), from.initial.last());
        assert_eq!(settled.theta, trial.theta);
        let own = problem.cost_by_stretch_at(&layout, &settled);
        assert!(own.last() >= before.last(), "by itself that stretch gains nothing");
        assert!(total(&own) < total(&before));
        // where the rest is worse as well there is nothing to settle
        let mut spoilt = trial.clone();
        spoilt.theta[1] *= 1.1;
        let whole = problem.cost_by_stretch_at(&layout, &spoilt);
        assert!(problem.settled(&layout, (&from, &before), (&spoilt, &whole), &normal, 0.0).is_none());
    }

    #[test]
    fn one_stretch_whose_pressures_level_out_holds_up_no_fit() {
        for effort in [Effort::default(), crate::identification::polish()] {
            let left = fitted(effort);
            assert!(left < 1.1, "{left}");
        }
    }
}
