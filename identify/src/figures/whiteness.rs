//! Residual analysis of the validation runs: correlation with itself and with the inputs.

use crate::figure::{Figure, Mark, Series, Table};
use crate::figures::text::{chance, number, run_name};
use crate::figures::{Subject, section, series};

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let mut runs: Vec<&str> = subject.whiteness.iter().map(|w| w.run.as_str()).collect();
    runs.dedup();
    let mut out = Vec::new();
    for run in runs {
        let name = run_name(run);
        let own = || subject.whiteness.iter().filter(|w| w.run == run).enumerate();
        let lags = |lag_s: f64, first: usize, values: &[f64]| -> Vec<(f64, f64)> {
            values.iter().enumerate().map(|(i, v)| ((i + first) as f64 * lag_s, *v)).collect()
        };
        let mut auto: Vec<Series> = Vec::new();
        let mut cross: Vec<Series> = Vec::new();
        for (group, w) in own() {
            auto.push(series(w.channel, Mark::Line, group, lags(w.lag_s, 1, &w.auto)));
            for c in w.cross.iter().filter(|c| c.input == "voltage_v") {
                cross.push(series(w.channel, Mark::Line, group, lags(w.lag_s, 0, &c.correlation)));
                let end = w.lag_s * c.correlation.len() as f64;
                let band = [(0.0, c.band), (end, c.band), (end, f64::NAN), (0.0, -c.band), (end, -c.band)];
                cross.push(series(format!("{} 99 % band", w.channel), Mark::Dashed, group, band));
            }
        }
        if let Some((_, w)) = own().next() {
            let end = w.lag_s * w.auto.len() as f64;
            let band = [(0.0, w.band), (end, w.band), (end, f64::NAN), (0.0, -w.band), (end, -w.band)];
            auto.push(series("99 % band of white noise", Mark::Dashed, own().count(), band));
        }
        let figure = |id: &str, title: String, caption: &str, series| Figure {
            id: format!("{id}_{name}"),
            section: section::RESIDUAL.into(),
            title,
            caption: caption.into(),
            x_label: "lag / s".into(),
            y_label: "correlation".into(),
            series,
        };
        out.push(figure(
            "whiteness",
            format!("{name}: residual with itself"),
            "Autocorrelation of measured less simulated, averaged over 10 ms. A model that explains everything leaves white noise: all \
             lags within the band.",
            auto,
        ));
        out.push(figure(
            "inputs",
            format!("{name}: residual with the voltage before it"),
            "Cross-correlation of measured less simulated with the voltage, the voltage earlier by the lag. Beyond the band the residual \
             follows from the input: the model lacks something.",
            cross,
        ));
    }
    out
}

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let row = |w: &crate::whiteness::Whiteness| {
        let largest = w.cross.iter().max_by(|a, b| (a.largest / a.band).total_cmp(&(b.largest / b.band)));
        let mut row = vec![
            run_name(&w.run).to_string(),
            w.channel.to_string(),
            number(w.auto.first().copied().unwrap_or(0.0), 2),
            number(100.0 * w.beyond, 2),
            chance(w.p_white),
            if w.is_white() { "white" } else { "coloured" }.to_string(),
        ];
        row.push(largest.map_or("-".into(), |c| {
            format!("{} at {} s, {} of its band", c.input, number(c.at_s, 2), number(c.largest / c.band, 2))
        }));
        row.push(if w.is_independent() { "independent" } else { "follows an input" }.to_string());
        row
    };
    vec![Table {
        section: section::RESIDUAL.into(),
        title: "Residual analysis of the validation runs".into(),
        caption: "Of measured less simulated with the last model, averaged over 10 ms. White: Ljung and Box's test over 1 s of lags does \
                  not object at level 1 %. Independent: no correlation with an input before it beyond the band that colour of both \
                  allows in 99 % of runs."
            .into(),
        columns: ["run", "channel", "lag 1", "lags beyond 99 % / %", "p-value", "is", "largest with an input", "is"]
            .map(String::from)
            .to_vec(),
        rows: subject.whiteness.iter().map(row).collect(),
    }]
}
