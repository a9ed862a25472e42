//! Curves of the last seconds: what is controlled against what is asked for, then the others.

use super::Look;
use super::theme::{Theme, legend};
use crate::monitor::history::{History, Stroke, Trace};
use crate::monitor::state::State;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType};
use rt_core::TargetKind;

/// Rows of a picture, its title included: fewer say nothing.
const LEAST_ROWS: u16 = 6;
/// Room that is left above and below the curves, as part of their range.
const MARGIN: f64 = 0.05;

/// A picture.
struct Plot {
    title: &'static str,
    unit: &'static str,
    curves: Vec<(Trace, &'static str)>,
    /// The kind of target that is drawn, too.
    target: Option<TargetKind>,
}

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, state: &State, look: &Look, theme: &Theme) {
    let room = usize::from(area.height / LEAST_ROWS);
    if room == 0 || area.width == 0 {
        return;
    }
    let mut plots = plots(state, look.window_s());
    if plots.is_empty() {
        return;
    }
    let count = plots.len();
    plots.rotate_left(look.turned % count);
    plots.truncate(room);
    let areas = Layout::vertical(plots.iter().map(|_| Constraint::Fill(1))).split(area);
    for (plot, area) in plots.iter().zip(areas.iter()) {
        render(frame, *area, plot, &state.history, look, theme);
    }
}

/// What there is to draw, what is controlled first.
fn plots(state: &State, window_s: f64) -> Vec<Plot> {
    let Some(run) = &state.run else { return Vec::new() };
    let mut plots = Vec::new();
    let controlled = run.newest.target().map(|(kind, _)| kind);
    if let Some(kind) = controlled {
        let curves = Trace::actual(kind).map(|trace| (trace, actual_name(kind))).into_iter().collect();
        plots.push(Plot { title: kind.name(), unit: kind.unit(), curves, target: Some(kind) });
    }
    let has = |trace: Trace| state.history.span(trace, 0, window_s).is_some();
    let shown = |trace: Trace| controlled.and_then(Trace::actual) == Some(trace);
    let mut add = |title, unit, curves: Vec<(Trace, &'static str)>| {
        if curves.iter().any(|(trace, _)| has(*trace)) && !curves.iter().all(|(trace, _)| shown(*trace)) {
            plots.push(Plot { title, unit, curves, target: None });
        }
    };
    add("pressures", "bar", vec![(Trace::Pressure1, "chamber 1"), (Trace::Pressure2, "chamber 2")]);
    add("angle", "deg", vec![(Trace::Angle, "measured")]);
    add("voltage", "V", vec![(Trace::Voltage, "commanded")]);
    add("torque", "Nm", vec![(Trace::Torque, "measured")]);
    add("volume", "ml", vec![(Trace::Volume, "measured")]);
    if state.timing.summary().is_some() {
        add("lateness", "ms", vec![(Trace::Lateness, "wake-up")]);
    }
    plots
}

fn actual_name(kind: TargetKind) -> &'static str {
    if kind == TargetKind::Voltage { "commanded" } else { "measured" }
}

struct Curve {
    name: &'static str,
    strokes: Vec<Stroke>,
    style: Style,
    marker: Marker,
}

fn render(frame: &mut Frame<'_>, area: Rect, plot: &Plot, history: &History, look: &Look, theme: &Theme) {
    let window_s = look.window_s();
    // Two dots a column.
    let columns = 2 * usize::from(area.width);
    let mut curves = Vec::new();
    if let Some(kind) = plot.target {
        let (style, marker) = theme.target();
        let strokes = history.strokes(Trace::Target, kind.code(), window_s, columns);
        curves.push(Curve { name: "asked for", strokes, style, marker });
    }
    for (number, (trace, name)) in plot.curves.iter().enumerate() {
        let (style, marker) = theme.curve(number);
        curves.push(Curve { name, strokes: history.strokes(*trace, 0, window_s, columns), style, marker });
    }
    let values = curves.iter().flat_map(|curve| curve.strokes.iter().flatten()).map(|(_, value)| *value);
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    let bounds = if low <= high { padded(low, high) } else { [0.0, 1.0] };
    let datasets = curves.iter().flat_map(|curve| {
        curve.strokes.iter().map(|stroke| {
            Dataset::default().marker(curve.marker).graph_type(GraphType::Line).style(curve.style).data(stroke)
        })
    });
    let mut title = vec![Span::styled(format!("{}, {} ", plot.title, plot.unit), theme.strong())];
    for curve in &curves {
        title.push(Span::styled(format!(" {} {}", legend(curve.marker), curve.name), curve.style));
    }
    let labels = [bounds[0], bounds[1]].map(|bound| label(bound, bounds[1] - bounds[0]));
    let chart = Chart::new(datasets.collect())
        .block(Block::new().title(Line::from(title)))
        .legend_position(None)
        .x_axis(Axis::default().bounds([-window_s, 0.0]))
        .y_axis(Axis::default().bounds(bounds).labels(labels).style(theme.quiet()));
    frame.render_widget(chart, area);
}

/// A range with some room around it, also where the curve is flat.
fn padded(low: f64, high: f64) -> [f64; 2] {
    let range = (high - low).max(1e-3 * low.abs().max(high.abs())).max(1e-6);
    let middle = (low + high) / 2.0;
    let half = range * (0.5 + MARGIN);
    [middle - half, middle + half]
}

/// As many digits as the range needs, at a fixed width: the curves must not jump sideways as it grows.
fn label(value: f64, range: f64) -> String {
    let digits = (1.0 - range.log10().floor()).clamp(0.0, 4.0) as usize;
    format!("{value:>9.digits$}")
}
