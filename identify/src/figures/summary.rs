//! The lines that a person reads first.

use model::parameters::NAMES;

use crate::consistency::Outcome;
use crate::figures::Subject;
use crate::figures::text::number;
use crate::figures::torque_form::Comparison;
use crate::layout::FREE;

/// How many parameters of the model that is handed on are known, which of them stand at their bounds or are hardly other than zero, and the least certain of
/// the others.
pub(super) fn parameters(subject: &Subject) -> String {
    let (fit, uncertainty) = subject.handed_on();
    let values = fit.layout.parameters(&fit.point.theta).to_vector();
    let std = |p: usize| uncertainty.of_parameter(p).map(|std| (std, p));
    let known: Vec<(f64, usize)> = FREE.iter().filter_map(|&p| std(p)).collect();
    let (at_bound, inside): (Vec<_>, Vec<_>) = known.iter().partition(|(_, p)| fit.layout.is_at_bound(*p, values[*p]));
    let (clear, zero): (Vec<_>, Vec<_>) = inside.into_iter().partition(|(std, p)| values[*p].abs() > 2.0 * std);
    let share = |&(std, p): &(f64, usize)| (std / values[p].abs(), p);
    let worst = clear.iter().map(share).max_by(|a, b| a.0.total_cmp(&b.0));
    let least = worst.map_or(String::new(), |(s, p)| {
        format!("; the least certain is {}, to {} % (standard error)", NAMES[p], number(100.0 * s, 2))
    });
    let zero: Vec<&str> = zero.iter().map(|(_, p)| NAMES[*p]).collect();
    let not_told = match zero.len() {
        0 => String::new(),
        _ => format!("; not told from zero: {}", zero.join(", ")),
    };
    let at_bound: Vec<&str> = at_bound.iter().map(|(_, p)| NAMES[*p]).collect();
    let bounded = match at_bound.len() {
        0 => String::new(),
        _ => format!("; at the bound of what is physical, so not to be relied on: {}", at_bound.join(", ")),
    };
    format!("{} of {} base parameters are determined{least}{not_told}{bounded}.", known.len(), FREE.len())
}

/// How many checks hold, and those that fail.
pub(super) fn checks(subject: &Subject) -> String {
    let count = |o: Outcome| subject.checks.iter().filter(|c| c.outcome == o).count();
    let mut failed: Vec<&str> =
        subject.checks.iter().filter(|c| c.outcome == Outcome::Fails).map(|c| c.what.as_str()).collect();
    let more = failed.len().saturating_sub(MOST);
    failed.truncate(MOST);
    let (holds, fails, open) = (count(Outcome::Holds), count(Outcome::Fails), count(Outcome::Open));
    let named = if failed.is_empty() { String::new() } else { format!(" Failed: {}", failed.join("; ")) };
    let rest = if more > 0 { format!("; and {more} more") } else { String::new() };
    let end = if failed.is_empty() { "" } else { "." };
    let of = if subject.after().is_some() { " of the model without what was added" } else { "" };
    format!(
        "Consistency checks{of}: {holds} hold, {fails} fail, {open} can't be judged by this campaign.{named}{rest}{end}"
    )
}

/// Most failed checks that are named.
const MOST: usize = 4;

/// Which form of the torque the data ask for.
pub(super) fn torque_form(subject: &Subject) -> Option<String> {
    let c = Comparison::of(subject)?;
    Some(format!(
        "Torque of third order after eq. (1): {} ({} standard errors better than eq. (2)).",
        if c.is_asked_for() { "the data ask for it" } else { "the data do not ask for it" },
        number(c.standard_errors, 2)
    ))
}

/// Samples that were passed over.
pub(super) fn corruption(subject: &Subject) -> Option<String> {
    let of = |r: &crate::loaded::LoadedRun| -> usize { r.corruption.spikes.iter().chain(&r.corruption.still).sum() };
    let all: usize = subject.loaded.runs.iter().map(of).sum();
    let runs = subject.loaded.runs.iter().filter(|r| of(r) > 0).count();
    (all > 0).then(|| format!("{all} corrupted samples in {runs} runs were passed over."))
}
