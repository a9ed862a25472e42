//! What is known of a case once it is judged.

use super::judge::{Acting, Outcome, Said};
use super::plan::Kind;
use super::rig::Rig;
use serde::{Deserialize, Serialize};

/// Everything that is known of a case afterwards.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Case {
    /// Number, from 0; with the seed it gives the case again.
    pub case: usize,
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
    /// Largest validation error that all of them together cause after a refit of the base model, noise floors.
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

impl Case {
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
            "case {:3} {:8} {sealed} -> {} ({}); error {} -> {} (truth's form {}); {:.0} + {:.0} s",
            self.case,
            self.kind.as_str(),
            found.trim(),
            self.outcome.as_str(),
            figure(self.figures.before),
            figure(self.figures.after),
            figure(self.figures.truth),
            record + measure,
            identify + diagnose,
        )
    }
}
