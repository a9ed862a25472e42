//! The results of a plant's diagnosis as text, tables and figures.

use super::analysis::{Error, PlantAnalysis};
use crate::diagnose::Verdict;
use crate::figure::{Figure, Mark, Series, Table};
use crate::figures::text::{between, number};
use crate::fit::Fit;

/// The verdict in a sentence, then key facts, one a line.
pub fn headline(a: &PlantAnalysis) -> Vec<String> {
    let named: Vec<String> = a
        .findings
        .effects
        .iter()
        .map(|e| {
            if e.equivalent.is_empty() {
                e.id.to_string()
            } else {
                format!("{} (hardly told from {})", e.id, e.equivalent.join(", "))
            }
        })
        .collect();
    let named = named.join("; ");
    let verdict = match a.diagnosis.verdict {
        Verdict::None => "The declared model explains the data.".to_string(),
        Verdict::Attributed => format!("The declared model lacks: {named}."),
        Verdict::Ambiguous => format!("The declared model lacks something; these explain it alike: {named}."),
        Verdict::Unrecognised => {
            "The declared model lacks something that no effect of the library explains.".to_string()
        }
    };
    let mut out = vec![verdict];
    for s in &a.scored {
        if let (Some(before), Some(after)) = (s.before, s.after) {
            out.push(format!(
                "{}, never fitted: error of {} {} before, {} after.",
                s.section,
                s.channel.name,
                of(before, s.channel.unit),
                of(after, s.channel.unit)
            ));
        }
    }
    if a.diagnosis.says_only_where() {
        out.push(
            "Terms without a name predict what was left out of their fit worse than the model without them does: they say in which \
             balance it is, and are of no size in the model."
                .into(),
        );
    } else if a.diagnosis.verdict != Verdict::None {
        out.push(format!(
            "Share of the structured residual that is explained: {:.1} %.",
            100.0 * a.diagnosis.explained
        ));
    }
    out
}

/// `0.389 mV (0.73 %)`
fn of(error: Error, unit: &str) -> String {
    format!("{} ({} %)", sized(error.rmse, unit), number(100.0 * error.relative, 3))
}

/// A value with its unit, in thousandths or millionths where it is small; of a plain unit of one word.
fn sized(value: f64, unit: &str) -> String {
    let plain = unit.chars().all(char::is_alphabetic);
    let (factor, prefix) = match value.abs() {
        v if plain && v < 1e-4 && v > 0.0 => (1e6, "u"),
        v if plain && v < 0.1 && v > 0.0 => (1e3, "m"),
        _ => (1.0, ""),
    };
    format!("{} {prefix}{unit}", number(value * factor, 3))
}

/// Tables: effects, validation, base parameters.
pub fn tables(a: &PlantAnalysis) -> Vec<Table> {
    let text = |s: &[&str]| s.iter().map(|s| s.to_string()).collect::<Vec<String>>();
    let effects = a.findings.effects.iter().flat_map(|e| {
        e.parameters.0.iter().map(move |(name, v)| {
            vec![
                e.id.to_string(),
                e.balance.to_string(),
                name.to_string(),
                number(v.value, 4),
                number(v.std, 2),
                between(v.interval, v.std),
                v.unit.to_string(),
                if e.equivalent.is_empty() { "-".to_string() } else { e.equivalent.join(", ") },
            ]
        })
    });
    let validation = a.scored.iter().map(|s| {
        let say = |e: Option<Error>, f: fn(Error) -> f64| e.map_or("ended early".to_string(), |e| number(f(e), 3));
        vec![
            s.section.to_string(),
            s.channel.name.to_string(),
            s.channel.unit.to_string(),
            say(s.before, |e| e.rmse),
            say(s.after, |e| e.rmse),
            say(s.before, |e| 100.0 * e.relative),
            say(s.after, |e| 100.0 * e.relative),
        ]
    });
    let parameters = a.plant.header().parameters.iter().enumerate().map(|(p, parameter)| {
        let of = |fit: &Fit, std: &[f64]| match fit.layout.base.iter().position(|&b| b == p) {
            Some(i) => [number(fit.point.theta[i], 5), number(std[i], 2)],
            None => [number(fit.layout.fixed[p], 5), "fixed".to_string()],
        };
        let before = of(&a.declared, &a.declared_std);
        let after = of(&a.diagnosis.after, &a.after_std);
        [&[parameter.name.to_string()][..], &before, &after, &[parameter.unit.to_string()]].concat()
    });
    vec![
        Table {
            section: "Findings".into(),
            title: "What was added".into(),
            caption: "Values with standard errors. The last column: effects that the data hardly tell from it, by the angle between \
                      the sensitivities or by a refit in its place. Units are those of the effect's port; rad, rad/s and Nm stand for \
                      the plant's own position, speed and force."
                .into(),
            columns: text(&["effect", "balance", "parameter", "value", "std. error", "95 % interval", "unit", "class"]),
            rows: effects.collect(),
        },
        Table {
            section: "Validation".into(),
            title: "Free run on data that were never fitted".into(),
            caption: "Root mean square error, and the norm of the error over that of the measured values.".into(),
            columns: text(&["section", "channel", "unit", "RMSE before", "RMSE after", "% before", "% after"]),
            rows: validation.collect(),
        },
        Table {
            section: "Model".into(),
            title: format!("Base parameters of {}", a.plant.header().equation),
            caption: "Of the declared model, and with what was added.".into(),
            columns: text(&["parameter", "declared", "std. error", "after", "std. error", "unit"]),
            rows: parameters.collect(),
        },
    ]
}

/// Figures: measured and predicted, and the errors, of each section that was never fitted.
pub fn figures(a: &PlantAnalysis) -> Vec<Figure> {
    let mut out = Vec::new();
    for (n, o) in a.overlays.iter().enumerate() {
        let x: Vec<f64> = o.rows.iter().map(|r| r[0]).collect();
        let series = |name: &str, mark, group, f: &dyn Fn(&[f64; 4]) -> f64| Series {
            name: name.into(),
            mark,
            group,
            x: x.clone(),
            y: o.rows.iter().map(f).collect(),
        };
        let figure = |id: String, title: String, caption: &str, series| Figure {
            id,
            section: "Validation".into(),
            title,
            caption: caption.into(),
            x_label: "time / s".into(),
            y_label: format!("{} / {}", o.channel.name, o.channel.unit),
            series,
        };
        out.push(figure(
            format!("run_{n}"),
            format!("{}: {}", o.section, o.channel.name),
            "Free run beside the measured values; nothing is fed back.",
            vec![
                series("measured", Mark::Points, 0, &|r| r[1]),
                series("declared model", Mark::Dashed, 1, &|r| r[2]),
                series("with what was added", Mark::Line, 2, &|r| r[3]),
            ],
        ));
        out.push(figure(
            format!("error_{n}"),
            format!("{}: error of {}", o.section, o.channel.name),
            "Measured less predicted.",
            vec![
                series("declared model", Mark::Dashed, 1, &|r| r[1] - r[2]),
                series("with what was added", Mark::Line, 2, &|r| r[1] - r[3]),
            ],
        ));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_values_carry_a_prefix_where_the_unit_is_one_word() {
        assert_eq!(sized(0.000389, "V"), "0.389 mV");
        assert_eq!(sized(2.9, "N"), "2.90 N");
        assert_eq!(sized(0.02, "m/s"), "0.0200 m/s");
    }
}
