//! Steps that follow a valley which bends.
//!
//! Shapes of an effect that trade places make the cost a narrow valley that curves: a straight step leaves it soon, and a fit of such steps creeps and ends
//! where its steps gain little, not at the minimum. The second derivative of the residuals along the step, which one more simulation a short way along it
//! tells, says how the valley bends. That is the geodesic acceleration of Transtrum, Machta and Sethna (Phys. Rev. E 83, 036701, 2011).

use nalgebra::DVector;

use crate::fit::clip;
use crate::layout::Layout;
use crate::normal::{Normal, take_moved};
use crate::predict::Initial;
use crate::problem::{Piece, Point, Problem};

/// Share of the step at which the bend is looked at: far enough for what the integration leaves to vanish beside it, near enough to be of second order.
const AHEAD: f64 = 0.1;

/// A correction that is larger than this share of its step is beyond what a second order can say.
const MOST: f64 = 0.375;

/// What a straight step lacks.
pub(crate) struct Bend {
    /// Of the parameters, in the order of the layout.
    pub theta: DVector<f64>,
    /// Of the initial values, by stretch, beside what follows from the parameters.
    pub initial: Vec<Initial>,
    /// Its size over that of the step, both by what they do to the predictions.
    pub share: f64,
}

/// The bend of a parameters' step from a linearised point. `solve`: the step that a gradient asks for, damped as this one was. `None` where nothing a short
/// way along can be simulated, or where the step goes too far for its bend to be told.
pub(crate) fn bend(
    problem: &Problem,
    layout: &Layout,
    (point, pieces, normal): (&Point, &[Piece], &Normal),
    step: &DVector<f64>,
    solve: impl Fn(&DVector<f64>) -> Option<DVector<f64>>,
) -> Option<Bend> {
    let initial: Vec<Initial> =
        normal.initial_step(step).iter().map(|d| d.iter().map(|d| AHEAD * d).collect()).collect();
    let mut near = point.clone();
    near.theta.iter_mut().zip(step.iter()).for_each(|(value, d)| *value += AHEAD * d);
    clip(&mut near.theta, &layout.bounds());
    let theta = DVector::from_iterator(step.len(), near.theta.iter().zip(&point.theta).map(|(a, b)| a - b));
    for (values, d) in near.initial.iter_mut().zip(&initial) {
        values.iter_mut().zip(d).for_each(|(value, d)| *value += d);
    }
    let off = off_the_line(problem, layout, pieces, &near, (&theta, &initial))?;
    let (gradient, own) = normal.gradient_of(pieces, &off);
    // off = (AHEAD^2 / 2) r'' and the correction is half of what r'' asks for
    let scale = 1.0 / (AHEAD * AHEAD);
    let theta = solve(&gradient)? * scale;
    let size = |v: &DVector<f64>| v.iter().enumerate().map(|(i, v)| normal.matrix[(i, i)] * v * v).sum::<f64>().sqrt();
    let own = normal.back(&DVector::zeros(theta.len()), &own);
    let initial = own.into_iter().map(|d| d.into_iter().map(|d| scale * d).collect()).collect();
    let share = size(&theta) / size(step);
    (share <= MOST).then_some(Bend { theta, initial, share })
}

/// How far the residuals at a point lie from where the straight line leads, from linearised pieces by this step of parameters and initial values.
fn off_the_line(
    problem: &Problem,
    layout: &Layout,
    pieces: &[Piece],
    there: &Point,
    (step, initial): (&DVector<f64>, &[Initial]),
) -> Option<Vec<Vec<f64>>> {
    let mut off = problem.residuals(layout, there).ok()?;
    for (piece, off) in pieces.iter().zip(&mut off) {
        off.iter_mut().zip(&piece.residual).for_each(|(there, here)| *there -= here);
    }
    // residuals are measured - predicted
    let back: Vec<Initial> = initial.iter().map(|d| d.iter().map(|d| -d).collect()).collect();
    take_moved(&mut off, pieces, &-step, &back);
    Some(off)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use crate::fit::{damped_step, moved};
    use model::Parameters;
    use model::effects::find;

    /// Of a stop whose depth and law trade places.
    #[test]
    fn with_its_bend_a_step_leads_where_the_straight_line_meant_to() {
        let mut truth = Parameters::example();
        // so that the lever comes to its ends
        truth.pump.f1 *= 4.0;
        let rubber = find("end_stop").and_then(|e| e.refined()).unwrap().effect;
        let sealed = vec![6.0, 6.0, 18.0, 10.0, 0.0, 0.0, 0.06];
        let problem = problem(&[dynamic(&truth, Some((rubber, sealed.clone())), 20.0, 7)]);
        let component = layout(&truth);
        let point = problem.point([component.vector_of(&truth), sealed].concat());
        let layout = component.with(rubber);
        let pieces = problem.linearise(&layout, &point).unwrap();
        let normal = problem.normal(&pieces, layout.len(), &point);
        let held = vec![false; layout.len()];
        // a way of the contact's shapes alone, a fifth of each
        let mut step = DVector::zeros(layout.len());
        for i in layout.shapes() {
            step[i] = 0.2 * point.theta[i];
        }
        let solve = |gradient: &DVector<f64>| damped_step(&normal.matrix, gradient, &held, 1e-4);
        // what is off the straight line goes with the square of the step, what is off the bent one with its cube
        for (share, most) in [(0.1, 0.6), (0.05, 0.15)] {
            let step = &step * share;
            let bend = bend(&problem, &layout, (&point, &pieces, &normal), &step, solve).unwrap();
            // what parameters, and initial values, could undo of the way off the straight line
            let off = |bend: Option<&Bend>| {
                let there = moved(&point, &normal, &step, bend, &layout.bounds());
                let straight = (&step, &normal.initial_step(&step)[..]);
                let off = off_the_line(&problem, &layout, &pieces, &there, straight).unwrap();
                let (gradient, own) = normal.gradient_of(&pieces, &off);
                let undone = solve(&gradient).unwrap();
                let initial = normal.back(&DVector::zeros(undone.len()), &own);
                let of_initial = initial.iter().flatten().map(|d| d * d).sum::<f64>().sqrt();
                (undone.dot(&(&normal.matrix * &undone)).sqrt(), of_initial)
            };
            let (with, without) = (off(Some(&bend)), off(None));
            assert!(with.0 < most * without.0 && with.1 < most * without.1, "{share}: {with:?} {without:?}");
        }
    }
}
