//! The figures as JSON for the page's script.

use super::decimate::{self, Drawn};
use identify::figure::{Figure, Mark, Series};
use serde::Serialize;

/// Steps that the range of a drawn axis is divided into at least: finer than any screen, also when zoomed in.
const STEPS: f64 = 1e6;

#[derive(Serialize)]
struct FigureData<'a> {
    x_label: &'a str,
    y_label: &'a str,
    series: Vec<SeriesData<'a>>,
}

#[derive(Serialize)]
struct SeriesData<'a> {
    name: &'a str,
    /// 0 points, 1 line, 2 dashed.
    mark: u8,
    group: usize,
    x: Vec<f64>,
    y: Vec<Option<f64>>,
}

/// A JSON array with one object a figure that can stand inside a `<script>` element: no `<` in it.
pub fn json(figures: &[Figure]) -> String {
    let data: Vec<FigureData> = figures
        .iter()
        .map(|f| FigureData {
            x_label: &f.x_label,
            y_label: &f.y_label,
            series: f.series.iter().map(series_data).collect(),
        })
        .collect();
    let json = serde_json::to_string(&data).expect("plain data with string keys has a JSON form");
    // Inside a JSON text `<` stands in strings only, where its escape means the same.
    json.replace('<', "\\u003c").replace('\u{2028}', "\\u2028").replace('\u{2029}', "\\u2029")
}

fn series_data(series: &Series) -> SeriesData<'_> {
    let Drawn { mut x, mut y } = decimate::for_display(series);
    let round_x = Rounding::for_range(x.iter().copied());
    let round_y = Rounding::for_range(y.iter().flatten().copied());
    x.iter_mut().for_each(|v| *v = round_x.of(*v));
    y.iter_mut().flatten().for_each(|v| *v = round_y.of(*v));
    let mark = match series.mark {
        Mark::Points => 0,
        Mark::Line => 1,
        Mark::Dashed => 2,
    };
    SeriesData { name: &series.name, mark, group: series.group, x, y }
}

/// Rounds to a power of ten fine enough for the range of the values, which makes their decimal form short.
struct Rounding {
    /// Values are rounded to multiples of 10^-decimals.
    decimals: i32,
}

impl Rounding {
    fn for_range(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let span = high - low;
        // One value, or a span beyond the numbers' range: as it is.
        let decimals = if span > 0.0 && span.is_finite() { -(span / STEPS).log10().floor() as i32 } else { i32::MAX };
        Rounding { decimals }
    }

    fn of(&self, value: f64) -> f64 {
        // Dividing by a whole power of ten rounds correctly, so the shortest decimal form is the short one. Beyond 1e15
        // steps the value's own resolution is coarser than the rounding.
        let rounded = if (0..=18).contains(&self.decimals) {
            let scale = 10f64.powi(self.decimals);
            let steps = (value * scale).round();
            if steps.abs() < 1e15 { steps / scale } else { value }
        } else if (-300..0).contains(&self.decimals) {
            let step = 10f64.powi(-self.decimals);
            (value / step).round() * step
        } else {
            value
        };
        rounded + 0.0 // no -0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded(values: &[f64]) -> Vec<f64> {
        let r = Rounding::for_range(values.iter().copied());
        values.iter().map(|&v| r.of(v)).collect()
    }

    #[test]
    fn rounding_stays_below_a_millionth_of_the_range_at_any_scale() {
        for scale in [1e-20, 1e-9, 1e-3, 1.0, 60.0, 1e7, 1e12, 1e200] {
            for offset in [0.0, -0.3, 17.0] {
                let values: Vec<f64> = (0..1000).map(|i| scale * (offset + (i as f64 * 0.7).sin())).collect();
                for (v, r) in values.iter().zip(rounded(&values)) {
                    assert!((v - r).abs() <= 2.1 * scale / STEPS, "{v} became {r} at scale {scale}");
                }
            }
        }
    }

    #[test]
    fn rounding_shortens_the_text() {
        let values: Vec<f64> = (0..100).map(|i| i as f64 / 3.0).collect();
        for text in rounded(&values).iter().map(|v| v.to_string()) {
            assert!(text.len() <= 9, "{text}");
        }
        assert_eq!(rounded(&[-1e-12, 1.0])[0].to_string(), "0");
        assert_eq!(rounded(&[0.123456789012345]), vec![0.123456789012345], "a single value stays");
    }

    #[test]
    fn a_break_is_null() {
        let figure = Figure {
            id: "f".into(),
            section: "s".into(),
            title: "t".into(),
            caption: "c".into(),
            x_label: "t / s".into(),
            y_label: "p / bar".into(),
            series: vec![Series {
                name: "a</script>".into(),
                mark: Mark::Dashed,
                group: 3,
                x: vec![0.0, 1.0, 2.0],
                y: vec![1.5, f64::NAN, 2.5],
            }],
        };
        assert_eq!(
            json(&[figure]),
            r#"[{"x_label":"t / s","y_label":"p / bar","series":[{"name":"a\u003c/script>","mark":2,"group":3,"x":[0.0,0.0,2.0],"y":[1.5,null,2.5]}]}]"#
        );
    }
}
