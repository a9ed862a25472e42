//! What the models leave: structured residual by run and channel, and over time.

use crate::figure::{Figure, Mark, Table};
use crate::figures::text::{chance, number, run_name};
use crate::figures::{Subject, section, series};
use crate::fit::Fit;
use crate::prepare::{Channel, Stand};

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let before = channel_curves(subject, &subject.identified.fit);
    let after = subject.after().map(|fit| channel_curves(subject, fit));
    let mut out = Vec::new();
    for (run, loaded) in subject.loaded.runs.iter().enumerate() {
        let mut shown = Vec::new();
        for (group, channel) in [Channel::Angle, Channel::Pressure1, Channel::Pressure2].into_iter().enumerate() {
            let own = |curves: &[Curve]| {
                curves
                    .iter()
                    .find(|c| c.run == run && c.channel == channel)
                    .map(|c| c.points.clone())
                    .unwrap_or_default()
            };
            let name = channel.column();
            match &after {
                Some(after) => {
                    shown.push(series(format!("{name} reference model"), Mark::Dashed, group, own(&before)));
                    shown.push(series(format!("{name} {}", subject.last_name()), Mark::Line, group, own(after)));
                }
                None => shown.push(series(name, Mark::Line, group, own(&before))),
            }
        }
        let name = run_name(&loaded.entry.file);
        out.push(Figure {
            id: format!("residual_{name}"),
            section: section::RESIDUAL.into(),
            title: format!("{name}: measured less simulated"),
            caption: "A fitted run in free run, averaged over 10 ms, in units of the channel's noise of one sample. Noise alone stays \
                      within about 1; what rises out of it again and again is structure."
                .into(),
            x_label: "time / s".into(),
            y_label: "residual / noise floor".into(),
            series: shown,
        });
    }
    out
}

/// Block means of the residual of one channel of a fitted run with a free lever.
struct Curve {
    run: usize,
    channel: Channel,
    points: Vec<(f64, f64)>,
}

fn channel_curves(subject: &Subject, fit: &Fit) -> Vec<Curve> {
    let problem = &subject.identified.problem;
    // a fit that was reached can be simulated; without it there is nothing to draw
    let Ok(residuals) = problem.residuals(&fit.layout, &fit.point) else { return Vec::new() };
    let mut out = Vec::new();
    for (s, residual) in problem.stretches.iter().zip(&residuals).filter(|(s, _)| s.stand == Stand::Free) {
        for channel in [Channel::Angle, Channel::Pressure1, Channel::Pressure2] {
            let points = s.targets.iter().zip(residual).filter(|(t, _)| t.channel == channel);
            let points = points.map(|(t, r)| (t.time_s, r / (t.samples as f64).sqrt())).collect();
            out.push(Curve { run: s.run, channel, points });
        }
    }
    out
}

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let Some(d) = subject.diagnosis else { return Vec::new() };
    let mut rows = Vec::new();
    for part in &d.parts_before {
        let after = d.parts_after.iter().find(|p| p.run == part.run && p.channel == part.channel);
        let rms = |structured: f64| number(structured.max(0.0).sqrt(), 2);
        rows.push(vec![
            run_name(&subject.loaded.runs[part.run].entry.file).to_string(),
            part.channel.column().to_string(),
            rms(part.structured),
            number(part.significance, 2),
            after.map_or("-".into(), |p| rms(p.structured)),
            after.map_or("-".into(), |p| number(p.significance, 2)),
        ]);
    }
    let balances = d.balances.iter().map(|(b, p)| {
        let what = match b {
            model::effects::Balance::Torque => "torques on the lever",
            model::effects::Balance::Flow => "oil of the chambers",
            model::effects::Balance::Pump => "pump, valves and line",
            model::effects::Balance::Sensor => "what the sensors show",
        };
        vec![b.as_str().to_string(), what.to_string(), chance(*p)]
    });
    vec![
        Table {
            section: section::RESIDUAL.into(),
            title: "Tests by balance".into(),
            caption: "p-value of the test that the balance has no structured residual under the declared model: score tests of \
                      everything that could act there, against random signs of whole clusters. Where something was added to a balance, \
                      the others are tested with it, so that one effect does not light up all."
                .into(),
            columns: ["balance", "of", "p-value"].map(String::from).to_vec(),
            rows: balances.collect(),
        },
        Table {
            section: section::RESIDUAL.into(),
            title: "Structured residual by run and channel".into(),
            caption: "Root mean square of what neighbouring 10 ms blocks have in common, in units of the channel's noise of one \
                      sample, and its size in standard errors; the fitted runs. 0.1 does not matter, 1 is as large as the noise."
                .into(),
            columns: ["run", "channel", "before", "before / std. errors", "after", "after / std. errors"]
                .map(String::from)
                .to_vec(),
            rows,
        },
    ]
}
