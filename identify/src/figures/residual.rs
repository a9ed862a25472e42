//! What the models leave: structured residual by run and channel, and over time.

use crate::figure::{Figure, Mark, Series, Table};
use crate::figures::text::{chance, number, run_name};
use crate::figures::{Subject, section, series};
use crate::fit::Fit;
use crate::prepare::{Channel, Stand};

/// Shortest time over which a residual is averaged for display, s.
const AVERAGED_S: f64 = 0.1;
/// Most points of an averaged residual.
const MOST_POINTS: f64 = 1000.0;

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let before = channel_curves(subject, &subject.identified.fit);
    let after = subject.after().map(|fit| channel_curves(subject, fit));
    let mut out = Vec::new();
    for (run, loaded) in subject.loaded.runs.iter().enumerate() {
        let mut figure = empty(run_name(&loaded.entry.file), section::RESIDUAL);
        for (group, channel) in [Channel::Angle, Channel::Pressure1, Channel::Pressure2].into_iter().enumerate() {
            let own = |curves: &[Curve]| {
                curves
                    .iter()
                    .find(|c| c.run == run && c.channel == channel)
                    .map(|c| c.points.clone())
                    .unwrap_or_default()
            };
            match &after {
                Some(after) => {
                    figure.series.push(curve(subject, channel, true, group, own(&before)));
                    figure.series.push(curve(subject, channel, false, group, own(after)));
                }
                None => figure.series.push(curve(subject, channel, false, group, own(&before))),
            }
        }
        out.push(figure);
    }
    out
}

/// A figure for the residuals of this run.
pub(super) fn empty(name: &str, section: &str) -> Figure {
    Figure {
        id: format!("residual_{name}"),
        section: section.into(),
        title: format!("{name}: measured less simulated"),
        caption: "Free run; averaged over 0.1 s or more, in units of the channel's noise of one sample. What swings far out of the \
                  band that the noise leaves is structure."
            .into(),
        x_label: "time / s".into(),
        y_label: "residual / noise floor".into(),
        series: Vec::new(),
    }
}

/// The averaged residual of one channel; `reference`: of the reference model beside another one.
pub(super) fn curve(
    subject: &Subject,
    channel: Channel,
    reference: bool,
    group: usize,
    points: Vec<(f64, f64)>,
) -> Series {
    let name = channel.column();
    match (subject.after(), reference) {
        (Some(_), true) => series(format!("{name} reference model"), Mark::Dashed, group, points),
        (Some(_), false) => series(format!("{name} {}", subject.last_name()), Mark::Line, group, points),
        (None, _) => series(name, Mark::Line, group, points),
    }
}

/// Means over windows of (time, value, weight); missing values are passed over.
pub(super) fn averaged(samples: impl Iterator<Item = (f64, f64, usize)> + Clone) -> Vec<(f64, f64)> {
    let Some((first, last)) = super::range(samples.clone().map(|s| s.0)) else { return Vec::new() };
    let width = ((last - first) / MOST_POINTS).max(AVERAGED_S);
    let mut out = Vec::new();
    let (mut window, mut time, mut sum, mut weight) = (0, 0.0, 0.0, 0.0);
    for (t, value, samples) in samples.filter(|s| s.1.is_finite()) {
        let own = ((t - first) / width) as usize;
        if own != window && weight > 0.0 {
            out.push((time / weight, sum / weight));
            (time, sum, weight) = (0.0, 0.0, 0.0);
        }
        window = own;
        time += t * samples as f64;
        sum += value * samples as f64;
        weight += samples as f64;
    }
    if weight > 0.0 {
        out.push((time / weight, sum / weight));
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
            let blocks = s.targets.iter().zip(residual).filter(|(t, _)| t.channel == channel);
            let blocks = blocks.map(|(t, r)| (t.time_s, r / (t.samples as f64).sqrt(), t.samples));
            out.push(Curve { run: s.run, channel, points: averaged(blocks) });
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
            caption: "Root mean square of what neighbouring blocks (10 ms in dynamic runs) have in common, in units of the channel's noise of one \
                      sample, and its size in standard errors; the fitted runs. 0.1 does not matter, 1 is as large as the noise."
                .into(),
            columns: ["run", "channel", "before", "before / std. errors", "after", "after / std. errors"]
                .map(String::from)
                .to_vec(),
            rows,
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_weigh_samples_and_pass_over_missing_ones() {
        let samples = [(0.0, 1.0, 1), (0.05, 4.0, 2), (0.06, f64::NAN, 9), (0.15, 7.0, 1), (0.35, 1.0, 1)];
        let found = averaged(samples.into_iter());
        assert_eq!(found.len(), 3);
        assert!((found[0].1 - 3.0).abs() < 1e-12 && (found[0].0 - 0.1 / 3.0).abs() < 1e-12);
        assert_eq!((found[1].1, found[2].1), (7.0, 1.0));
        let long = averaged((0..200_000).map(|i| (f64::from(i) * 1e-2, 0.5, 1)));
        assert!(long.len() <= 1001 && long.iter().all(|p| (p.1 - 0.5).abs() < 1e-12));
    }
}
