//! The reference model's false minima in free run: a threshold of the friction a little off, say, and the lever sticks elsewhere. What such a fit leaves looks
//! like an effect that the model lacks.

use model::Parameters;
use model::integrate::SimulationError;

use crate::fit::{Effort, FAR, Fit, fit};
use crate::guided::{GUIDED_S, Guided};
use crate::problem::Problem;

/// The first seconds of each run that a fit is led over: a short horizon has few false minima.
const HORIZONS_S: [f64; 2] = [8.0, 40.0];
/// What leaves so many times what the other fit leaves there, although only that horizon was fitted, is on its way to a higher minimum.
const BEHIND: f64 = 2.0;
/// Where both are far from the noise the model lacks something, and a minimum that is hardly lower, by a share of what the other one leaves, is not worth its way.
const LOWER: f64 = 0.9;
const LEAD: Effort = Effort { iterations: 12, tolerance: 1e-4, promise: f64::INFINITY, creep: CREEP, ahead: false };
/// Share of the cost: a fit of the reference model far from the noise that gains less in each of several steps is given up there.
pub(crate) const CREEP: f64 = 0.01;
/// Steps on the whole runs that tell whether the way leads lower.
const FEW: Effort = Effort { iterations: 4, ..LEAD };

/// The better of two fits of one model: as it is, and once more from `afar`, base values that no effect has bent, over longer and longer horizons. What an
/// effect gains must not be what another start would have gained without it. A way that falls behind on a short horizon is not gone to its end.
pub fn left_behind(problem: &Problem, reached: Fit, afar: &[f64]) -> Fit {
    let mut theta = afar.to_vec();
    for seconds in HORIZONS_S {
        let horizon = problem.shortened(seconds);
        let Ok(led) = fit(&horizon, &reached.layout, horizon.point(theta), LEAD) else { return reached };
        let far = led.cost > FAR * horizon.targets() as f64;
        if led.cost > if far { LOWER } else { BEHIND } * horizon.cost(&reached.layout, &reached.point) {
            return reached;
        }
        theta = led.point.theta;
    }
    match on_the_whole(problem, &reached, theta) {
        Ok(led) if led.cost < reached.cost => {
            tracing::info!(from = reached.cost, to = led.cost, "the fit was in a false minimum");
            led
        }
        _ => reached,
    }
}

/// Noise variances a target from which more than noise is left: a lever that sticks aside leaves many.
const MORE_THAN_NOISE: f64 = 1.2;

/// The better of two fits of one model: as it is, and from where a guide lets go of it. Under a guide a lever that sticks elsewhere is led on, so no
/// threshold of the friction holds the fit up; where the model leaves more than noise there as well, no false minimum is in the way. `afar`: other values to
/// begin with under the guide.
pub fn led_out(problem: &Problem, reached: Fit, afar: &[f64]) -> Fit {
    let leaves_noise = |fit: &Fit, problem: &Problem| fit.cost < MORE_THAN_NOISE * problem.targets() as f64;
    if leaves_noise(&reached, problem) {
        return reached;
    }
    let guided = Guided::new(&problem.shortened(GUIDED_S), &reached.layout, &reached.point.theta, afar);
    let guided = guided.filter(|guided| guided.tightest().is_some_and(|(tight, fit)| leaves_noise(fit, tight)));
    let starts = guided.map_or_else(Vec::new, |guided| guided.let_go());
    starts.iter().fold(reached, |best, start| left_behind(problem, best, start))
}

/// The same model fitted to the whole runs from `theta` on: to its minimum, unless that is far from the noise and a few steps lead to nothing lower than where
/// it was `reached`.
fn on_the_whole(problem: &Problem, reached: &Fit, theta: Vec<f64>) -> Result<Fit, SimulationError> {
    let few = fit(problem, &reached.layout, problem.point(theta), FEW)?;
    let far = few.cost > FAR * problem.targets() as f64;
    if few.converged || (far && few.cost > LOWER * reached.cost) {
        return Ok(few);
    }
    fit(problem, &few.layout, few.point, LEAD)
}

/// The losses' branches take the place of a friction that the model lacks, and hardly find back from there. Where a fit starts from afar they start as plain
/// Coulomb friction, of half the least loss at any usual velocity, with the paper's threshold.
pub fn with_plain_losses(component: Parameters) -> Parameters {
    let mut out = component;
    let known = component.losses;
    let loss_nm = |w: f64| known.l1 * w + known.l2 + known.l3 / w;
    let least = [0.05, 0.1, 0.2, 0.5, 1.0].into_iter().map(loss_nm).fold(f64::INFINITY, f64::min);
    out.losses.l1 = 0.0;
    out.losses.l2 = 0.5 * least.max(0.0);
    out.losses.l3 = 0.0;
    out.losses.a = Parameters::example().losses.a;
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};

    #[test]
    fn far_from_the_noise_a_minimum_that_is_no_lower_is_left_and_a_lower_one_is_taken() {
        let truth = Parameters::example();
        let late = model::effects::find("pump_lag").unwrap();
        let runs = [7, 8].map(|seed| dynamic(&truth, Some((late, vec![0.08])), 12.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        let afar = layout.vector_of(&with_plain_losses(truth));
        let reached = fit(&problem, &layout, problem.point(layout.vector_of(&truth)), Effort::default()).unwrap();
        assert!(reached.cost > 2.0 * FAR * problem.targets() as f64, "a misfit of {}", reached.cost);
        let led = left_behind(&problem, reached.clone(), &afar);
        assert!(led.cost <= reached.cost && led.cost > LOWER * reached.cost, "{} of {}", led.cost, reached.cost);

        // a little beside its minimum, as a fit is that was given up: not worth the way
        let at = |n: i32| {
            let mut point = reached.point.clone();
            point.theta.iter_mut().for_each(|v| *v *= 1.0002_f64.powi(n));
            Fit { cost: problem.cost(&layout, &point), point, ..reached.clone() }
        };
        let beside = (0..200).map(at).find(|fit| fit.cost > 1.01 * reached.cost).unwrap();
        assert!(beside.cost < 1.08 * reached.cost, "{} beside {}", beside.cost, reached.cost);
        assert_eq!(left_behind(&problem, beside.clone(), &afar).cost, beside.cost);

        let mut astray = truth;
        astray.losses.l2 *= 3.0;
        let point = problem.point(layout.vector_of(&astray));
        let stuck = Fit { cost: problem.cost(&layout, &point), point, ..reached.clone() };
        assert!(stuck.cost > 3.0 * reached.cost, "{} beside {}", stuck.cost, reached.cost);
        let led = left_behind(&problem, stuck, &afar);
        assert!(led.cost < 1.2 * reached.cost, "{} beside {}", led.cost, reached.cost);
    }

    #[test]
    fn a_guide_leads_a_fit_on_where_nothing_is_missing_and_leaves_it_where_something_is() {
        let truth = Parameters::example();
        let runs = [7, 8].map(|seed| dynamic(&truth, None, 20.0, seed));
        let (problem, layout) = (problem(&runs), layout(&truth));
        let targets = problem.targets() as f64;
        // it drives itself where it moves fast: a free run from there is elsewhere within a second
        let mut astray = truth;
        (astray.losses.l1, astray.losses.l2, astray.torque.m3) = (-6.0, 4.0, 1.1 * truth.torque.m3);
        let from = layout.vector_of(&astray);
        let point = problem.point(from.clone());
        let cost = problem.cost(&layout, &point);
        assert!(cost > 100.0 * targets, "{}", cost / targets);
        let led = led_out(&problem, Fit { layout: layout.clone(), point, cost, converged: false }, &from);
        assert!(led.cost < 1.02 * targets, "{}", led.cost / targets);
        assert_eq!(led_out(&problem, led.clone(), &from).point.theta, led.point.theta, "what leaves noise stays");

        let late = model::effects::find("pump_lag").unwrap();
        let runs = [7, 8].map(|seed| dynamic(&truth, Some((late, vec![0.08])), 12.0, seed));
        let (problem, from) = (self::problem(&runs), layout.vector_of(&truth));
        let reached = fit(&problem, &layout, problem.point(from.clone()), Effort::default()).unwrap();
        assert_eq!(
            led_out(&problem, reached.clone(), &from).cost,
            reached.cost,
            "what is missing shows under the guide"
        );
    }

    #[test]
    fn plain_losses_are_coulomb_friction_below_what_was_seen() {
        let mut bent = Parameters::example();
        bent.losses.l1 = 0.4;
        bent.losses.l2 = 0.2;
        bent.losses.l3 = 5.0;
        let plain = with_plain_losses(bent);
        assert_eq!((plain.losses.l1, plain.losses.l3), (0.0, 0.0));
        assert!((plain.losses.l2 - 2.8).abs() < 1e-12, "half of what is lost at 1 rad/s: {}", plain.losses.l2);
        assert_eq!((plain.torque, plain.pump), (bent.torque, bent.pump), "nothing else moves");
        bent.losses.l2 = -9.0;
        assert_eq!(with_plain_losses(bent).losses.l2, 0.0, "no friction drives");
    }
}
