//! What a recording is, in lines for people.

use super::summary::Summary;

/// Whether it is good, in one sentence. `found`: what speaks against it.
pub fn verdict(found: &[String]) -> String {
    if found.is_empty() { "good".to_owned() } else { format!("NOT GOOD: {}", found.join("; ")) }
}

/// One line each: the run, its length, its loss, its timing, where it was made.
pub fn facts(summary: &Summary) -> Vec<String> {
    let Summary { run, samples, bytes, segments, steps, .. } = summary;
    let mut lines = vec![format!("run        {} ({}, {}, {})", run.name, run.protocol, run.role, run.plane)];
    let rate = summary.rate_hz().map_or(String::new(), |rate_hz| format!(" at {rate_hz:.1} Hz"));
    let begin =
        summary.span_s.filter(|(first_s, _)| *first_s > 0.0).map(|(first_s, _)| format!(" from {first_s:.3} s on"));
    let length = format!("{:.3} s{}, {samples} samples{rate}", summary.duration_s(), begin.unwrap_or_default());
    lines.push(format!("length     {length}, {segments} segments, {steps} steps, {}", size(*bytes)));
    lines.push(match &summary.certificate {
        Some(certificate) => format!("loss       {certificate}"),
        None => "loss       unknown: no certificate".to_owned(),
    });
    let us = |quantile: f64| summary.lateness_ns.value_at_quantile(quantile) as f64 * 1e-3;
    if summary.lateness_ns.max() == 0 {
        lines.push("time       virtual, or not recorded: no lateness".to_owned());
    } else {
        let lateness = format!(
            "p50 {:.0} us, p99 {:.0} us, p99.9 {:.0} us, longest {:.0} us",
            us(0.5),
            us(0.99),
            us(0.999),
            us(1.0)
        );
        lines.push(format!(
            "lateness   {lateness}; {} overruns, {} ticks passed over",
            summary.overruns, summary.skipped
        ));
    }
    if summary.waiting > 0 {
        lines.push(format!("operator   the run waited for a person in {} ticks", summary.waiting));
    }
    let host: Vec<_> = run.host.iter().map(|(name, text)| format!("{name} {text}")).collect();
    if !run.program.is_empty() || !host.is_empty() {
        lines.push(format!(
            "made by    {}{}{}",
            run.program,
            if host.is_empty() { "" } else { " on " },
            host.join(", ")
        ));
    }
    if !run.files.is_empty() {
        lines.push(format!("files      {}", run.files.keys().cloned().collect::<Vec<_>>().join(", ")));
    }
    for (name, text) in run.notes.iter().filter(|(_, text)| !text.contains('\n') && text.len() < 200) {
        lines.push(format!("note       {name}: {text}"));
    }
    lines
}

fn size(bytes: u64) -> String {
    match bytes {
        0..=9_999 => format!("{bytes} bytes"),
        10_000..=9_999_999 => format!("{:.1} kB", bytes as f64 * 1e-3),
        _ => format!("{:.1} MB", bytes as f64 * 1e-6),
    }
}
