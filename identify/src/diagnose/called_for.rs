//! Whether a round of candidates is worth it, on what the last step leaves.

use model::integrate::SimulationError;

use super::found::{Found, Step};
use super::round::Round;
use super::search::Search;
use super::{CLEAR, CONSISTENT, GROSS, LEVEL, LOST, SUBSTANTIAL, most_names};
use crate::misfit;

/// Share of what is left that a second name does at least linearly, where it is one that does nearly all of it.
const A_GOOD_PART: f64 = 0.5;

/// What names leave, `of_whole` as a share of what there was, is no substantial part of it, so a second name would have to do nearly all of it; and no
/// candidate does a good part of it even linearly (`linearly`, as a share of what is left). Or it is a tenth of the amplitude of the whole, as another form
/// leaves, and hardly more than noise (`largest`, noise floors): whatever does all of that, it is no second effect.
fn matter_of_form(of_whole: f64, linearly: f64, largest: f64) -> bool {
    (of_whole < SUBSTANTIAL && linearly < A_GOOD_PART) || (of_whole < FORM_OF_ONE && largest < CONSISTENT)
}

/// Candidates are worth refitting: the library's score test says so (`p`), or the structured residual does (`largest`, noise floors), or, for a first name
/// (`first`), both do a little. Linearly little may go with a friction that a refit finds at once; whether one is named is the other judges' matter.
fn is_called_for(p: f64, largest: f64, first: bool) -> bool {
    p <= LEVEL || largest >= CLEAR || (first && largest > CONSISTENT && p <= SUGGESTIVE)
}

/// Level of the score test that says little alone.
const SUGGESTIVE: f64 = 0.05;

/// Share of the whole, a tenth of its amplitude, that the form of a name may leave.
const FORM_OF_ONE: f64 = 0.01;

/// Names that leave `largest` noise floors, and this share `left` of what was missing on data left out, and take away this share `of_cost` of the fit's cost,
/// do not lead out of a gross misfit.
fn leads_nowhere(largest: f64, left: f64, of_cost: f64) -> bool {
    largest > GROSS && left > 1.0 - LOST && of_cost < LOST
}

impl Search<'_> {
    /// Candidates are worth refitting on what the last step leaves ([`is_called_for`]).
    pub fn calls_for(&self, found: &mut Found, round: &Round) -> bool {
        let largest = misfit::largest(&found.parts(self.problem, found.last()));
        let p = round.p_value(|_| true);
        tracing::info!(p, largest, "score of the whole library");
        if let Some(last) = found.steps.last_mut() {
            last.silent = p > LEVEL;
        }
        is_called_for(p, largest, found.steps.len() == 1)
    }

    /// The misfit is gross, and the names of this step do not lead out of it.
    pub fn is_lost(&self, found: &Found, step: &Step) -> bool {
        let left = self.left(found, step);
        let before = misfit::total(&self.left(found, &found.steps[0]));
        let of_cost = 1.0 - step.fit.cost / found.steps[0].fit.cost;
        leads_nowhere(misfit::largest(&left), misfit::total(&left) / before, of_cost)
    }

    /// What is left is a matter of the form of what is named ([`matter_of_form`]).
    pub fn is_settled(&self, found: &Found, round: &Round) -> Result<bool, SimulationError> {
        let last = self.left(found, found.last());
        let largest = misfit::largest(&last);
        let of_whole = misfit::total(&last) / misfit::total(&self.left(found, &found.steps[0]));
        let fit = round.scene.fit;
        let residual = self.brief.residuals(&fit.layout, &fit.point)?;
        let left = misfit::cost(&misfit::parts(&self.brief, &residual, &found.colours));
        let most = round.shortlist(&self.open(fit), 3).iter().map(|set| round.gain_of(set)).fold(0.0, f64::max);
        tracing::info!(of_whole, largest, left, most, "what a second name could do, linearly");
        Ok(matter_of_form(of_whole, most / left, largest) && !self.leads_on(round, of_whole, largest)?)
    }

    /// What names leave is gross, and more than the form of one is known to leave: of that a free run, which is elsewhere, says little linearly. A candidate takes
    /// away most of it under the guide.
    pub fn leads_on(&self, round: &Round, of_whole: f64, largest: f64) -> Result<bool, SimulationError> {
        if largest <= GROSS || of_whole < FORM_OF_ONE {
            return Ok(false);
        }
        self.leads_out(round)
    }

    /// How many names what the reference model leaves can bear.
    pub fn most_names(&self, found: &Found) -> usize {
        let before = misfit::largest(&found.parts(self.problem, &found.steps[0]));
        let total = |step: &Step| misfit::total(&self.left(found, step));
        let left = if found.steps.len() > 1 { total(found.last()) / total(&found.steps[0]) } else { 0.0 };
        most_names(before, left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidates_are_tried_where_one_sign_is_clear_or_for_a_first_name_two_are_not() {
        assert!(is_called_for(0.004, 0.2, false) && is_called_for(0.5, 0.8, false));
        assert!(is_called_for(0.01, 0.5, true), "more than noise leaves, and more than chance has it");
        assert!(!is_called_for(0.01, 0.5, false), "what a form leaves");
        assert!(!is_called_for(0.01, 0.4, true) && !is_called_for(0.06, 0.6, true), "one of them alone");
    }

    #[test]
    fn names_lead_nowhere_that_leave_most_of_a_gross_misfit_by_every_measure() {
        assert!(leads_nowhere(16.0, 0.8, 0.2));
        assert!(!leads_nowhere(1.0, 0.8, 0.2), "what is not gross any more");
        assert!(!leads_nowhere(16.0, 0.5, 0.2) && !leads_nowhere(16.0, 0.8, 0.5), "half of two");
        assert!(!leads_nowhere(0.0, f64::NAN, 0.0), "nothing was there");
    }

    #[test]
    fn what_no_candidate_does_a_good_part_of_is_a_matter_of_form_unless_it_is_much() {
        assert!(matter_of_form(0.001, 0.1, 2.0));
        assert!(!matter_of_form(0.1, 0.1, 2.0), "much is left: two may act");
        assert!(!matter_of_form(0.001, 0.9, 2.0), "a candidate does nearly all that is left");
        assert!(matter_of_form(0.004, 1.0, 0.16), "which is hardly more than noise, and little of the whole");
        assert!(!matter_of_form(0.02, 1.0, 0.3), "a seventh of the amplitude");
        assert!(!matter_of_form(f64::NAN, f64::NAN, 0.0), "nothing was there");
    }
}
