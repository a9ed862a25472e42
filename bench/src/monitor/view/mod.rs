//! The picture: drawn from the state alone, so that every size and situation can be tested without a terminal.

mod plots;
mod status;
mod theme;
mod values;

use super::history::KEPT_S;
use super::state::{Phase, State};
use ratatui::Frame;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;
use recordings::Severity;
use std::time::Instant;
use theme::Theme;

/// Windows that the curves can show, s.
const WINDOWS_S: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 30.0, KEPT_S];
/// The one that is shown at first.
const FIRST_WINDOW: usize = 3;
/// Narrower, and there is no room for curves beside the values.
const WITH_PLOTS: u16 = 66;
/// Columns of the values.
const VALUES: u16 = 38;
/// Lower, and there is no room for anything but the head.
const WITH_BODY: u16 = 8;
/// Lower, and there is no room for happenings.
const WITH_HAPPENINGS: u16 = 20;

/// What the person at the terminal has chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    window: usize,
    /// The curves' order is turned on by so many.
    turned: usize,
    /// Keys may stop the run.
    control: bool,
    colour: bool,
}

impl Look {
    /// What is shown at first.
    pub fn new(control: bool, colour: bool) -> Look {
        Look { window: FIRST_WINDOW, turned: 0, control, colour }
    }

    /// A longer time in the curves.
    pub fn wider(&mut self) {
        self.window = (self.window + 1).min(WINDOWS_S.len() - 1);
    }

    /// A shorter time in the curves.
    pub fn narrower(&mut self) {
        self.window = self.window.saturating_sub(1);
    }

    /// The next curve first.
    pub fn turn(&mut self) {
        self.turned = self.turned.wrapping_add(1);
    }

    /// Whether keys may stop the run.
    pub fn controls(&self) -> bool {
        self.control
    }

    fn window_s(&self) -> f64 {
        WINDOWS_S[self.window]
    }
}

/// Draws everything.
pub fn draw(frame: &mut Frame<'_>, state: &State, look: &Look, now: Instant) {
    let theme = Theme::new(look.colour);
    let area = frame.area();
    let [head, body, timing, happenings, foot] = Layout::vertical(rows(area.height)).areas(area);
    frame.render_widget(Paragraph::new(header(state, &theme, now)), head);
    if let Some(run) = &state.run {
        let [left, right] = if area.width >= WITH_PLOTS {
            Layout::horizontal([Constraint::Length(VALUES), Constraint::Min(0)]).areas(body)
        } else {
            [body, Rect::ZERO]
        };
        values::draw(frame, left, run, &theme);
        plots::draw(frame, right, state, look, &theme);
        frame.render_widget(Paragraph::new(status::timing(state, run)), timing);
    }
    status::happenings(frame, happenings, state, &theme);
    frame.render_widget(Paragraph::new(footer(look, &theme)), foot);
}

/// Heights: head, body, timing, happenings, foot.
fn rows(height: u16) -> [Constraint; 5] {
    let body = Constraint::Min(0);
    let fixed = |rows: [u16; 4]| {
        let [head, timing, happenings, foot] = rows.map(Constraint::Length);
        [head, body, timing, happenings, foot]
    };
    if height < WITH_BODY {
        fixed([2, 0, 0, 0])
    } else if height < WITH_HAPPENINGS {
        fixed([2, 2, 0, 1])
    } else {
        // Of what a large terminal has more, a quarter.
        fixed([2, 2, 5 + (height.saturating_sub(24)) / 4, 1])
    }
}

fn header<'a>(state: &State, theme: &Theme, now: Instant) -> Vec<Line<'a>> {
    let phase = state.phase(now);
    let (badge, style, why) = match &phase {
        Phase::NoRunYet => {
            ("NO RUN YET", theme.badge(None), format!("waiting for a run of instance {:?}", state.instance))
        }
        Phase::Running => ("RUNNING", theme.badge(Some(Severity::Info)), String::new()),
        Phase::WaitsForPeople => {
            ("WAITS", theme.badge(Some(Severity::Warning)), "for the people at the rig".to_owned())
        }
        Phase::Tripped(why) => ("TRIPPED", theme.badge(Some(Severity::Error)), why.clone()),
        Phase::Ended(severity, how) => ("ENDED", theme.badge(Some(*severity)), how.clone()),
        Phase::Silent(silent) => {
            ("SILENT", theme.badge(Some(Severity::Warning)), format!("no samples for {:.1} s", silent.as_secs_f64()))
        }
        Phase::Gone(silent) => {
            let text = format!("no samples for {:.1} s, and nobody publishes", silent.as_secs_f64());
            ("GONE", theme.badge(Some(Severity::Error)), text)
        }
    };
    let mut first = vec![Span::styled(format!(" {badge} "), style), Span::raw(" ")];
    if !why.is_empty() {
        first.push(Span::styled(format!("{why}  "), theme.strong()));
    }
    let second = match &state.run {
        None => Line::from(format!("start one: bench run PROFILE --realtime --instance {}", state.instance)),
        Some(run) => {
            let what = run.description.as_ref().map_or_else(
                || "its service does not say what it is".to_owned(),
                |d| format!("{}, {}, {}, {}", d.name, d.protocol, d.role, d.plane),
            );
            first.push(Span::raw(format!("run {}: {what}; instance {}", run.newest.run, state.instance)));
            let step = run.description.as_ref().and_then(|d| d.step(run.newest.step));
            let step = step.map_or_else(String::new, |step| format!(": {step}"));
            Line::from(vec![
                Span::styled(format!("{:>10.3} s  ", run.newest.time_s()), theme.strong()),
                Span::raw(format!("segment {}, step {}{step}", run.newest.segment, run.newest.step)),
            ])
        }
    };
    vec![Line::from(first), second]
}

fn footer<'a>(look: &Look, theme: &Theme) -> Line<'a> {
    let mut keys = vec![
        ("q", "quit".to_owned()),
        ("+ -", format!("last {} s", look.window_s())),
        ("Tab", "next curve".to_owned()),
    ];
    if look.control {
        keys.push(("s", "stop".to_owned()));
        keys.push(("E", "EMERGENCY STOP".to_owned()));
    }
    let keys = keys.into_iter().flat_map(|(key, what)| {
        [Span::styled(format!(" {key} "), theme.key()), Span::styled(format!(" {what}  "), theme.quiet())]
    });
    Line::from(keys.collect::<Vec<_>>())
}

/// The picture as lines of text, without colour.
///
/// # Errors
/// The picture could not be drawn: a defect.
pub fn as_text(
    state: &State,
    look: &Look,
    now: Instant,
    width: u16,
    height: u16,
) -> Result<Vec<String>, std::io::Error> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).map_err(std::io::Error::other)?;
    terminal.draw(|frame| draw(frame, state, look, now)).map_err(std::io::Error::other)?;
    let buffer = terminal.backend().buffer();
    let line = |y: u16| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_owned();
    Ok((0..height).map(line).collect())
}

#[cfg(test)]
mod tests;
