//! What the report shows: figures and tables of an analysis, one file a section.

mod characteristics;
mod consistency;
mod findings;
mod parameters;
mod plant;
mod ports;
mod residual;
mod summary;
pub mod text;
pub mod torque_form;
mod validation;
mod volume;
mod whiteness;

use crate::consistency::Check;
use crate::diagnose::{Diagnosis, Verdict};
use crate::figure::{Figure, Mark, Series, Table};
use crate::fit::Fit;
use crate::identification::{Identified, Loaded};
use crate::rank::Rank;
use crate::uncertainty::Uncertainty;
use crate::validate::ValidatedRun;
use crate::whiteness::Whiteness;

/// Sections of the report, in the order in which they should be read.
pub mod section {
    /// What was found.
    pub const RESULT: &str = "Result";
    /// Free run against runs that were never fitted.
    pub const VALIDATION: &str = "Validation";
    /// What the reference model leaves.
    pub const RESIDUAL: &str = "Residual";
    /// Parameters, and the counterparts of the paper's characteristics.
    pub const IDENTIFICATION: &str = "Identification";
}

/// Everything that figures and tables are made of.
pub struct Subject<'a> {
    /// The campaign.
    pub loaded: &'a Loaded,
    /// The reference model.
    pub identified: &'a Identified,
    /// What it knows of its parameters.
    pub uncertainty: &'a Uncertainty,
    /// What was found, where it was asked for.
    pub diagnosis: Option<&'a Diagnosis>,
    /// What the final model knows of its parameters; `None` where nothing was added.
    pub uncertainty_after: Option<&'a Uncertainty>,
    /// The validation runs.
    pub validation: &'a [ValidatedRun],
    /// The validation runs with the torque as eq. (2) alone, where the model has its third order.
    pub by_eq2: Option<&'a [ValidatedRun]>,
    /// Checks of the reference model's physics.
    pub checks: &'a [Check],
    /// What the data determine.
    pub rank: &'a Rank,
    /// What the last model leaves of the validation runs.
    pub whiteness: &'a [Whiteness],
}

impl Subject<'_> {
    /// The model with what was added, where something was.
    pub fn after(&self) -> Option<&Fit> {
        self.diagnosis.filter(|d| d.verdict != Verdict::None).map(|d| &d.after)
    }

    /// The model that the figures show as a full line.
    pub fn last(&self) -> &Fit {
        self.after().unwrap_or(&self.identified.fit)
    }

    /// The model that is handed on, as `model.toml` holds it, with what it knows of its parameters: that with what was added where that is named.
    pub fn handed_on(&self) -> (&Fit, &Uncertainty) {
        match (self.diagnosis, self.uncertainty_after) {
            (Some(d), Some(uncertainty)) if d.verdict == Verdict::Attributed => (&d.after, uncertainty),
            _ => (&self.identified.fit, self.uncertainty),
        }
    }

    /// How the last model is called in legends.
    pub fn last_name(&self) -> String {
        match self.diagnosis {
            Some(d) if d.verdict != Verdict::None => {
                let names: Vec<&str> = d.effects.iter().map(|a| a.effect.header().id).collect();
                format!("with {}", names.join(" + "))
            }
            _ => "model".into(),
        }
    }
}

/// All figures, section by section.
pub fn figures(subject: &Subject) -> Vec<Figure> {
    let mut out = validation::figures(subject);
    out.extend(residual::figures(subject));
    out.extend(whiteness::figures(subject));
    out.extend(ports::figures(subject));
    out.extend(characteristics::figures(subject));
    out.extend(volume::figures(subject));
    // an empty figure says nothing: the run that it would show was not recorded
    out.retain(|f| f.series.iter().any(|s| !s.x.is_empty()));
    out
}

/// All tables, section by section.
pub fn tables(subject: &Subject) -> Vec<Table> {
    let mut out = findings::tables(subject);
    out.extend(validation::tables(subject));
    out.extend(residual::tables(subject));
    out.extend(whiteness::tables(subject));
    out.extend(parameters::tables(subject));
    out.extend(torque_form::tables(subject));
    out.extend(consistency::tables(subject));
    out.retain(|t| !t.rows.is_empty());
    out
}

/// The first line says the verdict, the others what goes with it.
pub fn headline(subject: &Subject) -> Vec<String> {
    findings::headline(subject)
}

pub(crate) fn series(
    name: impl Into<String>,
    mark: Mark,
    group: usize,
    points: impl IntoIterator<Item = (f64, f64)>,
) -> Series {
    let (x, y) = points.into_iter().unzip();
    Series { name: name.into(), mark, group, x, y }
}

/// `n` values from `from` to `to`, both included.
pub(crate) fn grid(from: f64, to: f64, n: usize) -> impl Iterator<Item = f64> + Clone {
    (0..n).map(move |i| from + (to - from) * i as f64 / (n - 1) as f64)
}

pub(crate) fn range(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values
        .into_iter()
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    (low <= high).then_some((low, high))
}

/// Groups of values that lie closer than `gap` to their neighbour, ascending; the mean of each.
pub(crate) fn levels(values: impl IntoIterator<Item = f64>, gap: f64) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let mut out = Vec::new();
    let mut group: Vec<f64> = Vec::new();
    for v in sorted {
        if group.last().is_some_and(|last| v - last > gap) {
            out.push(group.iter().sum::<f64>() / group.len() as f64);
            group.clear();
        }
        group.push(v);
    }
    if !group.is_empty() {
        out.push(group.iter().sum::<f64>() / group.len() as f64);
    }
    out
}

/// The level nearest to a value.
pub(crate) fn nearest(levels: &[f64], value: f64) -> usize {
    (0..levels.len()).min_by(|&a, &b| (levels[a] - value).abs().total_cmp(&(levels[b] - value).abs())).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_fall_into_the_levels_that_an_experiment_set() {
        let found = levels([10.1, -0.05, 0.1, 9.9, f64::NAN, 20.0], 1.0);
        assert_eq!(found.len(), 3);
        assert!((found[1] - 10.0).abs() < 1e-9);
        assert_eq!(nearest(&found, 12.0), 1);
        assert_eq!(levels([], 1.0), Vec::<f64>::new());
        assert_eq!(range([f64::NAN]), None);
    }
}
