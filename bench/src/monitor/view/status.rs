//! Timing and loss of the run, and what happened.

use super::theme::{Theme, sign};
use crate::monitor::state::{Followed, State};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Paragraph};

pub(super) fn timing<'a>(state: &State, run: &Followed) -> Vec<Line<'a>> {
    let first = match state.timing.summary() {
        None => "virtual time: nothing is late".to_owned(),
        Some(summary) => format!(
            "lateness p50 {}, p99 {}, max {} (run {}); work p99 {}",
            duration(summary.lateness_p50_ns),
            duration(summary.lateness_p99_ns),
            duration(summary.lateness_max_ns),
            duration(summary.lateness_run_max_ns),
            duration(summary.work_p99_ns),
        ),
    };
    let overruns = state.timing.summary().map_or(0, |summary| summary.overruns);
    let second = format!(
        "{} samples, {} missed here; overruns {overruns}, ticks skipped {}; drivers heard {} ago",
        run.received,
        run.missed,
        run.newest.skipped,
        duration(run.newest.heartbeat_age_ns.into()),
    );
    vec![Line::from(first), Line::from(second)]
}

/// With a unit that suits it.
fn duration(ns: u64) -> String {
    match ns {
        0 => "0".to_owned(),
        1..10_000 => format!("{:.1} us", ns as f64 * 1e-3),
        10_000..1_000_000 => format!("{:.0} us", ns as f64 * 1e-3),
        1_000_000..1_000_000_000 => format!("{:.1} ms", ns as f64 * 1e-6),
        _ => format!("{:.1} s", ns as f64 * 1e-9),
    }
}

pub(super) fn happenings(frame: &mut Frame<'_>, area: Rect, state: &State, theme: &Theme) {
    if area.height == 0 {
        return;
    }
    let block = Block::new().borders(Borders::TOP).title(" happenings ");
    let rows = usize::from(block.inner(area).height);
    let line = |h: &&crate::monitor::happenings::Happening| {
        let style = theme.said(h.severity);
        let when = if h.run.is_some() { format!("{:>10.3} s ", h.time_s) } else { " ".repeat(13) };
        Line::from(vec![
            Span::styled(when, theme.quiet()),
            Span::styled(format!("{} {}", sign(h.severity), h.text), style),
        ])
    };
    let lines: Vec<Line<'_>> = state.latest(rows).iter().map(line).collect();
    frame.render_widget(Paragraph::new(lines).block(block), area);
}
