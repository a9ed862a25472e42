//! What a gross misfit leaves open, seen where the simulation follows what was measured ([`crate::guide`]).
//!
//! There the misfit says what is missing nearly as a small one does: what the right effect explains linearly is most of it, where a free run, which is
//! elsewhere, says little. So few candidates have to be led and refitted, and none where none of them is what is missing.

use model::effects::Effect;
use model::integrate::SimulationError;

use super::round::Round;
use crate::guided::{Guided, LEADS};

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

/// Shares of the cost under the guide that candidates take away.
pub(super) struct UnderGuide {
    shares: Vec<(&'static dyn Effect, f64)>,
    /// What is missing shows there: the shares say who is out of question. Where it does not, they only say who leads.
    pub shows: bool,
    /// By a few steps from their starts instead of linearly.
    pub led: bool,
}

impl UnderGuide {
    /// Of these candidates.
    pub fn of(guided: &Guided, candidates: &[&'static dyn Effect]) -> Result<Option<Self>, SimulationError> {
        let Some((problem, fit)) = guided.tightest() else { return Ok(None) };
        let round = Round::new(problem, fit, candidates.iter().copied())?;
        let share = |e: &'static dyn Effect| round.gram.gain(&round.of(e.header().id)) / fit.cost;
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

    fn share(&self, effect: &'static dyn Effect) -> f64 {
        let own = |(e, _): &&(&'static dyn Effect, f64)| e.header().id == effect.header().id;
        self.shares.iter().find(own).map_or(0.0, |(_, share)| *share)
    }

    /// A candidate takes away some of what is missing.
    pub fn leads(&self) -> bool {
        self.best() >= LEADS
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
    /// follow it as far.
    pub fn joined(&self, mut shortlist: Vec<Vec<&'static dyn Effect>>) -> Vec<Vec<&'static dyn Effect>> {
        for (effect, _) in self.shares.iter().take(FIRST) {
            add_single(&mut shortlist, *effect);
        }
        shortlist
    }

    /// The first sets of a shortlist and those that are still open, and the best candidates besides. Where none takes away most, two may be missing,
    /// and the shortlist stays whole; where none leads, here or in free run, none of them is what is missing. `in_free_run`: the largest share of the
    /// cost that a candidate takes away there, linearly. Who takes away most here comes first, for what it leaves says how far others must be led.
    pub fn narrow(&self, shortlist: Vec<Vec<&'static dyn Effect>>, in_free_run: f64) -> Vec<Vec<&'static dyn Effect>> {
        if !self.leads() && in_free_run < MOST {
            return Vec::new();
        }
        if !self.takes_most() {
            return shortlist;
        }
        let open = |e: &&'static dyn Effect| self.share(*e) >= BESIDE * self.best();
        let stays = |(place, set): &(usize, Vec<_>)| *place < FIRST || set.iter().all(open);
        let mut out: Vec<_> = shortlist.into_iter().enumerate().filter(stays).map(|(_, set)| set).collect();
        for (effect, _) in self.shares.iter().take(BEST).filter(|(e, _)| open(e)) {
            add_single(&mut out, *effect);
        }
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
    }

    #[test]
    fn where_none_takes_away_most_all_stay_and_where_none_leads_none() {
        let two = under(&[("pump_lag", 0.4), ("end_stop", 0.35)]);
        let shortlist = vec![effects(&["tilt"]), effects(&["end_stop", "pump_lag"])];
        assert_eq!(ids(&two.narrow(shortlist.clone(), 0.0)), ["tilt", "end_stop+pump_lag"]);
        assert!(!two.rules_out(effects(&["tilt"])[0]) && two.leads());
        for none in [under(&[("pump_lag", 0.05)]), under(&[])] {
            assert!(!none.leads() && none.narrow(shortlist.clone(), 0.3).is_empty());
            assert_eq!(ids(&none.narrow(shortlist.clone(), 0.6)), ["tilt", "end_stop+pump_lag"], "a slow one");
        }
    }
}
