//! `bench info RECORDING|CAMPAIGN [--json] [--page OUT.html]`

use crate::exchange::output::{Output, unwritten};
use crate::failure::{Failure, Kind};
use crate::look::page::page;
use crate::look::plot::braille;
use crate::look::summary::Summary;
use crate::look::words::{facts, verdict};
use crate::progress::Progress;
use recordings::{Campaign, Protocol, Recording};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Width and height of a plot in characters.
const PLOT: (usize, usize) = (72, 4);
/// Events that are listed.
const EVENTS_LISTED: usize = 12;

/// What a recording holds and whether it is good: run, loss, channels, events, lateness, a plot
///
/// The first line says it. Exit code 0 where every recording is good, 3 where one is not: unfinished, damaged, with losses, tripped,
/// stopped.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings (.mcap, .mcap.part), or a campaign folder
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// For scripts
    #[arg(long, conflicts_with = "page")]
    json: bool,
    /// Write a page with zoomable figures (of one recording)
    #[arg(long, value_name = "OUT.html")]
    page: Option<PathBuf>,
    /// No plot
    #[arg(long)]
    no_plot: bool,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let files = files(&args.paths)?;
    if args.page.is_some() && files.len() != 1 {
        let message = format!("--page: expected one recording, got {}", files.len());
        return Err(Failure::new(Kind::Input, message));
    }
    let mut bad = Vec::new();
    let mut all = Vec::new();
    for (index, file) in files.iter().enumerate() {
        let summary = Summary::read(file).map_err(|e| Failure::of(Kind::Input, &e))?;
        let found = summary.faults_found();
        if args.json {
            all.push(as_json(&summary, &found));
        } else {
            if index > 0 {
                progress.result("");
            }
            show(&summary, &found, args.no_plot).iter().for_each(|line| progress.result(line));
        }
        if let Some(target) = &args.page {
            write_page(&summary, &found, target)?;
            progress.result(&format!("written: {}", target.display()));
        }
        if let Some(first) = found.first() {
            bad.push(format!("{}: {first}", file.display()));
        }
    }
    if args.json {
        let text = serde_json::to_string_pretty(&Value::Array(all)).map_err(|e| Failure::of(Kind::Internal, &e))?;
        progress.result(&text);
    }
    if bad.is_empty() { Ok(()) } else { Err(Failure::new(Kind::Acceptance, bad.join("\n"))) }
}

/// The recordings; a campaign's in its order.
fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            let name = path.to_string_lossy();
            if path.exists() && (name.ends_with(".csv") || name.ends_with(".csv.gz")) {
                let message = format!(
                    "{name}: expected a recording (.mcap), got a CSV run; `bench import {name} --protocol P --role R --plane P --out RUN.mcap` makes a recording of it"
                );
                return Err(Failure::new(Kind::Input, message));
            }
            files.push(path.clone());
            continue;
        }
        let campaign = Campaign::open(path).map_err(|e| Failure::of(Kind::Input, &e))?;
        let (mcap, other): (Vec<_>, Vec<_>) = campaign.runs.iter().partition(|run| run.file.ends_with(".mcap"));
        if let Some(run) = other.first() {
            let message = format!(
                "{}: expected a campaign of MCAP recordings, got {:?}; `bench import {} --out FOLDER` makes recordings of CSV runs",
                path.display(),
                run.file,
                path.display()
            );
            return Err(Failure::new(Kind::Input, message));
        }
        files.extend(mcap.iter().map(|run| path.join(&run.file)));
    }
    Ok(files)
}

fn show(summary: &Summary, found: &[String], no_plot: bool) -> Vec<String> {
    let mut lines = vec![format!("{}: {}", summary.path.display(), verdict(found))];
    lines.extend(facts(summary).iter().map(|fact| format!("  {fact}")));
    lines.extend(channels(summary));
    lines.extend(strokes(summary, found));
    lines.extend(events(summary));
    if !no_plot {
        lines.extend(plots(summary));
    }
    lines
}

fn channels(summary: &Summary) -> Vec<String> {
    let mut lines =
        vec![format!("  {:<16} {:>9} {:>11} {:>11} {:>11}", "channel", "values", "lowest", "mean", "highest")];
    let reports = summary.amplifier.iter().filter(|channel| channel.count > 0);
    for channel in summary.channels.iter().chain(reports) {
        lines.push(if channel.count == 0 {
            format!("  {:<16} {:>9}", channel.name, "none")
        } else {
            let (low, mean, high) = (channel.low, channel.mean(), channel.high);
            format!("  {:<16} {:>9} {low:>11.4} {mean:>11.4} {high:>11.4}", channel.name, channel.count)
        });
    }
    lines
}

/// Intervals of steady velocity, as the identification finds them.
fn strokes(summary: &Summary, found: &[String]) -> Vec<String> {
    if summary.run.protocol != Protocol::ConstantFlow || !found.is_empty() {
        return Vec::new();
    }
    let Ok(recording) = Recording::read(&summary.path, Protocol::ConstantFlow) else { return Vec::new() };
    let all = identify::strokes::strokes(&recording);
    let steady = all.iter().filter(|stroke| stroke.steady.is_some()).count();
    let mut lines = vec![format!("  strokes with an interval of steady velocity: {steady} of {}", all.len())];
    for stroke in &all {
        let (begin_s, end_s) = stroke.span_s;
        let segment = format!("    segment {:>4}, {begin_s:>8.2} .. {end_s:>8.2} s", stroke.segment);
        lines.push(match &stroke.steady {
            Some(steady) => format!(
                "{segment}: {:>8.3} deg/s from {:.2} to {:.2} s, {:.1} to {:.1} deg, steady within {:.1} %",
                steady.velocity_deg_s,
                steady.span_s.0,
                steady.span_s.1,
                steady.angle_deg.0,
                steady.angle_deg.1,
                100.0 * steady.deviation
            ),
            None => format!("{segment}: no steady interval"),
        });
    }
    lines
}

fn events(summary: &Summary) -> Vec<String> {
    let [info, warning, error] = summary.event_counts;
    let all = info + warning + error;
    let mut lines = vec![format!("  events: {all} ({error} errors, {warning} warnings)")];
    for (time_s, word, source, text) in summary.event_rows().take(EVENTS_LISTED) {
        lines.push(format!("    {time_s:>9.3} s  {word:<8} {source}: {}", text.replace('\n', " / ")));
    }
    let listed = summary.events.len().min(EVENTS_LISTED) as u64;
    if all > listed {
        lines.push(format!("    and {} more: `bench export --events`", all - listed));
    }
    lines
}

fn plots(summary: &Summary) -> Vec<String> {
    let mut lines = Vec::new();
    for channel in summary.channels.iter().filter(|channel| channel.count > 0 && channel.high > channel.low) {
        let rows = braille(&channel.curve, PLOT.0, PLOT.1);
        let last = rows.len().saturating_sub(1);
        lines.push(format!("  {}", channel.name));
        for (index, row) in rows.iter().enumerate() {
            let label = match index {
                0 => format!("{:>10.3}", channel.high),
                _ if index == last => format!("{:>10.3}", channel.low),
                _ => " ".repeat(10),
            };
            lines.push(format!("  {label} {row}"));
        }
    }
    let axis = summary.span_s.filter(|_| !lines.is_empty());
    lines.extend(
        axis.map(|(first_s, last_s)| format!("  {:>10} {first_s:<10.1}{:>w$.1} s", "", last_s, w = PLOT.0 - 12)),
    );
    lines
}

fn write_page(summary: &Summary, found: &[String], target: &Path) -> Result<(), Failure> {
    let mut output = Output::create(target)?;
    let text = page(summary, &verdict(found), &facts(summary));
    output.write_all(text.as_bytes()).map_err(|e| unwritten(target, &e))?;
    output.commit().map(drop)
}

fn as_json(summary: &Summary, found: &[String]) -> Value {
    let run = &summary.run;
    let channel = |channel: &crate::look::summary::Channel| {
        // A number that is not finite becomes null.
        let (low, mean, high) = (channel.low, channel.mean(), channel.high);
        json!({"name": channel.name, "values": channel.count, "lowest": low, "mean": mean, "highest": high})
    };
    let ns = |quantile: f64| summary.lateness_ns.value_at_quantile(quantile);
    let events = summary.event_rows().map(|(time_s, severity, source, text)| {
        json!({"time_s": time_s, "severity": severity, "source": source, "text": text})
    });
    json!({
        "file": summary.path.display().to_string(),
        "good": found.is_empty(),
        "findings": found,
        "name": run.name,
        "protocol": run.protocol.as_str(),
        "role": run.role.as_str(),
        "plane": run.plane.as_str(),
        "program": run.program,
        "host": run.host,
        "files": run.files.keys().collect::<Vec<_>>(),
        "notes": run.notes,
        "bytes": summary.bytes,
        "samples": summary.samples,
        "duration_s": summary.duration_s(),
        "rate_hz": summary.rate_hz(),
        "closed": summary.certificate.is_some(),
        "lossless": summary.certificate.as_ref().map(rt_core::LossCertificate::is_lossless),
        "expected": summary.certificate.as_ref().map(|certificate| certificate.expected),
        "gaps": summary.certificate.as_ref().map(|certificate| certificate.gaps.clone()),
        "segments": summary.segments,
        "steps": summary.steps,
        "lateness_ns": {"p50": ns(0.5), "p99": ns(0.99), "p999": ns(0.999), "longest": ns(1.0)},
        "overruns": summary.overruns,
        "passed_over": summary.skipped,
        "tripped_s": summary.tripped.map(|(time_s, _)| time_s),
        "stopped_s": summary.stopped_s,
        "device_faults": summary.faults,
        "channels": summary.channels.iter().chain(&summary.amplifier).map(channel).collect::<Vec<_>>(),
        "amplifier_reports": summary.reports,
        "event_counts": {"info": summary.event_counts[0], "warning": summary.event_counts[1], "error": summary.event_counts[2]},
        "events": events.collect::<Vec<_>>(),
    })
}
