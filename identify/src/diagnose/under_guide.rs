//! What a gross misfit leaves open, seen where the simulation follows what was measured ([`crate::guide`]).
//!
//! There the misfit says what is missing nearly as a small one does: what the right effect explains linearly is most of it, where a free run, which is
//! elsewhere, says little. So few candidates have to be led and refitted, and none where none of them is what is missing.

use model::effects::Effect;
use model::effects::empirical::EMPIRICAL;
use model::integrate::SimulationError;

use super::found::Found;
use super::round::Round;
use super::search::{Search, is_gross};
use super::{GROSS, LOST};
use crate::guided::{Guided, LEADS};
use crate::misfit;
use crate::refit::Bases;

/// A candidate is out of question that takes away less than this share of what the best one does.
const BESIDE: f64 = 0.3;
/// One that takes away so much leaves no room for one that takes away next to nothing. In a free run it is open whatever the guide says: what is slow, a tilt
/// or a drift, a guide follows.
const MOST: f64 = 0.5;
/// Of terms without a name that were led one set is far behind that takes away less than this share of what the best one does.
const FAR_LESS: f64 = 0.5;
/// The best ones are refitted whatever a free run says of them,
const BEST: usize = 3;
/// and so many that lead in free run whatever the guide says of them.
const FIRST: usize = 2;

impl Search<'_> {
    /// What terms without a name explain under a guide, where the reference model leaves a gross misfit, in a round's brief runs or on data left out.
    pub fn nameless_under_guide(&self, found: &Found, round: &Round) -> Result<Option<UnderGuide>, SimulationError> {
        let left_out = misfit::largest(&self.left(found, &found.steps[0]));
        if left_out <= GROSS && !is_gross(&self.brief, round.scene.fit, &found.colours)? {
            return Ok(None);
        }
        let Some(guided) = round.guided(self) else { return Ok(None) };
        let linearly = UnderGuide::of(guided, &EMPIRICAL)?;
        // friction of another kind than the model's acts as no little of it would
        let to_be_led = linearly.as_ref().is_some_and(|under| under.shows && !under.takes_most());
        Ok(if to_be_led { Some(UnderGuide::led(guided, &EMPIRICAL.map(|e| vec![e]))) } else { linearly })
    }

    /// Sets of candidates that are worth a refit; none where a guide shows that none of them is what is missing.
    pub fn shortlist(
        &self,
        round: &Round,
        open: &[&'static dyn Effect],
        bases: &Bases,
    ) -> Result<Vec<Vec<&'static dyn Effect>>, SimulationError> {
        let shortlist = round.shortlist(open, if bases.gross { 6 } else { 5 });
        let Some(guided) = bases.guided else { return Ok(shortlist) };
        let Some(mut under) = round.under_guide(self)? else { return Ok(shortlist) };
        let in_free_run = open.iter().map(|e| round.gain_of(&[*e]) / bases.scene.fit.cost);
        let in_free_run = in_free_run.fold(0.0, f64::max);
        if !under.shows {
            let shortlist = under.joined(shortlist);
            // friction of another kind than the model's leaves little under a guide once the model's has bent to it, and a free run that is elsewhere
            let hidden = bases.gross && guided.lacks() && !under.leads() && in_free_run < LEADS;
            if !hidden {
                return Ok(shortlist);
            }
            let led = UnderGuide::led(guided, &shortlist);
            return Ok(if led.is_clear() { led.narrow(shortlist, in_free_run) } else { shortlist });
        }
        if !under.leads() {
            // friction of another kind than the model's acts as no little of it would
            under = UnderGuide::led(guided, &shortlist);
        }
        let narrowed = under.narrow(shortlist, in_free_run);
        if narrowed.is_empty() {
            (self.progress)("no candidate leads where the simulation follows what was measured");
        }
        Ok(narrowed)
    }

    /// Beside a name that does not lead out of a gross misfit a candidate takes away most of what is missing under the guide.
    pub fn leads_out(&self, round: &Round) -> Result<bool, SimulationError> {
        let Some(guided) = round.guided(self).filter(|guided| guided.lacks()) else { return Ok(false) };
        let Some(linearly) = round.under_guide(self)? else { return Ok(false) };
        if linearly.takes_most() {
            return Ok(true);
        }
        // the likeliest first: one is enough
        let mut singles = linearly.joined(round.shortlist(&self.open(round.scene.fit), 6));
        singles.retain(|set| set.len() == 1);
        singles.sort_by(|a, b| linearly.share(b[0]).total_cmp(&linearly.share(a[0])));
        Ok(singles.into_iter().flatten().any(|effect| guided.takes_away(effect) >= MOST))
    }
}

/// Shares of the cost under the guide that candidates take away.
#[derive(Clone)]
pub(super) struct UnderGuide {
    shares: Vec<(&'static dyn Effect, f64)>,
    /// What is missing shows there: the shares say who is out of question. Where it does not, they only say who leads.
    pub shows: bool,
    /// By a few steps from their starts instead of linearly.
    led: bool,
}

impl UnderGuide {
    /// Of these candidates.
    pub fn of(guided: &Guided, candidates: &[&'static dyn Effect]) -> Result<Option<Self>, SimulationError> {
        let Some((problem, fit)) = guided.tightest() else { return Ok(None) };
        let round = Round::new(problem, fit, candidates.iter().copied())?;
        let share = |e: &'static dyn Effect| round.gain_of(&[e]) / fit.cost;
        let shares = candidates.iter().map(|e| (*e, share(*e))).collect();
        Ok(Some(UnderGuide::sorted(shares, guided.shows(), false)))
    }

    /// The same of those in a shortlist, by a few steps from their starts instead.
    pub fn led(guided: &Guided, shortlist: &[Vec<&'static dyn Effect>]) -> Self {
        let singles = shortlist.iter().filter(|set| set.len() == 1).flatten();
        UnderGuide::sorted(singles.map(|e| (*e, guided.takes_away(*e))).collect(), true, true)
    }

    fn sorted(mut shares: Vec<(&'static dyn Effect, f64)>, shows: bool, led: bool) -> Self {
        shares.sort_by(|a, b| b.1.total_cmp(&a.1));
        let best: Vec<_> = shares.iter().take(4).map(|(e, s)| (e.header().id, s)).collect();
        tracing::info!(?best, shows, "taken away under the guide");
        UnderGuide { shares, shows, led }
    }

    fn best(&self) -> f64 {
        self.shares.first().map_or(0.0, |(_, share)| *share)
    }

    /// What this candidate takes away; 0 where it was none.
    pub fn share(&self, effect: &'static dyn Effect) -> f64 {
        let own = |(e, _): &&(&'static dyn Effect, f64)| e.header().id == effect.header().id;
        self.shares.iter().find(own).map_or(0.0, |(_, share)| *share)
    }

    /// A candidate takes away some of what is missing.
    pub fn leads(&self) -> bool {
        self.best() >= LEADS
    }

    /// What is missing shows, and no candidate takes away a good part of it: of two effects the better one does about half.
    pub fn leads_nobody(&self) -> bool {
        self.shows && self.best() < LOST
    }

    /// It is clear who is out of question: all but the likes of one that takes away most, or all where nobody leads.
    fn is_clear(&self) -> bool {
        self.takes_most() || !self.leads()
    }

    /// A candidate takes away most of what is missing.
    pub fn takes_most(&self) -> bool {
        self.best() >= MOST
    }

    /// Another candidate takes away most of the cost, and this one next to nothing; or, where both were led and thus had their chance, far less.
    pub fn rules_out(&self, effect: &'static dyn Effect) -> bool {
        let least = if self.led { FAR_LESS * self.best() } else { LEADS };
        self.shows && self.takes_most() && self.share(effect) < least
    }

    /// A shortlist with those that lead under the guide beside it: what a free run's base parameters have taken up is small there too, but they can't
    /// follow it as far. Where what is missing shows, those alone that take away some of it.
    pub fn joined(&self, mut shortlist: Vec<Vec<&'static dyn Effect>>) -> Vec<Vec<&'static dyn Effect>> {
        for (effect, _) in self.shares.iter().take(FIRST).filter(|(_, share)| !self.shows || *share >= LEADS) {
            add_single(&mut shortlist, *effect);
        }
        shortlist
    }

    /// The first sets of a shortlist and those that are still open, and the best candidates besides. Where none takes away most, two may be missing, or one
    /// shows less linearly than it does: the shortlist stays whole, and those that lead join it. Where none leads, here or in free run, none of them is what is
    /// missing. `in_free_run`: the largest share of the cost that a candidate takes away there, linearly. Who takes away most here comes first, for what it
    /// leaves says how far others must be led.
    pub fn narrow(&self, shortlist: Vec<Vec<&'static dyn Effect>>, in_free_run: f64) -> Vec<Vec<&'static dyn Effect>> {
        if !self.leads() && in_free_run < MOST {
            return Vec::new();
        }
        let open = |e: &&'static dyn Effect| self.share(*e) >= BESIDE * self.best();
        let stays = |(place, set): &(usize, Vec<_>)| *place < FIRST || set.iter().all(open);
        let mut out = if self.takes_most() {
            let mut out: Vec<_> = shortlist.into_iter().enumerate().filter(stays).map(|(_, set)| set).collect();
            for (effect, _) in self.shares.iter().take(BEST).filter(|(e, _)| open(e)) {
                add_single(&mut out, *effect);
            }
            out
        } else {
            self.joined(shortlist)
        };
        let leaves = |set: &Vec<&'static dyn Effect>| match set[..] {
            [effect] => 1.0 - self.share(effect),
            _ => 1.0,
        };
        out.sort_by(|a, b| leaves(a).total_cmp(&leaves(b)));
        out
    }
}

/// Adds a set of one effect where there is none of it.
fn add_single(sets: &mut Vec<Vec<&'static dyn Effect>>, effect: &'static dyn Effect) {
    if !sets.iter().any(|set| set.len() == 1 && set[0].header().id == effect.header().id) {
        sets.push(vec![effect]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{dynamic, layout, problem};
    use crate::diagnose::Declared;
    use crate::fit::{Effort, Fit, fit};
    use crate::problem::Problem;
    use model::Parameters;
    use model::effects::find;

    fn effects(ids: &[&str]) -> Vec<&'static dyn Effect> {
        ids.iter().map(|id| find(id).expect("an id of the library")).collect()
    }

    fn under(shares: &[(&str, f64)]) -> UnderGuide {
        let shares = shares.iter().map(|(id, share)| (effects(&[id])[0], *share)).collect();
        UnderGuide { shares, shows: true, led: false }
    }

    fn ids(sets: &[Vec<&'static dyn Effect>]) -> Vec<String> {
        sets.iter().map(|s| s.iter().map(|e| e.header().id).collect::<Vec<_>>().join("+")).collect()
    }

    #[test]
    fn one_that_takes_away_most_leaves_only_its_like() {
        let u = under(&[("trapped_air", 0.96), ("chamber_asymmetry", 0.9), ("backlash", 0.2), ("pump_lag", 0.01)]);
        let shortlist = vec![
            effects(&["pump_lag"]),
            effects(&["chamber_asymmetry"]),
            effects(&["backlash"]),
            effects(&["trapped_air", "pump_lag"]),
            effects(&["end_stop"]),
        ];
        assert_eq!(ids(&u.narrow(shortlist, 0.0)), ["trapped_air", "chamber_asymmetry", "pump_lag"]);
        assert!(u.leads());
        assert!(u.rules_out(effects(&["pump_lag"])[0]) && !u.rules_out(effects(&["backlash"])[0]));
        assert!(u.rules_out(effects(&["tilt"])[0]), "one that was no candidate");
        let led = UnderGuide { led: true, ..u };
        assert!(led.rules_out(effects(&["backlash"])[0]), "it was led, and is far behind");
        assert!(!led.rules_out(effects(&["chamber_asymmetry"])[0]));
    }

    #[test]
    fn where_little_shows_those_that_lead_join_and_none_is_out() {
        let u = UnderGuide { shows: false, ..under(&[("stribeck_friction", 0.6), ("tilt", 0.02), ("pump_lag", 0.01)]) };
        let shortlist = vec![effects(&["tilt"]), effects(&["end_stop", "pump_lag"])];
        assert_eq!(ids(&u.joined(shortlist)), ["tilt", "end_stop+pump_lag", "stribeck_friction"]);
        assert!(!u.rules_out(effects(&["pump_lag"])[0]));
        assert!(!u.leads_nobody() && !under(&[("tilt", 0.4)]).leads_nobody() && under(&[("tilt", 0.3)]).leads_nobody());
        let led = |share: f64| UnderGuide { led: true, ..under(&[("stribeck_friction", share), ("tilt", 0.01)]) };
        assert!(led(0.6).is_clear() && !led(0.3).is_clear() && led(0.05).is_clear(), "one, perhaps, nobody");
        assert!(led(0.05).narrow(vec![effects(&["tilt"])], 0.05).is_empty(), "so nobody is refitted");
        let hidden = UnderGuide { shows: false, ..under(&[("tilt", 0.02)]) };
        assert!(!hidden.leads_nobody(), "it would not show");
    }

    #[test]
    fn where_none_takes_away_most_all_stay_beside_who_leads_and_where_none_leads_none() {
        let two = under(&[("pump_lag", 0.4), ("end_stop", 0.05)]);
        let shortlist = vec![effects(&["tilt"]), effects(&["end_stop", "pump_lag"])];
        let narrowed = ids(&two.narrow(shortlist.clone(), 0.0));
        assert_eq!(narrowed, ["pump_lag", "tilt", "end_stop+pump_lag"], "the one that leads first, free run or not");
        assert!(!two.rules_out(effects(&["tilt"])[0]) && two.leads());
        for none in [under(&[("pump_lag", 0.05)]), under(&[])] {
            assert!(!none.leads() && none.narrow(shortlist.clone(), 0.3).is_empty());
            assert_eq!(ids(&none.narrow(shortlist.clone(), 0.6)), ["tilt", "end_stop+pump_lag"], "a slow one");
        }
    }

    /// A rig with this effect, and its model fitted without: base values that are bent by it, and those that are not.
    fn bent_by(id: &str, values: &[f64]) -> (Problem, Vec<f64>, Fit) {
        let truth = Parameters::example();
        let effect = find(id).expect("an id of the library");
        let problem = problem(&[7, 8].map(|seed| dynamic(&truth, Some((effect, values.to_vec())), 16.0, seed)));
        let layout = layout(&truth);
        let component = layout.vector_of(&truth);
        let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default())
            .expect("a model that can be simulated");
        (problem, component, bent)
    }

    #[test]
    fn a_second_name_is_led_out_by_what_shows_under_the_guide_without_being_gross_there() {
        for (tau_s, out) in [(0.012, true), (0.0, false)] {
            let (problem, component, bent) = bent_by("pump_lag", &[tau_s]);
            let library = effects(&["backlash", "pump_lag", "end_stop"]);
            let search =
                Search::new(&library, &Declared { problem: &problem, fit: &bent, component: &component }, &|_| ());
            let nested = search.nested(&bent).expect("it can be simulated");
            let round = Round::new(&search.brief, &nested, library.iter().copied()).expect("it can be simulated");
            let guided = round.guided(&search).expect("a rig that can be guided");
            let (tight, fit) = guided.tightest().expect("a guide");
            assert!(!guided.shows() && guided.lacks() == out, "{}", fit.cost / tight.targets() as f64);
            assert_eq!(search.leads_out(&round).expect("it can be simulated"), out);
            let on = |of_whole, largest| search.leads_on(&round, of_whole, largest).expect("it can be simulated");
            assert_eq!(on(0.04, 3.0), out);
            assert!(!on(0.04, 1.0) && !on(0.004, 3.0), "what is not gross, and what a form leaves");
        }
    }
}
