//! Fig. 8: the validation runs, measured and simulated, and their errors beside the noise floor.

use recordings::Protocol;

use crate::figure::{Figure, Mark, Series, Table};
use crate::figures::text::{number, run_name};
use crate::figures::{Subject, residual, section, series};
use crate::prepare::Channel;
use crate::validate::{Simulated, ValidatedRun};

/// Measured samples shown of one channel.
const MOST_POINTS: usize = 3000;

/// Channels that share a figure.
const TOGETHER: [(&str, &str, &[Channel]); 4] = [
    ("angle", "angle / deg", &[Channel::Angle]),
    ("pressures", "pressure / bar", &[Channel::Pressure1, Channel::Pressure2]),
    ("torque", "torque / Nm", &[Channel::Torque]),
    ("volume", "volume / ml", &[Channel::Volume]),
];

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let mut out = Vec::new();
    for run in subject.validation {
        for (what, y_label, channels) in TOGETHER {
            let series: Vec<Series> =
                channels.iter().enumerate().flat_map(|(group, c)| curves(subject, run, *c, group)).collect();
            if series.is_empty() {
                continue;
            }
            let name = run_name(&run.prepared.file);
            out.push(Figure {
                id: format!("validation_{name}_{what}"),
                section: section::VALIDATION.into(),
                title: format!("{name}: {what}"),
                caption: caption(subject, run),
                x_label: "time / s".into(),
                y_label: y_label.into(),
                series,
            });
        }
        out.extend(left(subject, run));
    }
    out
}

/// What the simulations leave of a run, averaged.
fn left(subject: &Subject, run: &ValidatedRun) -> Option<Figure> {
    let name = run_name(&run.prepared.file);
    let mut figure = residual::empty(name, section::VALIDATION);
    let added = subject.after().is_some();
    let shown = [(&run.before, added), (run.after.as_ref().unwrap_or(&run.before), false)];
    for (group, channel) in Channel::ALL.into_iter().enumerate() {
        let c = channel.index();
        for (result, reference) in shown.iter().skip(usize::from(!added)) {
            let Ok(result) = result else { continue };
            let errors = run.prepared.stretches.iter().zip(&result.rows).filter(|(s, _)| !s.measured[c].is_empty());
            let errors = errors.flat_map(|(s, rows)| {
                s.time_s.iter().zip(&s.measured[c]).zip(rows).map(|((t, m), y)| (*t, m - y[c], 1))
            });
            let floor = run.noise_floor[c];
            let points: Vec<(f64, f64)> = residual::averaged(errors).into_iter().map(|(t, r)| (t, r / floor)).collect();
            if !points.is_empty() {
                figure.series.push(residual::curve(subject, channel, *reference, group, points));
            }
        }
    }
    (!figure.series.is_empty()).then_some(figure)
}

fn caption(subject: &Subject, run: &ValidatedRun) -> String {
    let entry = &subject.loaded.runs[run.prepared.run].entry;
    let mut text = format!("{} run, {} plane, never fitted. ", entry.protocol, entry.plane);
    if entry.protocol == Protocol::SquareWave {
        text.push_str("Counterpart of fig. 8. ");
    }
    text.push_str("Free run: the models get the voltage and the valves, and start from the mean of the initial rest.");
    if let Some(failure) = run.failure() {
        text.push(' ');
        text.push_str(&failure);
        text.push('.');
    }
    text
}

/// Measured samples and both simulations of one channel; empty where it is not compared.
fn curves(subject: &Subject, run: &ValidatedRun, channel: Channel, group: usize) -> Vec<Series> {
    let c = channel.index();
    let stretches = &run.prepared.stretches;
    let rows: usize = stretches.iter().map(|s| s.measured[c].len()).sum();
    if rows == 0 {
        return Vec::new();
    }
    let step = rows.div_ceil(MOST_POINTS);
    let measured = stretches.iter().flat_map(|s| s.time_s.iter().copied().zip(s.measured[c].iter().copied()));
    let measured = measured.filter(|(_, y)| y.is_finite()).step_by(step);
    let name = channel.column();
    let mut out = vec![series(format!("{name} measured"), Mark::Points, group, measured)];
    let mut simulated = |label: &str, mark: Mark, result: &Simulated| {
        let mut points = Vec::new();
        for (s, rows) in stretches.iter().zip(&result.rows).filter(|(s, _)| !s.measured[c].is_empty()) {
            points.extend(s.time_s.iter().zip(rows).map(|(t, y)| (*t, y[c])));
            // no line from one stretch to the next
            points.push((s.time_s[s.rows() - 1], f64::NAN));
        }
        out.push(series(format!("{name} {label}"), mark, group, points));
    };
    let named = |d: &crate::diagnose::Diagnosis| d.verdict != crate::diagnose::Verdict::None;
    match (&run.before, &run.after) {
        (before, Some(after)) if subject.diagnosis.is_some_and(named) => {
            if let Ok(before) = before {
                simulated("reference model", Mark::Dashed, before);
            }
            if let Ok(after) = after {
                simulated(&subject.last_name(), Mark::Line, after);
            }
        }
        (Ok(before), _) => simulated("model", Mark::Line, before),
        (Err(_), _) => {}
    }
    out
}

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let diagnosed = subject.diagnosis.is_some();
    let mut rows = Vec::new();
    for run in subject.validation {
        let name = run_name(&run.prepared.file);
        if let Some(failure) = run.failure() {
            let mut row = vec![name.to_string(), failure];
            row.resize(if diagnosed { 9 } else { 7 }, String::new());
            rows.push(row);
        }
        for c in run.compared() {
            let mut row = vec![name.to_string(), c.before.channel.column().to_string(), number(c.before.rmse, 3)];
            row.extend(c.after.filter(|_| diagnosed).map(|a| number(a.rmse, 3)));
            row.push(number(c.noise_floor, 3));
            row.push(number(c.before.rmse / c.noise_floor, 3));
            row.extend(c.after.filter(|_| diagnosed).map(|a| number(a.rmse / c.noise_floor, 3)));
            row.push(number(c.after.unwrap_or(c.before).largest, 3));
            let fit = c.after.unwrap_or(c.before).fit_percent;
            row.push(fit.map_or("-".into(), |f| format!("{f:.2}")));
            rows.push(row);
        }
    }
    let columns: &[&str] = if diagnosed {
        &["run", "channel", "before", "after", "floor", "before / floor", "after / floor", "largest after", "fit / %"]
    } else {
        &["run", "channel", "RMSE", "floor", "RMSE / floor", "largest", "fit / %"]
    };
    vec![Table {
        section: section::VALIDATION.into(),
        title: "Free-run errors of the runs that were never fitted".into(),
        caption: "Root mean square errors and the largest one, in the channel's own unit, over all samples. The noise floor is what the sensor alone causes, estimated from the \
                  data: a perfect model's error. Fit: 100 % is no error, 0 % no better than the channel's mean."
            .into(),
        columns: columns.iter().map(|c| c.to_string()).collect(),
        rows,
    }]
}
