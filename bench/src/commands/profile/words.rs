//! What a profile would do, for people.

use super::outlook::{At, DryRun, Outlook, Value};
use crate::commands::results::aligned;
use std::collections::BTreeMap;

/// More requests than this are counted, not listed.
const LISTED: usize = 12;
/// So many time-outs of one line are told in full.
const TOLD: usize = 2;
/// Conditions are broken into lines of about this many characters.
const WIDE: usize = 60;

/// The lines of an outlook.
pub(super) fn text(outlook: &Outlook) -> Vec<String> {
    let Outlook { name, protocol, role, plane, about, dry_run, .. } = outlook;
    let mut lines = vec![format!("{name}: {protocol}, {role}, {plane}{}", prefixed(". ", about))];
    lines.push(String::new());
    lines.extend(steps(outlook));
    lines.push(String::new());
    lines.extend(outlook.preparation.clone());
    lines.extend(requests(outlook));
    if outlook.faults > 0 {
        lines.push(format!("faults: {} are injected", outlook.faults));
    }
    let by_dry_run =
        dry_run.as_ref().map_or_else(String::new, |dry| format!(", {:.3} s by the dry run", dry.duration_s));
    let people = if outlook.requests.is_empty() { "" } else { "; people take their own time" };
    lines.push(format!("duration: {:.3} .. {:.3} s{by_dry_run}{people}", outlook.shortest_s, outlook.longest_s));
    match dry_run {
        Some(dry) => lines.extend(prediction(dry)),
        None => lines.push(
            "NO DRY RUN: there is no model of this rig, so nothing is predicted: pressures, angle and velocity may reach any limit. \
             Name an identified one: --model model.toml, or [controller] model in the rig file"
                .to_owned(),
        ),
    }
    lines
}

fn prefixed(before: &str, text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("{before}{text}") }
}

fn steps(outlook: &Outlook) -> Vec<String> {
    let mut rows = vec![["line", "step", "ends", "passes", "time s"].map(str::to_owned).to_vec()];
    if outlook.dry_run.is_none() {
        rows[0].truncate(3);
    }
    for step in &outlook.steps {
        let asked = if step.operator.is_empty() { String::new() } else { format!("; asks: {}", step.operator) };
        let what = format!("{}{}{asked}", "  ".repeat(step.depth), step.what);
        let mut ends = broken(&step.ends).into_iter();
        let mut row = vec![step.line.to_string(), what, ends.next().unwrap_or_default()];
        if let (Some(passes), Some(time_s)) = (step.passes, step.time_s) {
            row.extend([passes.to_string(), format!("{time_s:.3}")]);
        }
        rows.push(row);
        rows.extend(ends.map(|end| vec![String::new(), String::new(), end]));
    }
    aligned(&rows)
}

/// At the words "or", where it is long.
fn broken(text: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for (number, part) in text.split(" or ").enumerate() {
        let part = if number > 0 { format!("or {part}") } else { part.to_owned() };
        match lines.last_mut() {
            Some(line) if line.len() + part.len() < WIDE => {
                line.push(' ');
                line.push_str(&part);
            }
            _ => lines.push(part),
        }
    }
    lines
}

fn requests(outlook: &Outlook) -> Vec<String> {
    let requests = &outlook.requests;
    if requests.is_empty() {
        let why = if outlook.hands == "rig" { "the rig does that part itself" } else { "the script has none for them" };
        return vec![format!("operator: nothing is asked, {why}")];
    }
    let mut lines =
        vec![format!("operator: asked up to {} times; what is as wanted already is not asked", requests.len())];
    lines.extend(requests.iter().take(LISTED).map(|asked| {
        let amount = if asked.amount { ", with the volume in ml" } else { "" };
        format!("  {}: {}{amount}", place(&asked.place), asked.text)
    }));
    lines.extend(more(requests.len()));
    lines
}

fn more(number: usize) -> Option<String> {
    (number > LISTED).then(|| format!("  and {} more; --json lists them all", number - LISTED))
}

fn place(At { line, with }: &At) -> String {
    if with.is_empty() { format!("line {line}") } else { format!("line {line} ({with})") }
}

fn prediction(dry: &DryRun) -> Vec<String> {
    let mut lines = vec![format!("dry run on {}, without noise:", dry.model), String::new()];
    let mut rows = vec![["", "least", "at", "most", "at", "limits", "unit", "margin %"].map(str::to_owned).to_vec()];
    let at = |seen: &Value| format!("{:.3} s, {}", seen.time_s, place(&seen.place));
    rows.extend(dry.peaks.iter().map(|peak| {
        vec![
            peak.channel.to_owned(),
            format!("{:.3}", peak.least.value),
            at(&peak.least),
            format!("{:.3}", peak.most.value),
            at(&peak.most),
            format!("{} .. {}", limit(peak.limit_low), limit(peak.limit_high)),
            peak.unit.to_owned(),
            format!("{:.1}", peak.margin_percent),
        ]
    }));
    lines.extend(aligned(&rows));
    lines.push(String::new());
    lines.extend(timeouts(dry));
    lines.extend(dry.remarks.iter().cloned());
    if let Some(trip) = &dry.trip {
        lines.push(format!(
            "WOULD TRIP at {:.3} s in the step of {}: {}",
            trip.time_s,
            place(&trip.place),
            trip.message
        ));
    }
    if let Some(failed) = &dry.failed {
        lines.push(format!("WOULD FAIL: {failed}"));
    }
    if dry.trip.is_none() && dry.failed.is_none() {
        lines.push("within all limits".to_owned());
    }
    lines
}

/// The first of each line of the script; the others are counted.
fn timeouts(dry: &DryRun) -> Vec<String> {
    let mut by_line: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
    for struck in &dry.timeouts {
        by_line.entry(struck.place.line).or_default().push(&struck.message);
    }
    let mut lines = Vec::new();
    for (line, messages) in by_line {
        lines.extend(messages.iter().take(TOLD).map(|message| format!("time-out: {message}")));
        if messages.len() > TOLD {
            lines.push(format!("time-out: line {line}: {} times more; --json lists them all", messages.len() - TOLD));
        }
    }
    lines
}

/// Without the digits that come of a fraction times u_max.
fn limit(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    rounded.to_string()
}
