//! What is known of a case once it is judged.

use super::judge::{Acting, Outcome, Said};
use super::plan::Kind;
use super::rig::Rig;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeSet;

/// Everything that is known of a case afterwards.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Case {
    /// Number, from 0; with the seed it gives the case again.
    pub case: usize,
    /// Commit that last changed what the result comes from; `None` where that is not known.
    #[serde(default)]
    pub diagnosis: Option<String>,
    /// What was drawn.
    pub kind: Kind,
    /// Rigs that could not run the experiments before this one.
    pub attempt: u64,
    /// The rig.
    pub rig: Rig,
    /// Rig time of the campaign, s.
    pub rig_seconds: f64,
    /// The sealed effects.
    pub acting: Vec<Acting>,
    /// Largest validation error that all of them together cause after a refit of the base model, noise floors; `NaN` (`null` in the file)
    /// where the case failed before.
    #[serde(deserialize_with = "or_nan")]
    pub strength: f64,
    /// What the diagnosis said; `None` where it ended with an error.
    pub said: Option<Said>,
    /// Why it ended.
    pub error: Option<String>,
    /// What that is worth.
    pub outcome: Outcome,
    /// Figures of the diagnosis.
    pub figures: Figures,
    /// Where the time went, s.
    pub seconds: Seconds,
}

/// Figures of one diagnosis. Errors are those of free runs of the validation, in noise floors, of the channel where they are largest;
/// `NaN` (`null` in the file) where there is none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Figures {
    /// Error against what was recorded: identified reference model.
    pub before: Option<f64>,
    /// With what was added.
    pub after: Option<f64>,
    /// With the true effects in the model, fitted from the true values on.
    pub truth: Option<f64>,
    /// Largest ratio, of all channels, of `after` to `truth`.
    pub against_truth: Option<f64>,
    /// Cost a target (1 = noise alone) of the identified reference model.
    pub cost_identified: Option<f64>,
    /// The same fitted from the true values on: what the identification should have found.
    pub cost_base: Option<f64>,
    /// Cost a target with what was added.
    pub cost_after: Option<f64>,
    /// Cost a target with the true effects, fitted from the true values on.
    pub cost_truth: Option<f64>,
    /// Largest structured residual before, noise floors.
    pub residual_before: Option<f64>,
    /// And after.
    pub residual_after: Option<f64>,
    /// Where the largest of it is left: file, column, noise floors (RMS), standard errors.
    pub left: Vec<(String, String, f64, f64)>,
    /// Candidates of the first round with their probabilities.
    pub ranking: Vec<(String, f64)>,
    /// p-value by balance.
    pub balances: Vec<(String, f64)>,
    /// Values of what was added: `id.name`, value, standard error.
    pub values: Vec<(String, f64, Option<f64>)>,
    /// Their 95 % intervals, those of them that are known: `id.name`, from, to. Files of before 2026-11-29 have none.
    #[serde(default)]
    pub intervals: Vec<(String, f64, f64)>,
    /// What the diagnosis said on its way.
    pub way: Vec<String>,
}

/// Where the time of a case went, s.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Seconds {
    /// Draws, sizes and the recording.
    pub record: f64,
    /// Fits from the true values on.
    pub measure: f64,
    /// Identification of the reference model.
    pub identify: f64,
    /// Diagnosis.
    pub diagnose: f64,
}

impl Figures {
    /// Whether the validation error is within 1.1 times that of the truth's own form, on every channel.
    pub fn as_good(&self) -> bool {
        self.against_truth.is_some_and(|ratio| ratio <= 1.1)
    }
}

/// A model without an effect.
struct Without {
    /// Cost a target.
    cost: Option<f64>,
    /// Largest validation error, noise floors.
    error: Option<f64>,
    /// Largest structured residual in the runs that may be fitted, noise floors.
    left: Option<f64>,
}

impl Case {
    /// Whether an effect of the library is sealed, and exactly what is sealed was named.
    pub fn named_right(&self) -> bool {
        self.outcome == Outcome::Right && !matches!(self.kind, Kind::None | Kind::Outside)
    }

    /// Whether something is to be desired: another verdict than what is sealed, or a validation error beyond that of the truth's own form.
    pub fn falls_short(&self) -> bool {
        self.outcome != Outcome::Right || (self.named_right() && !self.figures.as_good())
    }

    /// How strong the effect is that shows least, noise floors: the largest validation error of the best model without it. That is the one
    /// fitted from the true values on, or the one that the identification or the diagnosis found, where that fits what was recorded
    /// better: the other one then ended in a false minimum.
    pub fn least_strength(&self) -> f64 {
        self.least(|without| without.error).unwrap_or(f64::INFINITY)
    }

    /// How much is seen of the effect that shows least in the runs that may be fitted, noise floors: the largest structured residual there of
    /// the best model without it. What is small here can't be told from those runs, however much it matters in the validation. `None` where that is not known.
    pub fn least_left(&self) -> Option<f64> {
        self.least(|without| without.left)
    }

    fn least(&self, figure: impl Fn(&Without) -> Option<f64>) -> Option<f64> {
        let each = (0..self.acting.len()).map(|n| {
            let acting = &self.acting[n];
            let fitted = Without { cost: acting.cost, error: Some(acting.strength), left: acting.left };
            let better = self.found_without(n).filter(|found| match (found.cost, found.error, fitted.cost) {
                (Some(found), Some(_), Some(fitted)) => found < fitted,
                _ => false,
            });
            figure(&better.unwrap_or(fitted))
        });
        each.reduce(|a, b| Some(a?.min(b?))).flatten()
    }

    /// A model without one effect, but with all others, that was found on the way.
    fn found_without(&self, n: usize) -> Option<Without> {
        let named: BTreeSet<&str> = self.said.iter().flat_map(|s| &s.effects).map(|e| e.id.as_str()).collect();
        let others: BTreeSet<&str> =
            self.acting.iter().enumerate().filter(|(k, _)| *k != n).map(|(_, a)| a.id.as_str()).collect();
        let f = &self.figures;
        match () {
            () if others.is_empty() => {
                Some(Without { cost: f.cost_identified, error: f.before, left: f.residual_before })
            }
            () if others == named => Some(Without { cost: f.cost_after, error: f.after, left: f.residual_after }),
            () => None,
        }
    }

    /// One line: truth, strength, verdict, effects found, probability, errors, time.
    pub fn line(&self) -> String {
        let sealed: Vec<String> = self.acting.iter().map(|a| format!("{} {:.1}", a.form, a.strength)).collect();
        let sealed = if sealed.is_empty() { "nothing".to_owned() } else { sealed.join(" + ") };
        let found = match &self.said {
            None => self.error.clone().unwrap_or_default(),
            Some(said) => {
                let effects = said.effects.iter().map(|e| {
                    let class: String = e.equivalent.iter().map(|id| format!("|{id}")).collect();
                    format!("{}{class} {:.2}", e.id, e.probability)
                });
                format!("{} {}", said.verdict, effects.collect::<Vec<_>>().join(" + "))
            }
        };
        let figure = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.2}"));
        let Seconds { record, measure, identify, diagnose } = self.seconds;
        format!(
            "case {:3} {:8} {sealed} -> {} ({}); error {} -> {} (truth's form {}, ratio {}); {:.0} + {:.0} s",
            self.case,
            self.kind.as_str(),
            found.trim(),
            self.outcome.as_str(),
            figure(self.figures.before),
            figure(self.figures.after),
            figure(self.figures.truth),
            figure(self.figures.against_truth),
            record + measure,
            identify + diagnose,
        )
    }
}

fn or_nan<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::judge::Named;
    use super::*;

    pub fn acting(id: &str, strength: f64, cost: f64) -> Acting {
        let (id, form, balance) = (id.to_owned(), id.to_owned(), "flow".to_owned());
        Acting {
            id,
            balance,
            form,
            parameters: Default::default(),
            strength,
            cost: Some(cost),
            left: Some(strength / 2.0),
        }
    }

    pub fn case(acting: Vec<Acting>, named: &[&str], figures: Figures) -> Case {
        let effects = named.iter().map(|id| Named {
            id: (*id).to_owned(),
            balance: "flow".to_owned(),
            probability: 1.0,
            equivalent: Vec::new(),
        });
        Case {
            case: 0,
            diagnosis: None,
            kind: Kind::Weak,
            attempt: 0,
            rig: crate::blind::rig::draw(1, 0, 0),
            rig_seconds: 0.0,
            acting,
            strength: f64::NAN,
            said: Some(Said { verdict: "attributed".to_owned(), effects: effects.collect() }),
            error: None,
            outcome: Outcome::Missed,
            figures,
            seconds: Seconds::default(),
        }
    }

    #[test]
    fn an_effect_is_as_strong_as_the_best_model_without_it_is_wrong() {
        let found = |cost_identified| Figures {
            before: Some(1.02),
            cost_identified: Some(cost_identified),
            ..Figures::default()
        };
        let of = |cost| case(vec![acting("tilt", 2.3, 11.0)], &[], found(cost)).least_strength();
        assert_eq!(of(11.5), 2.3, "the identification found nothing better");
        assert_eq!(of(2.1), 1.02);
    }

    #[test]
    fn of_two_the_one_that_shows_least_counts() {
        let pair = || vec![acting("tilt", 6.0, 8.0), acting("end_stop", 5.0, 9.0)];
        let found = || Figures { after: Some(1.1), cost_after: Some(3.0), ..Figures::default() };
        assert_eq!(case(pair(), &[], found()).least_strength(), 5.0);
        assert_eq!(case(pair(), &["tilt"], found()).least_strength(), 1.1, "without end_stop all is explained");
        assert_eq!(case(pair(), &["backlash"], found()).least_strength(), 5.0, "a wrong name says nothing of either");
        assert_eq!(case(pair(), &["tilt", "end_stop"], found()).least_strength(), 5.0);
    }

    #[test]
    fn what_is_seen_of_an_effect_is_what_the_best_model_without_it_leaves() {
        let found = |cost| Figures {
            before: Some(5.2),
            residual_before: Some(0.4),
            cost_identified: Some(cost),
            ..Figures::default()
        };
        let of = |cost| case(vec![acting("tilt", 5.0, 3.0)], &[], found(cost)).least_left();
        assert_eq!((of(3.5), of(2.5)), (Some(2.5), Some(0.4)));
        let pair = || vec![acting("tilt", 6.0, 8.0), acting("end_stop", 5.0, 9.0)];
        assert_eq!(case(pair(), &[], Figures::default()).least_left(), Some(2.5));
        let mut unknown = pair();
        unknown[0].left = None;
        assert_eq!(case(unknown, &[], Figures::default()).least_left(), None);
        assert_eq!(case(Vec::new(), &[], Figures::default()).least_left(), None, "nothing acts");
    }

    #[test]
    fn a_right_name_with_a_larger_error_than_the_truths_form_falls_short() {
        let of = |kind, outcome, ratio| {
            let figures = Figures { against_truth: ratio, ..Figures::default() };
            Case { kind, outcome, ..case(Vec::new(), &[], figures) }.falls_short()
        };
        assert!(!of(Kind::Weak, Outcome::Right, Some(1.09)));
        assert!(of(Kind::Weak, Outcome::Right, Some(1.11)));
        assert!(of(Kind::Pair, Outcome::Right, None), "nobody could say");
        assert!(of(Kind::Weak, Outcome::LookAlike, Some(1.0)));
        assert!(
            !of(Kind::Outside, Outcome::Right, Some(5.0)),
            "what has no name is not compared with the truth's form"
        );
        assert!(!of(Kind::None, Outcome::Right, None));
    }

    #[test]
    fn a_case_that_failed_is_read_back() {
        let written = serde_json::to_string(&case(Vec::new(), &[], Figures::default())).expect("plain values");
        assert!(written.contains(r#""strength":null"#), "{written}");
        let read: Case = serde_json::from_str(&written).expect("what was written");
        assert!(read.strength.is_nan());
    }
}
