//! What a verdict is worth, once the truth is opened.

use super::plan::Kind;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What a diagnosis said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// `none`, `attributed`, `ambiguous` or `unrecognised`.
    pub verdict: String,
    /// What was added.
    pub effects: Vec<Named>,
}

/// An effect that a diagnosis added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Named {
    /// Id; of an unrecognised effect that of the empirical term.
    pub id: String,
    /// Its balance.
    pub balance: String,
    /// Among the candidates of its round.
    pub probability: f64,
    /// Ids that explain the data as well.
    pub equivalent: Vec<String>,
}

/// An effect that acted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Acting {
    /// The id by which it must be found.
    pub id: String,
    /// Its balance.
    pub balance: String,
    /// Id of the equation that acted; another one than `id` where it is another form.
    pub form: String,
    /// Values by name.
    pub parameters: std::collections::BTreeMap<String, f64>,
    /// Noise floors, with the other effects of the case in the model.
    pub strength: f64,
    /// Cost a target (1 = noise alone) of the fit that shows it: the model with the other effects, from the true values on.
    #[serde(default)]
    pub cost: Option<f64>,
    /// Largest structured residual that this fit leaves in the runs that may be fitted, noise floors: what there is of the effect to find.
    #[serde(default)]
    pub left: Option<f64>,
}

/// What the verdict turned out to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// The sealed effects and no others, each by its name or in the class of a name; `none` where there was none; `unrecognised` in the
    /// right balance where the library lacks it.
    Right,
    /// Ambiguous, and the leading class holds a sealed effect.
    AmbiguousWith,
    /// Ambiguous between effects that are not there.
    AmbiguousWithout,
    /// Only one of two was named, and nothing else.
    Partly,
    /// Something acts and nothing was found.
    Missed,
    /// Unrecognised, though the library has it.
    NotRecognised,
    /// Unrecognised in another balance.
    WrongBalance,
    /// A name that is not sealed, which explains the data as well as the truth does: no data of this campaign could tell.
    LookAlike,
    /// A name that is not sealed, alone or beside the right one.
    WrongName,
    /// Nothing acts and something was found.
    FalseAlarm,
    /// The diagnosis ended with an error.
    Failed,
}

impl Outcome {
    /// For a line of text.
    pub fn as_str(self) -> &'static str {
        match self {
            Outcome::Right => "right",
            Outcome::AmbiguousWith => "ambiguous, holds it",
            Outcome::AmbiguousWithout => "ambiguous without it",
            Outcome::Partly => "one of two",
            Outcome::Missed => "missed",
            Outcome::NotRecognised => "unrecognised",
            Outcome::WrongBalance => "wrong balance",
            Outcome::LookAlike => "look-alike",
            Outcome::WrongName => "WRONG NAME",
            Outcome::FalseAlarm => "FALSE ALARM",
            Outcome::Failed => "FAILED",
        }
    }
}

/// Judges. `as_good`: the validation error is within 1.1 times that of the truth's own form.
pub fn judge(kind: Kind, acting: &[Acting], said: &Said, as_good: bool) -> Outcome {
    let found = said.verdict != "none";
    if kind == Kind::None {
        return if found { Outcome::FalseAlarm } else { Outcome::Right };
    }
    if !found {
        return Outcome::Missed;
    }
    let sealed: BTreeSet<&str> = acting.iter().map(|a| a.id.as_str()).collect();
    let class: BTreeSet<&str> = said.effects.iter().flat_map(Named::class).collect();
    match said.verdict.as_str() {
        "unrecognised" if kind == Kind::Outside => {
            let right = said.effects.iter().all(|e| acting.iter().any(|a| a.balance == e.balance));
            if right { Outcome::Right } else { Outcome::WrongBalance }
        }
        "unrecognised" => Outcome::NotRecognised,
        "ambiguous" if sealed.iter().any(|id| class.contains(id)) => Outcome::AmbiguousWith,
        "ambiguous" => Outcome::AmbiguousWithout,
        _ => {
            let matched = said.effects.iter().filter(|e| e.class().any(|id| sealed.contains(id))).count();
            let covered = sealed.iter().filter(|id| class.contains(*id)).count();
            if matched == said.effects.len() && covered == sealed.len() && matched == sealed.len() {
                Outcome::Right
            } else if matched == said.effects.len() && covered > 0 {
                Outcome::Partly
            } else if as_good {
                Outcome::LookAlike
            } else {
                Outcome::WrongName
            }
        }
    }
}

impl Named {
    fn class(&self) -> impl Iterator<Item = &str> {
        self.equivalent.iter().flat_map(|e| e.split('+')).chain([self.id.as_str()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn acting(ids: &[&str]) -> Vec<Acting> {
        let one = |id: &&str| Acting {
            id: id.to_string(),
            balance: "torque".into(),
            form: id.to_string(),
            parameters: Default::default(),
            strength: 5.0,
            cost: None,
            left: None,
        };
        ids.iter().map(one).collect()
    }

    fn said(verdict: &str, ids: &[&str], equivalent: &[&str]) -> Said {
        let named = |id: &&str| Named {
            id: id.to_string(),
            balance: "torque".into(),
            probability: 1.0,
            equivalent: equivalent.iter().map(|e| e.to_string()).collect(),
        };
        Said { verdict: verdict.into(), effects: ids.iter().map(named).collect() }
    }

    #[test]
    fn names_count_and_no_name_may_be_too_many() {
        let one = |s: &Said| judge(Kind::Clear, &acting(&["tilt"]), s, false);
        assert_eq!(one(&said("attributed", &["tilt"], &[])), Outcome::Right);
        assert_eq!(one(&said("attributed", &["angle_offset"], &["tilt"])), Outcome::Right);
        assert_eq!(one(&said("attributed", &["tilt", "backlash"], &[])), Outcome::WrongName);
        assert_eq!(one(&said("attributed", &["backlash"], &[])), Outcome::WrongName);
        assert_eq!(
            judge(Kind::Clear, &acting(&["tilt"]), &said("attributed", &["backlash"], &[]), true),
            Outcome::LookAlike
        );
        assert_eq!(one(&said("ambiguous", &["backlash"], &["pump_lag+tilt"])), Outcome::AmbiguousWith);
        assert_eq!(one(&said("ambiguous", &["backlash"], &["pump_lag"])), Outcome::AmbiguousWithout);
        assert_eq!(one(&said("unrecognised", &["empirical_torque"], &[])), Outcome::NotRecognised);
        assert_eq!(one(&said("none", &[], &[])), Outcome::Missed);
    }

    #[test]
    fn pairs_need_both_and_nothing_is_nothing() {
        let two = |s: &Said| judge(Kind::Pair, &acting(&["tilt", "backlash"]), s, false);
        assert_eq!(two(&said("attributed", &["backlash", "tilt"], &[])), Outcome::Right);
        assert_eq!(two(&said("attributed", &["backlash"], &[])), Outcome::Partly);
        assert_eq!(two(&said("attributed", &["backlash", "pump_lag"], &[])), Outcome::WrongName);
        assert_eq!(judge(Kind::None, &[], &said("none", &[], &[]), true), Outcome::Right);
        assert_eq!(judge(Kind::None, &[], &said("ambiguous", &["tilt"], &[]), true), Outcome::FalseAlarm);
    }

    #[test]
    fn what_the_library_lacks_must_be_traced_to_its_balance() {
        let outside = |s: &Said| judge(Kind::Outside, &acting(&["tilt"]), s, false);
        assert_eq!(outside(&said("unrecognised", &["empirical_torque"], &[])), Outcome::Right);
        let mut other = said("unrecognised", &["empirical_pump"], &[]);
        other.effects[0].balance = "pump".into();
        assert_eq!(outside(&other), Outcome::WrongBalance);
        assert_eq!(outside(&said("attributed", &["backlash"], &[])), Outcome::WrongName);
    }
}
