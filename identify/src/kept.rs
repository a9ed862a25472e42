//! The derivatives at the end of a fit, for all who judge it.
//!
//! What is left out of a fit, its standard errors, its intervals, and a further fit from where it ended all begin with the same linearisation, which costs as
//! much as five simulations. A problem keeps the last one that it was given or asked for in this way.

use std::sync::{Arc, Mutex, PoisonError};

use model::integrate::SimulationError;

use crate::layout::Layout;
use crate::problem::{Piece, Point, Problem};

/// The last linearisation; a copy of a problem begins with none.
#[derive(Default)]
pub struct Kept(Mutex<Option<Linear>>);

/// Derivatives, and what they belong to.
struct Linear {
    layout: Layout,
    point: Point,
    std: Vec<Vec<f64>>,
    pieces: Arc<Vec<Piece>>,
}

impl Clone for Kept {
    fn clone(&self) -> Self {
        Kept::default()
    }
}

impl std::fmt::Debug for Kept {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Kept")
    }
}

impl Linear {
    fn is_of(&self, problem: &Problem, layout: &Layout, point: &Point) -> bool {
        let own = &self.layout;
        let same_effects = own.effects.len() == layout.effects.len()
            && own.effects.iter().zip(&layout.effects).all(|(a, b)| std::ptr::eq(a.header(), b.header()));
        same_effects
            && (&own.base, &own.fixed, &own.held) == (&layout.base, &layout.fixed, &layout.held)
            && (&self.point.theta, &self.point.initial) == (&point.theta, &point.initial)
            && self.std == problem.std
            && self.pieces.iter().zip(&problem.stretches).all(|(p, s)| p.residual.len() == s.targets.len())
    }
}

impl Problem {
    /// As [`Problem::linearise`], from what is kept where that is of this point; it is kept then.
    ///
    /// # Errors
    /// As there.
    pub fn linearised(&self, layout: &Layout, point: &Point) -> Result<Arc<Vec<Piece>>, SimulationError> {
        match self.kept_at(layout, point) {
            Some(pieces) => Ok(pieces),
            None => Ok(self.keep(layout, point, self.linearise(layout, point)?)),
        }
    }

    /// Keeps a linearisation.
    pub(crate) fn keep(&self, layout: &Layout, point: &Point, pieces: Vec<Piece>) -> Arc<Vec<Piece>> {
        let pieces = Arc::new(pieces);
        let (layout, point, std) = (layout.clone(), point.clone(), self.std.clone());
        let mut kept = self.kept.0.lock().unwrap_or_else(PoisonError::into_inner);
        *kept = Some(Linear { layout, point, std, pieces: Arc::clone(&pieces) });
        pieces
    }

    /// What is kept, where it is of this point.
    pub(crate) fn kept_at(&self, layout: &Layout, point: &Point) -> Option<Arc<Vec<Piece>>> {
        let kept = self.kept.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.as_ref().filter(|linear| linear.is_of(self, layout, point)).map(|linear| Arc::clone(&linear.pieces))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use model::Parameters;
    use model::effects::find;

    use crate::common::{dynamic, layout, problem};

    #[test]
    fn what_is_kept_is_of_the_same_point_model_and_noise() {
        let truth = Parameters::example();
        let mut problem = problem(&[dynamic(&truth, None, 4.0, 7)]);
        let layout = layout(&truth);
        let point = problem.point(layout.vector_of(&truth));
        let first = problem.linearised(&layout, &point).unwrap();
        assert!(Arc::ptr_eq(&first, &problem.linearised(&layout, &point).unwrap()));
        assert!(problem.clone().kept_at(&layout, &point).is_none(), "a copy begins with none");
        let mut moved = point.clone();
        moved.initial[0][1] += 1e-9;
        assert!(problem.kept_at(&layout, &moved).is_none(), "another start");
        let mut held = layout.clone();
        held.held.insert(0);
        assert!(problem.kept_at(&held, &point).is_none(), "an entry is held");
        let with = |id| layout.with(find(id).unwrap());
        let mut beside = point.clone();
        beside.theta.push(0.0);
        let tilted = problem.linearised(&with("pump_lag"), &beside).unwrap();
        assert!(problem.kept_at(&with("angle_offset"), &beside).is_none(), "another effect");
        assert!(Arc::ptr_eq(&tilted, &problem.linearised(&with("pump_lag"), &beside).unwrap()));
        problem.std[0][0] *= 2.0;
        assert!(problem.kept_at(&with("pump_lag"), &beside).is_none(), "other noise");
    }
}
