//! From the residual to a named effect: score, refit, compare, accept or refuse.
//!
//! A candidate is added only when several judges agree: the score test's p-value over the whole library, the improvement
//! cluster by cluster, its size against the noise floor, its parameters' intervals and physical bounds. What is then left of
//! the residual decides between a known effect, two that can't be told apart, and none that is known.

mod called_for;
mod compare;
mod conclude;
mod form;
mod found;
mod holdout;
mod nameless;
mod needless;
mod refits;
mod review;
mod round;
mod search;
mod under_guide;
mod whole;

use model::effects::{Balance, Effect, LIBRARY};
use model::integrate::SimulationError;

use crate::false_minimum::with_plain_losses;
use crate::fit::Fit;
use crate::identification::Identified;
use crate::misfit::{self, MATERIAL, Part};
use crate::problem::Problem;
use crate::uncertainty::Known;
pub(crate) use nameless::BEYOND_NOISE;
use round::Round;
use search::Search;

/// What the diagnosis concludes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The declared model explains the data.
    None,
    /// The effects that were added explain it.
    Attributed,
    /// Leading candidates can't be told apart.
    Ambiguous,
    /// No known effect explains it.
    Unrecognised,
}

impl Verdict {
    /// Word in `findings.json`.
    pub fn as_str(self) -> &'static str {
        match self {
            Verdict::None => "none",
            Verdict::Attributed => "attributed",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Unrecognised => "unrecognised",
        }
    }
}

/// A candidate with how likely it is among those that were refitted.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// Id.
    pub id: String,
    /// Between 0 and 1.
    pub probability: f64,
}

/// An effect that was added.
#[derive(Clone, Debug)]
pub struct Added {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Among the candidates of its round.
    pub probability: f64,
    /// Ids that explain the data as well.
    pub equivalent: Vec<String>,
    /// Values in the order of the effect's header.
    pub values: Vec<f64>,
    /// How well each is known.
    pub known: Vec<Known>,
}

/// The result.
pub struct Diagnosis {
    /// Conclusion.
    pub verdict: Verdict,
    /// What was added (with verdict `Unrecognised`: the empirical term).
    pub effects: Vec<Added>,
    /// Candidates of the first round, the likeliest first.
    pub ranking: Vec<Ranked>,
    /// p-value by balance.
    pub balances: Vec<(Balance, f64)>,
    /// The model with what was added.
    pub after: Fit,
    /// Structured residual by run and channel before.
    pub parts_before: Vec<Part>,
    /// And after.
    pub parts_after: Vec<Part>,
    /// Share of the structured residual that what was added explains; 1 where nothing was to be explained.
    pub explained: f64,
    /// Run that would tell the leading candidates apart.
    pub next_experiment: Option<String>,
    /// By how many standard errors of the noise each candidate of the first round would show in its brief runs, at the usual size that shows most.
    pub shows: Vec<(&'static str, f64)>,
    /// The library's score test was asked of what the model leaves, and is not significant: as noise that creeps has it.
    pub silent: bool,
}

impl Diagnosis {
    /// The terms without a name are of no size: they predict what was left out of their fit worse than nothing does, and say only in which balance
    /// something is missing.
    pub fn says_only_where(&self) -> bool {
        let none = |a: &Added| a.effect.header().parameters.iter().zip(&a.values).all(|(p, v)| !p.size || *v == 0.0);
        self.verdict == Verdict::Unrecognised && !self.effects.is_empty() && self.effects.iter().all(none)
    }
}

/// Level of each of the two score tests: over the whole library, and over the nameless terms of all balances.
const LEVEL: f64 = 0.005;
/// Structured residual (noise floors) that is certainly more than the sensors' own.
const CLEAR: f64 = 0.7;
/// What is left counts as noise up to this many noise floors: it makes a free run's error a tenth larger than the noise.
pub(crate) const CONSISTENT: f64 = 0.45;
/// A name whose form leaves more than [`CONSISTENT`] explains at least this share of the structured residual it was added for.
const EXPLAINED: f64 = 0.85;
/// Standard errors (by clusters) by which one model must be better than another to be preferred.
const PREFERRED: f64 = 3.0;
/// A second effect is looked for from this structured residual on (noise floors): it must do [`MATERIAL`] at least.
const SECOND: f64 = 0.15;
/// A substantial part of the whole (a quarter of its amplitude). A second effect does at least that; what names leave below it is a
/// matter of their form.
const SUBSTANTIAL: f64 = 0.05;
/// Share of what an effect does that may sit in runs which ask for another size of it.
const DISAGREE: f64 = 0.3;
/// Most effects that are named together. With more the data are fitted by any names.
const MOST_EFFECTS: usize = 2;
/// Rounds in which they are looked for: a name that a later one makes needless leaves its place.
const MOST_ROUNDS: usize = 3;

/// Candidates are screened and first refitted on this much of each run with a free lever, s; the leaders then on all.
const BRIEF_S: f64 = 40.0;
/// Horizon over which a start from the component experiments is led, s.
const SHORT_S: f64 = 8.0;
/// Structured residual (noise floors) from which an effect counts as gross.
const GROSS: f64 = 1.5;

/// A gross misfit of which the best single name explains less than this share, on data left out and of the fit's cost, is not one of two
/// names: of two the better one explains about half, or more.
const LOST: f64 = 1.0 / 3.0;

/// Share of what was missing (a half of its amplitude) that a first name leaves where a second one may act beside it, however little that is.
const LEFT_BY_ONE: f64 = 0.25;

/// Most names that a misfit of this size (largest structured residual, noise floors) can bear: one that is hardly more than noise is fitted by many a
/// pair, whatever its cause. Unless a first name leaves a good part of it (`left`, a share; 0 where nothing is named yet).
fn most_names(largest: f64, left: f64) -> usize {
    if largest > CLEAR || left > LEFT_BY_ONE { MOST_EFFECTS } else { 1 }
}

/// Runs the whole chain with the whole library.
///
/// # Errors
/// The identified model can't be simulated on the runs that are fitted.
pub fn diagnose(identified: &Identified, progress: &dyn Fn(&str)) -> Result<Diagnosis, SimulationError> {
    diagnose_with(LIBRARY, identified, progress)
}

/// Runs the whole chain with the effects of `library` alone.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_with(
    library: &[&'static dyn Effect],
    identified: &Identified,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, SimulationError> {
    let component = identified.fit.layout.vector_of(&with_plain_losses(identified.component));
    let declared = Declared { problem: &identified.problem, fit: &identified.fit, component: &component };
    diagnose_declared(library, &declared, progress)
}

/// The declared model of any plant, fitted: what the chain starts from.
pub struct Declared<'a> {
    /// What was fitted.
    pub problem: &'a Problem,
    /// The fit, without effects.
    pub fit: &'a Fit,
    /// Base values that no effect has bent: a second start for gross effects.
    pub component: &'a [f64],
}

/// Runs the whole chain on a plant's declared model with the effects of `library`.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_declared(
    library: &[&'static dyn Effect],
    declared: &Declared,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, SimulationError> {
    let search = Search::new(library, declared, progress);
    let nested = search.nested(&search.reference)?;
    let first = Round::new(&search.brief, &nested, library.iter().copied())?;
    progress("candidates scored");
    let mut found = search.start()?;
    for number in 0..MOST_ROUNDS {
        let parts = found.parts(search.problem, found.last());
        let largest = misfit::largest(&parts);
        let leads = misfit::leading(&parts).map(|part| (part.protocol, part.channel, part.structured.sqrt()));
        tracing::info!(number, largest, ?leads, "structured residual, noise floors");
        // what is left of an effect whose form differs a little is not a second effect
        if found.last().names.len() >= search.most_names(&found)
            || largest < if number == 0 { MATERIAL } else { SECOND }
        {
            break;
        }
        let step = if number == 0 {
            // what all candidates together can't show, terms without a name may: then it is one of them, or none
            if !search.calls_for(&mut found, &first) && search.nameless(&mut found, &first, false)?.is_none() {
                break;
            }
            search.round(&mut found, &first)?
        } else {
            let nested = search.nested(&found.last().fit)?;
            let open = search.open(&nested);
            let round = Round::new(&search.brief, &nested, open.into_iter())?;
            if search.is_lost(&found, found.last()) && !search.leads_out(&round)? {
                break;
            }
            if !search.calls_for(&mut found, &round) || search.is_settled(&found, &round)? {
                break;
            }
            search.round(&mut found, &round)?
        };
        match step {
            Some(step) => found.take(step),
            None => break,
        }
    }
    search.conclude(found, &first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_hardly_more_than_noise_bears_one_name_unless_that_leaves_half_of_it() {
        assert_eq!((most_names(0.5, 0.0), most_names(5.0, 0.0)), (1, 2));
        assert_eq!((most_names(0.5, 0.1), most_names(0.5, 0.4)), (1, 2));
        assert_eq!(most_names(0.5, f64::NAN), 1, "nothing was there that data left out show");
    }
}
