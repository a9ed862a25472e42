//! `findings.json`: what a diagnosis concludes, for other programs.

use model::effects::Parameter;
use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::diagnose::{Added, Diagnosis, Ranked, Verdict};
use crate::judged::NotJudged;
use crate::plausible::SetAside;
use crate::uncertainty::Known;
use crate::validate::ValidatedRun;

/// The id of an effect that the library does not have.
pub const UNRECOGNISED: &str = "unrecognised";

/// The file. Fields are written in this order; every number is finite.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Findings {
    /// 1.
    pub format: u32,
    /// Name of the campaign.
    pub campaign: String,
    /// `none`, `attributed`, `ambiguous` or `unrecognised`.
    pub verdict: &'static str,
    /// What was added.
    pub effects: Vec<Finding>,
    /// Candidates, the likeliest first.
    pub ranking: Vec<Candidate>,
    /// By balance.
    pub balances: Named<BalanceTest>,
    /// By run and channel.
    pub validation: Vec<Validation>,
    /// The run that would tell the leading candidates apart.
    pub next_experiment: Option<String>,
    /// That run in numbers, where it was designed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_run: Option<NextRun>,
    /// Effects of the library that the campaign's runs say nothing about.
    pub not_judged: Vec<NotJudged>,
    /// Sensors that were not used.
    pub set_aside: Vec<Unused>,
}

/// The run that would settle what is open.
#[derive(Clone, Debug, serde::Serialize)]
pub struct NextRun {
    /// The script, beside this file.
    pub file: String,
    /// What it does.
    pub about: String,
    /// Protocol of the campaign format.
    pub protocol: String,
    /// `horizontal` or `vertical`.
    pub plane: String,
    /// Rig time, s.
    pub seconds: f64,
    /// What it is expected to tell apart.
    pub separates: Vec<Separates>,
    /// Why this one.
    pub why: String,
}

/// A pair of rivals.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Separates {
    /// The two.
    pub between: [String; 2],
    /// Expected significance of the better fit of the true one, whichever that is, standard errors.
    pub standard_errors: f64,
    /// RMS of the difference that no refit takes up, noise floors.
    pub noise_floors: f64,
}

/// A sensor that was not used.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Unused {
    /// File of the run.
    pub run: String,
    /// Columns.
    pub channels: Vec<&'static str>,
    /// `dead`, `saturated` or `duplicated`.
    pub fault: &'static str,
    /// Expected and got.
    pub why: String,
    /// The whole run was left out.
    pub whole_run: bool,
}

impl Unused {
    /// Of what was set aside.
    pub fn of(s: &SetAside) -> Self {
        Unused {
            run: s.file.clone(),
            channels: s.channels.iter().map(|c| c.column()).collect(),
            fault: s.fault.as_str(),
            why: s.why.clone(),
            whole_run: s.whole_run,
        }
    }
}

/// An effect that was added.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Finding {
    /// Id of the library, or [`UNRECOGNISED`].
    pub id: &'static str,
    /// Where it acts.
    pub balance: &'static str,
    /// Between 0 and 1.
    pub probability: f64,
    /// Ids that explain the data as well.
    pub equivalent: Vec<String>,
    /// In the order of the effect's header; without those that the data do not ask for ([`is_held`]).
    pub parameters: Named<Value>,
}

/// A parameter.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Value {
    /// In `unit`.
    pub value: f64,
    /// Standard error. Where the data tell nothing of the parameter (or less than that), that of a uniform distribution over its physical range.
    pub std: f64,
    /// Unit.
    pub unit: &'static str,
    /// 95 % interval, Student's for the clusters of data that the standard error rests on; the whole physical range where the data tell nothing.
    pub interval: [f64; 2],
}

/// A candidate.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Candidate {
    /// Id of the library.
    pub id: String,
    /// That it is part of what acts, between 0 and 1.
    pub probability: f64,
}

/// The test of a balance.
#[derive(Clone, Debug, serde::Serialize)]
pub struct BalanceTest {
    /// That the balance has no structured residual under the declared model.
    pub p_value: f64,
}

/// Free-run errors of one channel of a run, in the channel's unit.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Validation {
    /// File of the run.
    pub run: String,
    /// Column.
    pub channel: &'static str,
    /// With the reference model.
    pub rmse_before: f64,
    /// With what was added.
    pub rmse_after: f64,
    /// Of one sample.
    pub noise_floor: f64,
}

/// A JSON object whose keys keep their order.
#[derive(Clone, Debug)]
pub struct Named<T>(pub Vec<(&'static str, T)>);

impl<T: Serialize> Serialize for Named<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (key, value) in &self.0 {
            map.serialize_entry(key, value)?;
        }
        map.end()
    }
}

impl Findings {
    /// Of a campaign of this name. Runs whose simulation failed have no entry under `validation`
    /// ([`ValidatedRun::failure`] says them).
    pub fn of(campaign: &str, diagnosis: &Diagnosis, validation: &[ValidatedRun]) -> Self {
        let effects = match diagnosis.verdict {
            Verdict::None | Verdict::Ambiguous => Vec::new(),
            Verdict::Attributed => {
                diagnosis.effects.iter().map(|a| finding(a.effect.header().id, diagnosis, a)).collect()
            }
            Verdict::Unrecognised => diagnosis.effects.iter().map(|a| finding(UNRECOGNISED, diagnosis, a)).collect(),
        };
        let balances = diagnosis.balances.iter();
        let balances = balances
            .map(|(b, p)| (b.as_str(), BalanceTest { p_value: if p.is_finite() { *p } else { 1.0 } }))
            .collect();
        let validation = validation.iter().flat_map(|run| {
            run.compared().into_iter().filter_map(|c| {
                Some(Validation {
                    run: run.prepared.file.clone(),
                    channel: c.before.channel.column(),
                    rmse_before: c.before.rmse,
                    rmse_after: c.after?.rmse,
                    noise_floor: c.noise_floor,
                })
            })
        });
        Findings {
            format: 1,
            campaign: campaign.to_string(),
            verdict: diagnosis.verdict.as_str(),
            effects,
            ranking: ranking(&diagnosis.ranking),
            balances: Named(balances),
            validation: validation.filter(|v| v.rmse_before.is_finite() && v.rmse_after.is_finite()).collect(),
            next_experiment: diagnosis.next_experiment.clone(),
            next_run: None,
            not_judged: Vec::new(),
            set_aside: Vec::new(),
        }
    }

    /// The file's text. The same findings give the same bytes.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data with string keys has a JSON form");
        text.push('\n');
        text
    }
}

pub(crate) fn finding(id: &'static str, diagnosis: &Diagnosis, added: &Added) -> Finding {
    let header = added.effect.header();
    Finding {
        id,
        balance: header.balance.as_str(),
        probability: probability(added.probability),
        equivalent: added.equivalent.clone(),
        parameters: Named(parameters(diagnosis, added)),
    }
}

fn parameters(diagnosis: &Diagnosis, added: &Added) -> Vec<(&'static str, Value)> {
    let known = added.effect.header().parameters.iter().zip(added.values.iter().zip(&added.known)).enumerate();
    known
        .filter(|(i, _)| !is_held(diagnosis, added, *i))
        .map(|(_, (p, (&value, known)))| {
            let (std, interval) = within(p, value, *known);
            (p.name, Value { value, std, unit: p.unit, interval })
        })
        .collect()
}

/// Standard error and interval of a value. Data that know less of a parameter than its physical range does tell nothing.
fn within(p: &Parameter, value: f64, known: Known) -> (f64, [f64; 2]) {
    let uniform = (p.upper - p.lower) / 12f64.sqrt();
    // nor is an undefined error one
    if known.std < uniform {
        (known.std, [value - known.half_interval, value + known.half_interval])
    } else {
        (uniform, [p.lower, p.upper])
    }
}

/// The data do not ask for this parameter of an effect that was added: the effect explains them without it, and it was held
/// where it has none (a size) or no visible effect (a shape). It is no result.
pub fn is_held(diagnosis: &Diagnosis, added: &Added, parameter: usize) -> bool {
    let layout = &diagnosis.after.layout;
    let n = layout.effects.iter().position(|e| e.header().id == added.effect.header().id);
    n.is_some_and(|n| layout.held.contains(&(layout.first_of(n) + parameter)))
}

/// Candidates one by one: where sets of several were compared (`a+b`), an effect's probability is that of all sets it is in.
pub fn ranking(ranked: &[Ranked]) -> Vec<Candidate> {
    let mut out: Vec<Candidate> = Vec::new();
    for set in ranked {
        for id in set.id.split('+') {
            match out.iter_mut().find(|c| c.id == id) {
                Some(c) => c.probability = probability(c.probability + set.probability),
                None => out.push(Candidate { id: id.to_string(), probability: probability(set.probability) }),
            }
        }
    }
    out.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    out
}

/// Rounding may leave a sum of weights a hair above 1; a weight that can't be told is none.
fn probability(p: f64) -> f64 {
    if p.is_finite() { p.clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_that_know_less_of_a_parameter_than_its_physical_range_does_tell_nothing() {
        let effects = model::effects::LIBRARY;
        for p in effects.iter().flat_map(|e| e.header().parameters) {
            let range = p.upper - p.lower;
            let known = |std: f64| within(p, p.lower, Known { std, half_interval: 2.0 * std });
            let (std, [from, to]) = known(0.01 * range);
            assert_eq!((std, from, to), (0.01 * range, p.lower - 0.02 * range, p.lower + 0.02 * range), "{}", p.name);
            for tells_nothing in [1e7 * range, f64::INFINITY, f64::NAN] {
                let (std, interval) = known(tells_nothing);
                assert_eq!(interval, [p.lower, p.upper], "{}", p.name);
                assert!((std / range - 0.2887).abs() < 1e-4, "{}: {std}", p.name);
            }
        }
    }
}
