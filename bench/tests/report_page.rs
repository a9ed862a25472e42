//! The report as a page: self-contained, escaped, reproducible. `report.html` of the synthetic figures is left in the
//! target directory's `tmp/` to be looked at in a browser.

use bench::report::{Report, render};
use identify::figure::{Figure, Mark, Series, Table};

fn series(name: &str, mark: Mark, group: usize, points: impl Iterator<Item = (f64, f64)>) -> Series {
    let (x, y) = points.unzip();
    Series { name: name.into(), mark, group, x, y }
}

fn figure(id: &str, section: &str, title: &str, labels: (&str, &str), series: Vec<Series>) -> Figure {
    Figure {
        id: id.into(),
        section: section.into(),
        title: title.into(),
        caption: format!("Counterpart of nothing: a synthetic figure to look at ({id})."),
        x_label: labels.0.into(),
        y_label: labels.1.into(),
        series,
    }
}

/// Shapes as the real report has them: a map with repeated abscissae and two kinds of series on different grids, a long time
/// series with a spike and a gap, a loop, more groups than the palette has colours, no data at all.
fn synthetic() -> Report {
    let map = (0..9)
        .flat_map(|k| {
            let angle = -40.0 + 10.0 * k as f64;
            let torque = move |dp: f64| (-1.6 * dp.abs() - 4.0) * angle.to_radians() + 6.8 * dp;
            let data = (0..28).map(move |i| {
                let dp = -3.0 + (i % 7) as f64;
                (dp, torque(dp) + ((i * 37) % 11) as f64 * 0.06 - 0.3)
            });
            let model = (0..61).map(move |i| (-3.2 + 0.107 * i as f64, torque(-3.2 + 0.107 * i as f64)));
            [
                series(&format!("data {angle:.0} deg"), Mark::Points, k, data),
                series(&format!("model {angle:.0} deg"), Mark::Line, k, model),
            ]
        })
        .collect();
    let time = |i: usize| i as f64 * 1e-3;
    let wave = |t: f64, lag: f64| if ((t - lag) / 2.0).floor() as i64 % 2 == 0 { 1.0 } else { -1.0 } * (1.0 + 0.2 * (t * 40.0).sin());
    let mut measured: Vec<(f64, f64)> =
        (0..60_000).map(|i| (time(i), 3.0 + wave(time(i), 0.0) + ((i * 7919) % 97) as f64 * 1e-3)).collect();
    measured[31_415].1 = 7.5;
    measured[20_000..23_000].iter_mut().for_each(|p| p.1 = f64::NAN);
    let long = vec![
        series("p1 measured", Mark::Points, 0, measured.into_iter()),
        series("p1 before", Mark::Dashed, 0, (0..6_000).map(|i| (i as f64 * 1e-2, 3.0 + wave(i as f64 * 1e-2, 0.2)))),
        series(
            "p1 after",
            Mark::Line,
            0,
            (0..60_000).map(|i| (time(i), if i > 45_000 && i < 46_000 { f64::NAN } else { 3.0 + wave(time(i), 0.0) })),
        ),
        series("p2 after", Mark::Line, 1, (0..60_000).map(|i| (time(i), 3.0 - wave(time(i), 0.0)))),
    ];
    let turn = |i: usize| i as f64 / 500.0 * std::f64::consts::TAU;
    let many = (0..12)
        .map(|g| series(&format!("group {g}"), Mark::Line, g, (0..2).map(move |i| (i as f64, g as f64))))
        .collect();
    Report {
        title: "Synthetic <campaign> & co".into(),
        headline: vec![
            "The residual is attributed to pump_lag (probability 0.98).".into(),
            "Validation error of the angle: 1.31 deg before, 0.06 deg after, noise floor 0.05 deg.".into(),
            "</header><script>alert(1)</script>".into(),
        ],
        figures: vec![
            figure("torque_map", "Identification", "Torque map", ("Δp / bar", "M / Nm"), map),
            figure("square_h", "Validation", "Square wave, horizontal", ("t / s", "p / bar"), long),
            figure(
                "loop",
                "Identification",
                "Loop",
                ("φ / deg", "M / Nm"),
                vec![series(
                    "loop",
                    Mark::Line,
                    2,
                    (0..1500).map(|i| (turn(i).cos() * (1.0 - i as f64 / 2000.0), turn(i).sin())),
                )],
            ),
            figure("many", "Identification", "More groups than colours", ("x", "y"), many),
            figure(
                "none",
                "Validation",
                "No data",
                ("x", "y"),
                vec![series("empty", Mark::Line, 0, std::iter::empty())],
            ),
            figure(
                "none",
                "Validation",
                "One value </script>",
                ("x", "y"),
                vec![series("</script><script>alert(2)//", Mark::Points, 0, [(5.0, 5.0)].into_iter())],
            ),
        ],
        tables: vec![
            Table {
                section: "Validation".into(),
                title: "Error before and after".into(),
                caption: "RMSE in free run.".into(),
                columns: ["run", "channel", "before", "after", "noise floor"].map(String::from).to_vec(),
                rows: vec![
                    ["square_h", "angle_deg", "1.31", "0.06", "0.05"].map(String::from).to_vec(),
                    ["square_v", "pressure1_bar", "0.21", "0.011", "0.010"].map(String::from).to_vec(),
                ],
            },
            Table {
                section: "Result".into(),
                title: "Parameters".into(),
                caption: String::new(),
                columns: ["name", "value <unit>"].map(String::from).to_vec(),
                rows: vec![
                    ["m1".into(), "-1.6".into()].to_vec(),
                    ["\"><img src=x onerror=alert(3)>".into(), "".into()].to_vec(),
                ],
            },
        ],
    }
}

#[test]
fn the_page_is_reproducible_and_left_to_be_looked_at() {
    let page = render(&synthetic());
    assert_eq!(page, render(&synthetic()));
    std::fs::write(concat!(env!("CARGO_TARGET_TMPDIR"), "/report.html"), page)
        .expect("the target directory is writable");
}

#[test]
fn the_page_loads_nothing_from_outside() {
    let page = render(&synthetic());
    for attribute in ["src=\"", "src='", "@import", "url(", "fetch(", "href=\"http", "href=\"//", "import("] {
        assert!(!page.contains(attribute), "{attribute} in the page");
    }
    assert!(page.contains("default-src 'none'"), "the browser itself is told to load nothing");
    assert!(page.contains("Permission is hereby granted"), "uPlot's licence goes with its code");
}

#[test]
fn hostile_texts_stay_texts() {
    let page = render(&synthetic());
    // Exactly the page's own three script elements, opened and closed.
    assert_eq!(page.matches("<script").count(), 3);
    assert_eq!(page.matches("</script").count(), 3);
    assert!(!page.contains("<img"));
    assert!(page.contains("Synthetic &lt;campaign&gt; &amp; co"));
}

#[test]
fn sections_anchors_and_figures_fit_together() {
    let page = render(&synthetic());
    let heads: Vec<&str> = page.split("<h2 id=\"").skip(1).map(|s| &s[..s.find('<').expect("closed")]).collect();
    assert_eq!(heads, ["section-1\">Result", "section-2\">Identification", "section-3\">Validation"]);
    for i in 1..=3 {
        assert_eq!(page.matches(&format!("href=\"#section-{i}\"")).count(), 1);
    }
    for id in ["figure-none\"", "figure-none-2\""] {
        assert_eq!(page.matches(id).count(), 1, "{id}");
    }
    for i in 0..6 {
        assert_eq!(page.matches(&format!("data-figure=\"{i}\"")).count(), 1);
    }
    let position = |text: &str| page.find(text).expect(text);
    assert!(
        position("Error before and after") < position("Square wave, horizontal"),
        "tables before the figures of a section"
    );
    assert!(
        position("id=\"figure-loop\"") < position("id=\"figure-square_h\""),
        "figures of one section stand together"
    );
}

#[test]
fn the_data_in_the_page_are_the_figures_data() {
    let page = render(&synthetic());
    let start = page.find("id=\"figures\">").expect("data element") + "id=\"figures\">".len();
    let json = &page[start..start + page[start..].find("</script>").expect("closed")];
    let figures: serde_json::Value = serde_json::from_str(json).expect("valid JSON");
    assert_eq!(figures.as_array().map(Vec::len), Some(6));
    assert_eq!(figures[0]["series"].as_array().map(Vec::len), Some(18));
    let spike = figures[1]["series"][0]["y"].as_array().expect("ordinates").iter().any(|v| v == 7.5);
    assert!(spike, "the spike of one sample in 60 000 is in the page");
    assert_eq!(figures[5]["series"][0]["name"], "</script><script>alert(2)//");
}

#[test]
fn lengths_that_differ_are_said_in_the_page() {
    let mut report = synthetic();
    report.figures[2].series[0].y.truncate(7);
    assert!(
        render(&report).contains("Series loop: 1500 abscissae but 7 ordinates; only the first 7 values are drawn.")
    );
    assert!(!render(&synthetic()).contains("class=\"fault\">Series"));
}
