//! The verdict, what was added, and the candidates.

use crate::diagnose::{BEYOND_NOISE, CONSISTENT, Diagnosis, Verdict};
use crate::figure::Table;
use crate::figures::text::{chance, interval, measured, number};
use crate::figures::{Subject, section, summary};
use crate::findings::{is_held, ranking};
use crate::misfit;
use crate::uncertainty::Known;

pub(super) fn headline(subject: &Subject) -> Vec<String> {
    let mut out = vec![match subject.diagnosis {
        None => "The reference model is identified; its residual was not diagnosed.".to_string(),
        Some(d) => verdict(d),
    }];
    out.extend(errors(subject));
    out.extend(left_over(subject));
    out.extend(contradicted(subject));
    out.extend(confined(subject));
    out.push(summary::parameters(subject));
    out.push(summary::checks(subject));
    out.extend(summary::torque_form(subject));
    out.extend(summary::corruption(subject));
    if let Some(d) = subject.diagnosis {
        if let Some(next) = &d.next_experiment {
            out.push(format!("Next experiment: {next}."));
        }
        for a in d.effects.iter().filter(|a| !a.equivalent.is_empty() && d.verdict == Verdict::Attributed) {
            out.push(format!(
                "Within this data's resolution {} is {} as well.",
                a.effect.header().id,
                a.equivalent.join(", ")
            ));
        }
    }
    for (name, why) in &subject.identified.undetermined {
        out.push(format!("{name} is not determined by this campaign: {why}."));
    }
    out.extend(subject.validation.iter().filter_map(|r| r.failure()).map(|f| format!("{f}.")));
    out
}

/// One sentence.
pub fn verdict(d: &Diagnosis) -> String {
    match d.verdict {
        Verdict::None => "The declared model explains the data: no effect beyond it is found.".into(),
        Verdict::Attributed => {
            let effects = d.effects.iter().map(|a| {
                let header = a.effect.header();
                let (id, balance) = (header.id, header.balance.as_str());
                format!("{id} ({balance} balance, probability {:.2}): {}", a.probability, header.summary)
            });
            format!("The residual is attributed to {}.", effects.collect::<Vec<_>>().join("; and to "))
        }
        Verdict::Ambiguous => {
            let candidates: Vec<String> =
                ranking(&d.ranking).iter().take(4).map(|c| format!("{} ({:.2})", c.id, c.probability)).collect();
            let apart = d.effects.iter().filter(|a| a.equivalent.is_empty()).map(|a| a.effect.header().id);
            let beside = match apart.collect::<Vec<_>>()[..] {
                [] => "There is a structured residual".to_owned(),
                ref certain => format!("There is a structured residual beside {}", certain.join(" and ")),
            };
            format!("{beside}, but the data can't tell the leading candidates apart: {}.", candidates.join(", "))
        }
        Verdict::Unrecognised => {
            let balance = d.effects.first().map_or("", |a| a.effect.header().balance.as_str());
            let terms = if d.says_only_where() {
                "predict what was left out of their fit worse than the model without them does: they say where it sits, and are of \
                 no size in the model"
                    .into()
            } else {
                format!("take up {:.0} % of it", 100.0 * d.explained)
            };
            format!(
                "There is a structured residual that no known effect explains; it sits in the {balance} balance. Terms without a \
                 name there {terms}."
            )
        }
    }
}

/// The validation error of each run in one line, as multiples of the noise floor.
fn errors(subject: &Subject) -> Option<String> {
    let (before, _, _) = worst(subject, false)?;
    let largest = "Largest free-run error on the validation runs";
    Some(match worst(subject, true).filter(|_| subject.after().is_some()) {
        Some((after, _, _)) => {
            format!("{largest}: {} noise floors before, {} after.", number(before, 3), number(after, 3))
        }
        None => format!("{largest}: {} noise floors.", number(before, 3)),
    })
}

/// The largest free-run error in noise floors, with the run and channel it is in.
fn worst(subject: &Subject, after: bool) -> Option<(f64, String, &'static str)> {
    let all = subject.validation.iter().flat_map(|r| r.compared().into_iter().map(move |c| (r, c)));
    let ratios = all.filter_map(|(run, c)| {
        let score = if after { c.after? } else { c.before };
        Some((score.rmse / c.noise_floor, run.prepared.file.clone(), score.channel.column()))
    });
    ratios.filter(|(r, ..)| r.is_finite()).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// What is left where it is more than a matter of a form, the largest part of it: of what named effects leave, and where none is found.
fn left_over(subject: &Subject) -> Option<String> {
    let diagnosis = subject.diagnosis.filter(|d| matches!(d.verdict, Verdict::None | Verdict::Attributed))?;
    let part = misfit::leading(&diagnosis.parts_after)?;
    if misfit::largest(std::slice::from_ref(part)) < CONSISTENT {
        return None;
    }
    let (column, run) = (part.channel.column(), &subject.loaded.runs[part.run].entry.file);
    let floors = number(part.structured.sqrt(), 3);
    Some(if diagnosis.silent {
        format!(
            "{column} of {run}, which was fitted, shows {floors} noise floors that the first second of the runs does not, and nothing \
             that the library knows goes with them: noise that creeps, most likely."
        )
    } else {
        format!(
            "Not all is explained: {column} of {run} still shows {floors} noise floors that are no noise, in the run that was fitted."
        )
    })
}

/// Free-run error from which a validation run contradicts a model that explains the runs it was fitted to, noise floors: what is
/// left is then two thirds of the noise.
const CONTRADICTS: f64 = 1.2;

/// Where the runs that were fitted are explained and those that were not aren't. They decide nothing; that must be said.
fn contradicted(subject: &Subject) -> Option<String> {
    let diagnosis = subject.diagnosis?;
    let named = matches!(diagnosis.verdict, Verdict::None | Verdict::Attributed);
    let left = misfit::largest(&diagnosis.parts_after);
    let (most, while_fitted) = if named && left < CONSISTENT {
        (CONTRADICTS, "the runs that were fitted are explained")
    } else if named && diagnosis.silent && left < BEYOND_NOISE {
        (BEYOND_NOISE, "the runs that were fitted leave no more than noise that creeps does")
    } else {
        return None;
    };
    let (ratio, run, column) = worst(subject, subject.after().is_some())?;
    (ratio > most).then(|| {
        format!(
            "The validation contradicts this: {column} of {run} is off by {} noise floors, while {while_fitted}. Runs with role \
             validate decide nothing; a further run of that kind with role identify would let what is missing be found.",
            number(ratio, 3)
        )
    })
}

/// Terms without a name that make the validation worse: whoever goes on with them must know.
fn confined(subject: &Subject) -> Option<String> {
    subject.diagnosis.filter(|d| d.verdict == Verdict::Unrecognised)?;
    let ((before, ..), (after, run, column)) = (worst(subject, false)?, worst(subject, true)?);
    (after > before).then(|| {
        format!(
            "The terms without a name do not hold beyond the runs they were fitted to: {column} of {run} is off by {} noise floors \
             with them. They say where the residual sits, not what a run elsewhere would do.",
            number(after, 3)
        )
    })
}

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let Some(d) = subject.diagnosis else { return Vec::new() };
    let mut tables = vec![effects(d)];
    if !d.ranking.is_empty() {
        tables.push(candidates(d));
    }
    tables
}

fn effects(d: &Diagnosis) -> Table {
    let mut rows = Vec::new();
    for a in &d.effects {
        let header = a.effect.header();
        for (i, p) in header.parameters.iter().enumerate() {
            let (Some(&value), Some(&Known { std, half_interval })) = (a.values.get(i), a.known.get(i)) else {
                continue;
            };
            let (first, held) = (i == 0, is_held(d, a, i));
            let head = |text: String| if first { text } else { String::new() };
            rows.push(vec![
                head(header.id.to_string()),
                head(header.balance.as_str().to_string()),
                head(format!("{:.2}", a.probability)),
                p.name.to_string(),
                measured(value, std),
                if held { "not needed".into() } else { number(std, 2) },
                if held { String::new() } else { interval(value, std, half_interval) },
                p.unit.to_string(),
            ]);
        }
    }
    let (title, caption) = match d.verdict {
        Verdict::Ambiguous => (
            "Leading candidate",
            "Not a finding: other candidates explain the data as well. Free-run errors \"after\" are with this one.",
        ),
        Verdict::Unrecognised => (
            "Empirical terms",
            "No effect of the library explains the residual; these terms describe it in the balance where they explain most. They \
             hold in the range of this data and claim no physics.",
        ),
        _ => ("What was added to the model", "Fitted together with all base parameters. Interval: 95 %."),
    };
    let equations: Vec<String> =
        d.effects.iter().map(|a| format!(" {}: {}.", a.effect.header().id, a.effect.header().equation)).collect();
    Table {
        section: section::RESULT.into(),
        title: title.into(),
        caption: format!("{caption}{}", equations.concat()),
        columns: ["effect", "balance", "probability", "parameter", "value", "std. error", "95 % interval", "unit"]
            .map(String::from)
            .to_vec(),
        rows,
    }
}

fn candidates(d: &Diagnosis) -> Table {
    let rows = ranking(&d.ranking).into_iter().map(|c| {
        let header = model::effects::find(&c.id).map(|e| e.header());
        vec![
            c.id,
            header.map_or(String::new(), |h| h.balance.as_str().into()),
            chance(c.probability),
            header.map_or(String::new(), |h| h.summary.into()),
        ]
    });
    Table {
        section: section::RESULT.into(),
        title: "Candidates".into(),
        caption: "Those whose score led to a joint refit, by how far they stand behind the best.".into(),
        columns: ["candidate", "balance", "probability", "what it is"].map(String::from).to_vec(),
        rows: rows.collect(),
    }
}
