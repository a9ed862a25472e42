//! Shapes of effects, looked for by trial. A fit that follows slopes can stay where it began: a contact that does not close has none, and far from
//! its place a shape only trades places with the sizes. Between two trials everything else is fitted.

use model::effects::find;

use crate::fit::{Effort, Fit, fit, promised_minimum};
use crate::layout::Layout;
use crate::problem::Problem;

/// First and last step, as a share of a shape's range (of its logarithm, where the range is positive).
const STEPS: [f64; 4] = [0.2, 0.1, 0.05, 0.025];
/// A trial counts that leaves at most this share of the cost.
const BETTER: f64 = 0.98;
/// A trial is a few steps with all shapes held, where the slopes promise as much.
const TRIAL: Effort = Effort { iterations: 2, tolerance: 1e-3, promise: f64::INFINITY, creep: 0.0, ahead: false };
/// Most trials.
const MOST: usize = 24;

/// A shape in the parameter vector.
struct Shape {
    entry: usize,
    lower: f64,
    upper: f64,
    /// One of a general form's own, which start where such forms lie and would cost many trials.
    form: bool,
}

impl Shape {
    /// The value a share of the range away, within it.
    fn moved(&self, value: f64, share: f64) -> f64 {
        let moved = if self.lower > 0.0 {
            value * (share * (self.upper / self.lower).ln()).exp()
        } else {
            value + share * (self.upper - self.lower)
        };
        moved.clamp(self.lower, self.upper)
    }
}

/// The fit, or a better one with other shapes, brought to its minimum with this effort.
pub fn search(problem: &Problem, found: Fit, effort: Effort) -> Fit {
    let shapes: Vec<Shape> = shapes_of(&found.layout).into_iter().filter(|s| !s.form).collect();
    let layout = held(&found.layout);
    let (mut best, mut trials) = (found, 0);
    let begun = best.cost;
    let mut steps = STEPS.iter().copied().peekable();
    while let Some(&step) = steps.peek() {
        let mut moved = false;
        for shape in &shapes {
            for share in [step, -step] {
                let mut point = best.point.clone();
                point.theta[shape.entry] = shape.moved(point.theta[shape.entry], share);
                if point.theta[shape.entry] == best.point.theta[shape.entry] || trials >= MOST {
                    continue;
                }
                trials += 1;
                if promised_minimum(problem, &layout, &point).is_ok_and(|promised| promised < BETTER * best.cost)
                    && let Ok(tried) = fit(problem, &layout, point, TRIAL)
                    && tried.cost < BETTER * best.cost
                {
                    best = Fit { layout: best.layout, ..tried };
                    moved = true;
                    break;
                }
            }
        }
        if !moved {
            steps.next();
        }
    }
    if best.cost == begun {
        return best;
    }
    tracing::debug!(from = begun, to = best.cost, trials, "other shapes");
    match fit(problem, &best.layout, best.point.clone(), effort) {
        Ok(better) if better.cost < best.cost => better,
        _ => best,
    }
}

/// The same parameters with all shapes held.
pub fn held(layout: &Layout) -> Layout {
    let mut held = layout.clone();
    held.held.extend(layout.shapes());
    held
}

fn shapes_of(layout: &Layout) -> Vec<Shape> {
    let mut out = Vec::new();
    for (n, effect) in layout.effects.iter().enumerate() {
        let first = layout.first_of(n);
        let header = effect.header();
        let plain = find(header.id).map_or(header.parameters.len(), |e| e.header().parameters.len());
        for (i, p) in header.parameters.iter().enumerate().filter(|(_, p)| !p.size) {
            if !layout.held.contains(&(first + i)) {
                out.push(Shape { entry: first + i, lower: p.lower, upper: p.upper, form: i >= plain });
            }
        }
    }
    out
}
