//! The newest values with units, ages and validity, what the profile asks for, and the valves.

use super::theme::Theme;
use crate::monitor::state::Followed;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;
use recordings::Severity;
use rt_core::{Input, Limits, Sample, flags};

/// Part of a limit from which on a value is marked.
const NEAR: f64 = 0.9;

pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, run: &Followed, theme: &Theme) {
    let sample = &run.newest;
    let limits = run.description.as_ref().and_then(|d| d.limits.as_ref());
    let mut lines =
        vec![target(sample, theme), plain("voltage", sample.voltage_v, "V", voltage_style(sample, limits, theme))];
    let measured = [
        ("angle", Input::Angle, "deg"),
        ("pressure 1", Input::Pressure1, "bar"),
        ("pressure 2", Input::Pressure2, "bar"),
        ("torque", Input::Torque, "Nm"),
        ("volume", Input::Volume, "ml"),
    ];
    for (name, input, unit) in measured {
        lines.push(input_line(sample, name, input, unit, limits, theme));
        if input == Input::Pressure2 {
            let difference = sample.pressure1_bar - sample.pressure2_bar;
            lines.push(plain("p1 - p2", difference, "bar", Style::new()));
        }
    }
    lines.push(valves(sample, theme));
    lines.push(signs(sample, theme));
    // What matters most stands on top: a low area shows as much as it has room for.
    lines.truncate(area.height.into());
    frame.render_widget(Paragraph::new(lines), area);
}

fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:>10.3}") } else { format!("{:>10}", "-") }
}

fn plain<'a>(name: &'a str, value: f64, unit: &'a str, style: Style) -> Line<'a> {
    Line::from(vec![
        Span::raw(format!("{name:<11}")),
        Span::styled(number(value), style),
        Span::raw(format!(" {unit:<4}")),
    ])
}

fn target<'a>(sample: &Sample, theme: &Theme) -> Line<'a> {
    let Some((kind, value)) = sample.target() else { return Line::styled("asked for: nothing", theme.quiet()) };
    let (style, _) = theme.target();
    Line::from(vec![
        Span::raw(format!("{:<11}", "asked for")),
        Span::styled(number(value), style),
        Span::raw(format!(" {:<4} {}", kind.unit(), kind.name())),
    ])
}

fn voltage_style(sample: &Sample, limits: Option<&Limits>, theme: &Theme) -> Style {
    let near = limits.is_some_and(|limits| sample.voltage_v.abs() >= NEAR * limits.voltage_max_v);
    if near { theme.said(Severity::Warning) } else { theme.strong() }
}

/// Whether a value is near one of its limits.
fn is_near(input: Input, value: f64, limits: &Limits) -> bool {
    match input {
        Input::Angle => value.abs() >= NEAR * limits.angle_max_deg,
        Input::Pressure1 | Input::Pressure2 => {
            value >= NEAR * limits.pressure_max_bar || value * NEAR <= limits.pressure_min_bar
        }
        Input::Torque => value.abs() >= NEAR * limits.torque_max_nm,
        Input::Volume => false,
    }
}

fn input_line<'a>(
    sample: &Sample,
    name: &'a str,
    input: Input,
    unit: &'a str,
    limits: Option<&Limits>,
    theme: &Theme,
) -> Line<'a> {
    let value = sample.measurement().value(input);
    let wrong = sample.quality & input.bit() << 8 != 0;
    let near = limits.is_some_and(|limits| is_near(input, value, limits));
    let style = match (wrong, near) {
        (true, _) => theme.said(Severity::Error),
        (false, true) => theme.said(Severity::Warning),
        (false, false) => theme.strong(),
    };
    let (remark, remark_style) = if wrong {
        ("WRONG".to_owned(), theme.said(Severity::Error))
    } else if value.is_finite() {
        (age(sample.age_ns[input as usize]), theme.quiet())
    } else {
        (String::new(), theme.quiet())
    };
    let mut line = plain(name, value, unit, style);
    line.push_span(Span::styled(remark, remark_style));
    line
}

/// How old a value is; nothing where it was measured at the tick itself.
fn age(age_ns: u32) -> String {
    match age_ns {
        0 => String::new(),
        u32::MAX => "> 4 s old".to_owned(),
        1..100_000_000 => format!("{:.1} ms old", f64::from(age_ns) * 1e-6),
        _ => format!("{:.1} s old", f64::from(age_ns) * 1e-9),
    }
}

fn valves<'a>(sample: &Sample, theme: &Theme) -> Line<'a> {
    let state = |open: bool| Span::styled(if open { "OPEN  " } else { "closed" }, theme.strong());
    Line::from(vec![
        Span::raw("brake "),
        state(sample.brake_open()),
        Span::raw("  bypass "),
        state(sample.bypass_open()),
    ])
}

fn signs<'a>(sample: &Sample, theme: &Theme) -> Line<'a> {
    let shown = [
        (flags::TRIPPED, "tripped", Severity::Error),
        (flags::FAULT, "fault", Severity::Error),
        (flags::STOPPED, "stopped", Severity::Warning),
        (flags::OVERRUN, "overrun", Severity::Warning),
        (flags::WAITING, "waiting", Severity::Warning),
        (flags::SLEW_LIMITED, "slew-limited", Severity::Info),
        (flags::CONFIRMED, "confirmed", Severity::Info),
        (flags::LAST, "last", Severity::Info),
    ];
    let set = shown.into_iter().filter(|(bit, _, _)| sample.flags & bit != 0);
    let spans = set.map(|(_, name, severity)| Span::styled(format!("{name} "), theme.said(severity)));
    Line::from(spans.collect::<Vec<_>>())
}
