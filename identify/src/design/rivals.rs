//! The explanations that a diagnosis leaves open.

use model::effects::{self, Effect};
use model::integrate::SimulationError;

use crate::diagnose::{Diagnosis, Verdict};
use crate::fit::{Effort, Fit, fit};
use crate::identification::Identified;
use crate::refit::{Bases, refit};
use crate::score::{Direction, Scene};

/// A hypothesis, fitted to the campaign.
#[derive(Clone, Debug)]
pub struct Rival {
    /// Effects beyond the declared model; empty: the declared model itself.
    pub ids: Vec<&'static str>,
    /// Relative to the others.
    pub probability: f64,
    /// Where it fits.
    pub fit: Fit,
}

impl Rival {
    /// `tilt + angle_offset`, or `no effect`.
    pub fn name(&self) -> String {
        if self.ids.is_empty() { "no effect".into() } else { self.ids.join(" + ") }
    }
}

/// What a further run would have to settle.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    /// Which of these sets of effects it is, the likeliest first, with probabilities.
    Which(Vec<(Vec<&'static str>, f64)>),
    /// Whether this set of effects is there at all.
    Whether(Vec<&'static str>),
}

/// Rivals that are compared at most.
const MOST: usize = 4;
/// A candidate below this probability is no rival.
const POSSIBLE: f64 = 0.02;
/// An attribution below this probability is weak.
const SURE: f64 = 0.95;
/// A balance below this p-value leaves doubt where nothing was found: 5 % over all four.
const DOUBT: f64 = 0.0125;

/// What a diagnosis leaves open; `None` where its verdict stands.
pub fn question(d: &Diagnosis) -> Option<Question> {
    let mut ranked: Vec<(Vec<&'static str>, f64)> =
        d.ranking.iter().filter_map(|r| Some((known(&r.id)?, r.probability))).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
    match d.verdict {
        Verdict::Ambiguous | Verdict::Attributed => {
            let mut found: Vec<&'static str> = d.effects.iter().filter_map(|a| library(a.effect.header().id)).collect();
            found.sort_unstable();
            let mut sets: Vec<(Vec<&'static str>, f64)> = Vec::new();
            let likely = d.effects.iter().map(|a| a.probability).fold(1.0, f64::min);
            if !found.is_empty() {
                sets.push((found.clone(), likely.max(0.01)));
            }
            for added in &d.effects {
                let own = added.effect.header().id;
                for class in added.equivalent.iter().filter_map(|id| known(id)) {
                    let p = ranked.iter().find(|r| r.0 == class).map_or(likely, |r| r.1);
                    // beside what else was found
                    let mut set: Vec<&'static str> =
                        found.iter().copied().filter(|id| *id != own).chain(class).collect();
                    set.sort_unstable();
                    set.dedup();
                    push_new(&mut sets, set, p.max(0.01));
                }
            }
            // of several effects the ranking is one's, beside the others
            let weak = match d.effects.len() {
                0 => d.verdict == Verdict::Ambiguous,
                1 => d.verdict == Verdict::Ambiguous || likely < SURE,
                _ => false,
            };
            if weak {
                for (set, p) in ranked.into_iter().filter(|r| r.1 >= POSSIBLE) {
                    push_new(&mut sets, set, p);
                }
            }
            sets.truncate(MOST);
            (sets.len() > 1).then_some(Question::Which(sets))
        }
        Verdict::None => {
            let doubt = d.balances.iter().any(|(_, p)| *p < DOUBT);
            let (first, _) = ranked.into_iter().next()?;
            doubt.then_some(Question::Whether(first))
        }
        Verdict::Unrecognised => None,
    }
}

fn push_new(sets: &mut Vec<(Vec<&'static str>, f64)>, set: Vec<&'static str>, p: f64) {
    if !sets.iter().any(|s| s.0 == set) {
        sets.push((set, p));
    }
}

fn library(id: &str) -> Option<&'static str> {
    effects::find(id).map(|e| e.header().id)
}

/// `a+b` as ids of the library, in their order; `None` where it does not have one of them.
fn known(set: &str) -> Option<Vec<&'static str>> {
    let mut ids: Vec<&'static str> = set.split('+').map(library).collect::<Option<_>>()?;
    ids.sort_unstable();
    Some(ids)
}

/// Each rival at its minimum on the campaign. One that can't be fitted is left out.
///
/// # Errors
/// The identified model can't be simulated on the campaign.
pub fn rivals(
    identified: &Identified,
    diagnosis: &Diagnosis,
    question: &Question,
    progress: &dyn Fn(&str),
) -> Result<Vec<Rival>, SimulationError> {
    let sets = match question {
        Question::Which(sets) => sets.clone(),
        Question::Whether(set) => vec![(Vec::new(), 0.5), (set.clone(), 0.5)],
    };
    let problem = &identified.problem;
    let brief = &problem.shortened(BRIEF_S);
    let short = &problem.shortened(SHORT_S);
    let component = identified.fit.layout.vector_of(&identified.component);
    let scene = Scene::new(brief, &identified.fit)?;
    let declared = identified.fit.layout.effects.len();
    let mut fitted: Vec<&'static str> =
        diagnosis.after.layout.effects.iter().skip(declared).map(|e| e.header().id).collect();
    fitted.sort_unstable();
    let mut out = Vec::new();
    for (ids, probability) in sets {
        let at = if ids.is_empty() {
            Some(identified.fit.clone())
        } else if ids == fitted {
            Some(diagnosis.after.clone())
        } else {
            let added: Vec<(&'static dyn Effect, Vec<Direction>)> =
                ids.iter().filter_map(|id| effects::find(id)).map(|e| (e, leading(&scene, e))).collect();
            let added: Vec<(&'static dyn Effect, Vec<&Direction>)> =
                added.iter().map(|(e, d)| (*e, d.iter().collect())).collect();
            let bases =
                Bases { scene: &scene, component: &component, short, guided: None, beside: f64::INFINITY, gross: true };
            let effort = Effort { iterations: 8, tolerance: 1e-4, ..Effort::default() };
            let whole = Effort { iterations: 6, tolerance: 1e-5, ..Effort::default() };
            refit(brief, &bases, &added, effort).and_then(|r| {
                let layout = r.fit.layout.clone();
                fit(problem, &layout, r.fit.point, whole).ok()
            })
        };
        if let Some(fit) = at {
            let rival = Rival { ids, probability, fit };
            progress(&format!("rival {}: cost {:.0}", rival.name(), rival.fit.cost));
            out.push(rival);
        }
    }
    Ok(out)
}

/// As in the diagnosis: refits run on this much of each run with a free lever, and are led over the shorter time, s.
const BRIEF_S: f64 = 40.0;
const SHORT_S: f64 = 8.0;

/// The directions of an effect, the one that explains most first.
fn leading(scene: &Scene, effect: &'static dyn Effect) -> Vec<Direction> {
    let mut all = scene.directions(effect);
    all.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    all
}
