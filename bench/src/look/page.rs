//! A recording as one HTML file, with the parts of the identification's report.

use super::curve::Curve;
use super::summary::{Channel, Summary};
use crate::report::{Report, render};
use identify::figure::{Figure, Mark, Series, Table};

/// The page. `good`: the verdict in one sentence.
pub fn page(summary: &Summary, good: &str, facts: &[String]) -> String {
    let table = |title: &str, columns: &[&str], rows: Vec<Vec<String>>| Table {
        section: "Recording".to_owned(),
        title: title.to_owned(),
        caption: String::new(),
        columns: columns.iter().map(|column| (*column).to_owned()).collect(),
        rows,
    };
    let channels = summary.channels.iter().chain(&summary.amplifier).filter(|channel| channel.count > 0);
    let channel_rows = channels.map(|channel| {
        let numbers = [channel.low, channel.mean(), channel.high].map(|value| format!("{value:.4}"));
        [channel.name.to_owned(), channel.count.to_string()].into_iter().chain(numbers).collect()
    });
    let events = summary.event_rows().map(|(time_s, word, source, text)| {
        vec![format!("{time_s:.3}"), word.to_owned(), source.to_owned(), text.to_owned()]
    });
    let run = &summary.run;
    let texts = run.notes.iter().chain(&run.host).chain(&run.files);
    let said = [("program", &run.program), ("calibration", &run.calibration), ("profile", &run.profile)];
    let said = said.into_iter().map(|(name, text)| (name.to_owned(), text)).chain(texts.map(|(n, t)| (n.clone(), t)));
    let said = said.filter(|(_, text)| !text.is_empty()).map(|(name, text)| vec![name, text.clone()]);
    let report = Report {
        title: format!("Recording {}", run.name),
        headline: [good.to_owned()].into_iter().chain(facts.iter().cloned()).collect(),
        figures: figures(summary),
        tables: vec![
            table("Channels", &["channel", "values", "lowest", "mean", "highest"], channel_rows.collect()),
            table("Events", &["t / s", "severity", "source", "text"], events.collect()),
            table("What the recording says of its run", &["name", "text"], said.collect()),
        ],
    };
    render(&report)
}

fn figures(summary: &Summary) -> Vec<Figure> {
    let titles = [
        ("angle", "Angle", "φ / deg", &["angle_deg"][..]),
        ("pressure", "Pressures", "p / bar", &["pressure1_bar", "pressure2_bar"]),
        ("voltage", "Voltage", "u / V", &["voltage_v"]),
        ("torque", "Torque", "M / Nm", &["torque_nm"]),
        ("volume", "Volume", "V / ml", &["volume_ml"]),
        ("speed", "Speed of the motor", "n / rpm", &["speed_rpm"]),
        ("current", "Motor current", "I / A", &["motor_current_a"]),
    ];
    let channels = || summary.channels.iter().chain(&summary.amplifier);
    let figure = |(id, title, y_label, names): (&str, &str, &str, &[&str])| {
        let shown: Vec<&Channel> =
            channels().filter(|channel| names.contains(&channel.name) && channel.count > 0).collect();
        (!shown.is_empty()).then(|| Figure {
            id: id.to_owned(),
            section: "Course".to_owned(),
            title: title.to_owned(),
            caption: "Lowest and highest value of each stretch of time.".to_owned(),
            x_label: "t / s".to_owned(),
            y_label: y_label.to_owned(),
            series: shown
                .iter()
                .enumerate()
                .map(|(group, channel)| series(channel.name, group, &channel.curve))
                .collect(),
        })
    };
    titles.into_iter().filter_map(figure).collect()
}

fn series(name: &str, group: usize, curve: &Curve) -> Series {
    let points = curve.stretches().iter().flat_map(|stretch| {
        // A stretch of one value is one point.
        let second = (stretch.high != stretch.low).then_some((stretch.begin_s, stretch.high));
        [Some((stretch.begin_s, stretch.low)), second].into_iter().flatten()
    });
    let (x, y) = points.unzip();
    Series { name: name.to_owned(), mark: Mark::Line, group, x, y }
}
