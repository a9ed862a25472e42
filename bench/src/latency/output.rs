//! What was measured: as JSON for programs, as tables and bars for people.

use crate::latency::measurement::{Group, Measured, Slice};
use crate::latency::plot;
use crate::latency::real_loop::STAGES;
use crate::latency::slices::{DISTURBED_FROM, SUBSCRIBERS};
use crate::latency::statistics::{Figures, Pool, Ratio};
use serde::Serialize;
use std::collections::BTreeMap;

/// Figures of a pool, us.
#[derive(Clone, Copy, Debug, Serialize)]
struct Pooled {
    #[serde(flatten)]
    figures: Figures,
    /// Median over slices of their p99.
    slice_p99: f64,
    /// How many durations there are.
    count: u64,
}

impl Pooled {
    fn of(pool: &Pool) -> Option<Pooled> {
        let slice_p99 = pool.slice_p99_us()?;
        Some(Pooled { figures: pool.all().figures(), slice_p99, count: pool.all().count() })
    }
}

/// The figures of a measurement. Durations in us; `None` where something was not measured.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Number of slices, of all kinds together.
    slices: usize,
    slice_s: f64,
    /// The loop's wake-ups, whatever the number of subscribers.
    lateness_us: Option<Pooled>,
    bare_us: Option<Pooled>,
    cyclictest_us: Option<Pooled>,
    /// Loop over bare loop.
    ratio: Ratio,
    /// Loop over cyclictest.
    ratio_cyclictest: Option<Ratio>,
    over_2ms: u64,
    over_2ms_bare: u64,
    over_2ms_cyclictest: Option<u64>,
    tick_us: Option<Pooled>,
    stages_us: BTreeMap<&'static str, Option<Pooled>>,
    publish_us: Option<Pooled>,
    /// From the loop's wake-up to the only subscriber.
    to_subscriber_us: Option<Pooled>,
    /// From the scheduled time to the only subscriber.
    scheduled_to_subscriber_us: Option<Pooled>,
    /// By number of subscribers.
    subscribers: BTreeMap<usize, GroupSummary>,
    skipped: u64,
    not_taken: u64,
    system: System,
    slice_figures: Vec<Slice>,
}

/// The loop with one number of subscribers.
#[derive(Clone, Debug, Serialize)]
struct GroupSummary {
    slices: usize,
    lateness_us: Option<Pooled>,
    /// Over the bare loop in the slices that follow.
    ratio: Ratio,
    /// p50, slice-median p99 and late wake-ups over those without subscribers.
    against_none: Ratio,
    over_2ms: u64,
    to_subscriber_us: Option<Pooled>,
    scheduled_to_subscriber_us: Option<Pooled>,
    /// Samples that the subscribers received which were neither stalled nor killed, and those that were published for them.
    received: u64,
    expected: u64,
}

/// What was asked of the system.
#[derive(Clone, Debug, Serialize)]
struct System {
    granted: BTreeMap<String, String>,
    refused: Vec<String>,
}

impl Summary {
    /// Draws the figures out of a measurement.
    pub fn of(measured: &Measured) -> Summary {
        let lateness = measured.lateness();
        let none = &measured.groups[0];
        let only = &measured.groups[SUBSCRIBERS.iter().position(|&n| n == 1).unwrap_or(0)];
        let cyclictest = (measured.cyclictest.slices() > 0).then_some(&measured.cyclictest);
        let reports = [&measured.process, &measured.thread];
        let stages = STAGES.iter().zip(&measured.stages);
        let groups = SUBSCRIBERS.iter().zip(&measured.groups);
        Summary {
            slices: measured.slices.len(),
            slice_s: measured.plan.slice_s(),
            lateness_us: Pooled::of(&lateness),
            bare_us: Pooled::of(&measured.bare),
            cyclictest_us: Pooled::of(&measured.cyclictest),
            ratio: Ratio::of(&lateness, &measured.bare),
            ratio_cyclictest: cyclictest.map(|cyclictest| Ratio::of(&lateness, cyclictest)),
            over_2ms: lateness.all().late(),
            over_2ms_bare: measured.bare.all().late(),
            over_2ms_cyclictest: cyclictest.map(|pool| pool.all().late()),
            tick_us: Pooled::of(&measured.tick),
            stages_us: stages.map(|(name, pool)| (*name, Pooled::of(pool))).collect(),
            publish_us: Pooled::of(&measured.publish),
            to_subscriber_us: Pooled::of(&only.to_subscriber),
            scheduled_to_subscriber_us: Pooled::of(&only.scheduled_to_subscriber),
            subscribers: groups.map(|(n, group)| (*n, GroupSummary::of(group, none))).collect(),
            skipped: measured.skipped,
            not_taken: measured.not_taken,
            system: System {
                granted: reports.iter().flat_map(|report| report.notes()).collect(),
                refused: reports.iter().flat_map(|r| r.refused()).map(|refusal| refusal.to_string()).collect(),
            },
            slice_figures: measured.slices.clone(),
        }
    }

    /// One JSON object.
    pub fn json(&self) -> String {
        serde_json::to_string_pretty(self).expect("names and numbers always have a JSON form")
    }
}

impl GroupSummary {
    fn of(group: &Group, none: &Group) -> GroupSummary {
        GroupSummary {
            slices: group.lateness.slices(),
            lateness_us: Pooled::of(&group.lateness),
            ratio: Ratio::of(&group.lateness, &group.bare),
            against_none: Ratio::of(&group.lateness, &none.lateness),
            over_2ms: group.lateness.all().late(),
            to_subscriber_us: Pooled::of(&group.to_subscriber),
            scheduled_to_subscriber_us: Pooled::of(&group.scheduled_to_subscriber),
            received: group.received,
            expected: group.expected,
        }
    }
}

/// Table and bars, line by line.
pub fn lines(measured: &Measured) -> Vec<String> {
    let summary = Summary::of(measured);
    let lateness = measured.lateness();
    let mut lines = table(measured, &summary, &lateness);
    let mut columns = vec![("loop", lateness.all()), ("bare loop", measured.bare.all())];
    if measured.cyclictest.slices() > 0 {
        columns.push(("cyclictest", measured.cyclictest.all()));
    }
    let named: Vec<String> = SUBSCRIBERS.iter().map(|n| subscribers(*n)).collect();
    let heard = named.iter().zip(&measured.groups).filter(|(_, group)| group.to_subscriber.slices() > 0);
    let heard: Vec<_> = heard.map(|(name, group)| (name.as_str(), group.to_subscriber.all())).collect();
    let work = [("tick", measured.tick.all()), ("hand-over", measured.publish.all())];
    for (title, columns) in [("lateness, us", &columns[..]), ("work, us", &work), ("to subscriber, us", &heard)] {
        lines.push(String::new());
        lines.extend(plot::histogram(title, columns));
    }
    lines
}

fn table(measured: &Measured, summary: &Summary, lateness: &Pool) -> Vec<String> {
    let loop_slices = lateness.slices();
    let mut lines = vec![
        format!(
            "{} slices of {:.3} s in turns, {loop_slices} of them the loop's; durations in us",
            summary.slices, summary.slice_s
        ),
        format!("{:<36}{:>9}{:>9}{:>9}{:>10}{:>11}{:>11}", "", "p50", "p99", "p99.9", "max", "slice p99", "over 2 ms"),
        "lateness of the wake-up".to_owned(),
        row("loop", lateness, true),
    ];
    for (n, group) in SUBSCRIBERS.iter().zip(&measured.groups) {
        lines.push(row(&format!("  {}", subscribers(*n)), &group.lateness, true));
    }
    lines.push(row("bare loop", &measured.bare, true));
    if measured.cyclictest.slices() > 0 {
        lines.push(row("cyclictest", &measured.cyclictest, true));
    }
    lines.push(ratio("loop / bare loop", &summary.ratio));
    lines.extend(summary.ratio_cyclictest.map(|r| ratio("loop / cyclictest", &r)));
    for (n, group) in summary.subscribers.iter().filter(|(n, _)| **n > 0) {
        lines.push(ratio(&format!("{n} / 0 subscribers"), &group.against_none));
    }
    lines.push("work".to_owned());
    lines.push(row("tick, wake-up to end", &measured.tick, false));
    for (name, pool) in STAGES.iter().zip(&measured.stages) {
        lines.push(row(&format!("  {name}"), pool, false));
    }
    lines.push(row("  hand-over", &measured.publish, false));
    let heard = || SUBSCRIBERS.iter().zip(&measured.groups).filter(|(n, _)| **n > 0);
    lines.push("wake-up to subscriber (other process)".to_owned());
    lines.extend(heard().map(|(n, group)| row(&subscribers(*n), &group.to_subscriber, false)));
    lines.push("scheduled time to subscriber".to_owned());
    lines.extend(heard().map(|(n, group)| row(&subscribers(*n), &group.scheduled_to_subscriber, false)));
    let (received, expected) = measured.groups.iter().fold((0, 0), |(r, e), g| (r + g.received, e + g.expected));
    lines.push(format!(
        "{} ticks skipped, {} samples not taken; undisturbed subscribers received {received} of {expected} samples",
        summary.skipped, summary.not_taken
    ));
    lines.extend(summary.system.refused.iter().map(|refusal| format!("refused: {refusal}")));
    lines
}

fn subscribers(n: usize) -> String {
    match n {
        0 => "no subscriber".to_owned(),
        1 => "1 subscriber".to_owned(),
        n if n >= DISTURBED_FROM => format!("{n}, one stalled, one killed"),
        n => format!("{n} subscribers"),
    }
}

fn row(name: &str, pool: &Pool, count_late: bool) -> String {
    let Some(Pooled { figures: Figures { p50, p99, p999, max }, slice_p99, .. }) = Pooled::of(pool) else {
        return format!("  {name:<34}{:>9}", "none");
    };
    let late = if count_late { format!("{:>11}", pool.all().late()) } else { String::new() };
    format!("  {name:<34}{p50:>9.2}{p99:>9.2}{p999:>9.1}{max:>10.1}{slice_p99:>11.2}{late}")
}

fn ratio(name: &str, ratio: &Ratio) -> String {
    let cell = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    format!(
        "  {name:<34}{:>9}{:>9}{:>9}{:>10}{:>11}{:>11}",
        cell(ratio.p50),
        "",
        "",
        "",
        cell(ratio.p99),
        cell(ratio.late)
    )
}
