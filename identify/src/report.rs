//! `report.json`: everything of the report that is no picture, for other programs.

use model::parameters::{NAMES, UNITS, index};
use serde::Serialize;

use crate::consistency::Check;
use crate::figures::Subject;
use crate::figures::torque_form::Comparison;
use crate::prepare::Channel;
use crate::rank::Rank;
use crate::validate::Score;
use crate::whiteness::Whiteness;

/// The file. Every number is finite or `null`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// 1.
    pub format: u32,
    /// Name of the campaign.
    pub campaign: String,
    /// The lines that a person reads first.
    pub summary: Vec<String>,
    /// Every parameter of `model.toml` but `u_max`.
    pub parameters: Vec<Parameter>,
    /// Of the parameters with a standard error, but `l4`, which follows from others.
    pub correlation: Correlation,
    /// Directions that the data determine.
    pub rank: Rank,
    /// Checks of the reference model's physics.
    pub checks: Vec<Check>,
    /// Free-run errors of the runs that were never fitted.
    pub validation: Vec<Validation>,
    /// What the last model leaves of them.
    pub residual_analysis: Vec<Whiteness>,
    /// Eq. (2) against its third order, where that was asked for.
    pub torque_form: Option<Comparison>,
    /// Samples that were passed over.
    pub corrupted: Vec<Corrupted>,
}

/// One parameter of the model that is handed on, as `model.toml` has it.
#[derive(Clone, Debug, Serialize)]
pub struct Parameter {
    /// As in `model.toml`.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// `identified`, `given`, or `not_determined`: then the value is where the search began, and no result.
    pub status: &'static str,
    /// Joint fit.
    pub value: f64,
    /// Standard error.
    pub std: Option<f64>,
    /// 95 % interval.
    pub interval: Option<(f64, f64)>,
    /// Independent clusters of data that the standard error rests on.
    pub freedom: Option<f64>,
    /// Standard error over that of independent residuals.
    pub widening: Option<f64>,
    /// The paper's separate fit.
    pub separate_fit: Option<f64>,
    /// It stands at a bound of what is physical: a misfit that something else makes may have driven it there.
    pub at_bound: bool,
    /// Why it is not determined, and which run would.
    pub why: Option<String>,
}

/// Correlation matrix.
#[derive(Clone, Debug, Serialize)]
pub struct Correlation {
    /// Of the rows and columns.
    pub names: Vec<&'static str>,
    /// Row by row.
    pub matrix: Vec<Vec<f64>>,
}

/// One channel of a validation run.
#[derive(Clone, Debug, Serialize)]
pub struct Validation {
    /// File of the run.
    pub run: String,
    /// `horizontal` or `vertical`.
    pub plane: String,
    /// Column.
    pub channel: &'static str,
    /// RMS of the sensor's noise of one sample, in the channel's unit, as the others.
    pub noise_floor: f64,
    /// The reference model.
    pub reference: Errors,
    /// With what a diagnosis added.
    pub with_effects: Option<Errors>,
}

/// Errors of a free run.
#[derive(Clone, Debug, Serialize)]
pub struct Errors {
    /// Root mean square.
    pub rmse: f64,
    /// Largest.
    pub largest: f64,
    /// 100 %: no error; 0 %: no better than the channel's mean.
    pub fit_percent: Option<f64>,
    /// RMS over the noise floor.
    pub noise_floors: f64,
}

/// Samples of a channel that no sensor can mean.
#[derive(Clone, Debug, Serialize)]
pub struct Corrupted {
    /// File of the run.
    pub run: String,
    /// Column.
    pub channel: &'static str,
    /// Spikes and bursts.
    pub spikes: usize,
    /// Values that stood still.
    pub standing_still: usize,
}

impl Report {
    pub(crate) fn of(subject: &Subject, summary: &[String]) -> Self {
        let (known, matrix) = subject.handed_on().1.correlation();
        Report {
            format: 1,
            campaign: subject.loaded.campaign.name.clone(),
            summary: summary.to_vec(),
            parameters: (0..NAMES.len()).map(|p| parameter(subject, p)).collect(),
            correlation: Correlation { names: known.into_iter().map(|p| NAMES[p]).collect(), matrix },
            rank: subject.rank.clone(),
            checks: subject.checks.to_vec(),
            validation: validation(subject),
            residual_analysis: subject.whiteness.to_vec(),
            torque_form: Comparison::of(subject),
            corrupted: corrupted(subject),
        }
    }

    /// The file's text. The same results give the same bytes.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data with string keys has a JSON form");
        text.push('\n');
        text
    }
}

fn parameter(subject: &Subject, p: usize) -> Parameter {
    let identified = subject.identified;
    let (fit, uncertainty) = subject.handed_on();
    let value = fit.layout.parameters(&fit.point.theta).to_vector()[p];
    let std = uncertainty.of_parameter(p);
    let why = identified.undetermined.get(NAMES[p]).cloned();
    let status = match (std, [index::A2, index::J, index::G].contains(&p)) {
        (Some(_), _) => "identified",
        (None, true) => "given",
        (None, false) => "not_determined",
    };
    let separate = std.map(|_| identified.component.to_vector()[p]).filter(|v| v.is_finite());
    Parameter {
        name: NAMES[p],
        unit: UNITS[p],
        status,
        value,
        std,
        interval: uncertainty.half_interval(p).filter(|h| h.is_finite()).map(|h| (value - h, value + h)),
        freedom: uncertainty.freedom(p).filter(|f| std.is_some() && f.is_finite()),
        widening: uncertainty.widening(p),
        separate_fit: separate,
        at_bound: std.is_some() && fit.layout.is_at_bound(p, value),
        why,
    }
}

fn validation(subject: &Subject) -> Vec<Validation> {
    let mut out = Vec::new();
    for run in subject.validation {
        let entry = &subject.loaded.runs[run.prepared.run].entry;
        for c in run.compared() {
            let errors = |s: Score| Errors {
                rmse: s.rmse,
                largest: s.largest,
                fit_percent: s.fit_percent,
                noise_floors: s.rmse / c.noise_floor,
            };
            out.push(Validation {
                run: entry.file.clone(),
                plane: entry.plane.to_string(),
                channel: c.before.channel.column(),
                noise_floor: c.noise_floor,
                reference: errors(c.before),
                with_effects: c.after.filter(|_| subject.after().is_some()).map(errors),
            });
        }
    }
    out
}

fn corrupted(subject: &Subject) -> Vec<Corrupted> {
    let mut out = Vec::new();
    for run in &subject.loaded.runs {
        for c in Channel::ALL.into_iter().filter(|c| run.corruption.of(*c) > 0) {
            out.push(Corrupted {
                run: run.entry.file.clone(),
                channel: c.column(),
                spikes: run.corruption.spikes[c.index()],
                standing_still: run.corruption.still[c.index()],
            });
        }
    }
    out
}
