//! Values of the base parameters with their errors, and what the data do not determine.

use model::parameters::{NAMES, UNITS, index};

use crate::figure::Table;
use crate::figures::text::{interval, measured, number, run_name};
use crate::figures::{Subject, section};
use crate::fit::Fit;
use crate::prepare::Channel;
use crate::uncertainty::Uncertainty;

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    vec![base(subject), undetermined(subject), correlations(subject), corrupted(subject)]
}

fn base(subject: &Subject) -> Table {
    let component = subject.identified.component.to_vector();
    let columns = |fit: &Fit, uncertainty: &Uncertainty, p: usize| {
        let value = fit.layout.parameters(&fit.point.theta).to_vector()[p];
        match uncertainty.of_parameter(p) {
            Some(std) => {
                let half = uncertainty.half_interval(p).unwrap_or(f64::INFINITY);
                [measured(value, std), number(std, 2), interval(value, std, half)]
            }
            None if given(p) => [number(value, 6), "given".into(), String::new()],
            None => ["-".into(), "not determined".into(), String::new()],
        }
    };
    let after = subject.after().zip(subject.uncertainty_after);
    let rows = (0..NAMES.len()).map(|p| {
        let separate = if given(p) || subject.identified.undetermined.contains_key(NAMES[p]) {
            String::new()
        } else {
            number(component[p], 4)
        };
        let unit = if UNITS[p] == "1" { "-" } else { UNITS[p] };
        let mut row = vec![NAMES[p].to_string(), unit.to_string(), separate];
        let reference = columns(&subject.identified.fit, subject.uncertainty, p);
        match after {
            Some((fit, uncertainty)) => {
                row.extend(reference.into_iter().take(2));
                row.extend(columns(fit, uncertainty, p));
            }
            None => row.extend(reference),
        }
        row
    });
    let mut heads = vec!["parameter", "unit", "separate fit", "reference model", "std. error"];
    if after.is_some() {
        heads.extend(["with what was added", "std. error"]);
    }
    heads.push("95 % interval");
    Table {
        section: section::IDENTIFICATION.into(),
        title: "Parameters".into(),
        caption: "The separate fits evaluate each experiment by itself, as the paper does, and give the start; then all parameters \
                  are fitted together in free run to all runs with role identify. l4 follows from the others, eq. (16) being \
                  continuous. Standard errors feel what neighbouring samples err together: they are the larger of what independent noise \
                  gives and of what the residuals' sums over clusters of 5 s, or over whole sweeps and fillings, say."
            .into(),
        columns: heads.into_iter().map(String::from).collect(),
        rows: rows.collect(),
    }
}

/// Known without identification.
fn given(parameter: usize) -> bool {
    [index::A2, index::J, index::G].contains(&parameter)
}

/// Which parameters the data know together rather than apart, and the directions that they leave open.
fn correlations(subject: &Subject) -> Table {
    let (known, matrix) = subject.uncertainty.correlation();
    let mut pairs = Vec::new();
    for i in 0..known.len() {
        for j in 0..i {
            pairs.push((matrix[i][j], NAMES[known[j]], NAMES[known[i]]));
        }
    }
    pairs.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    let mut rows: Vec<Vec<String>> = pairs
        .iter()
        .take(MOST_PAIRS)
        .filter(|p| p.0.abs() > 0.5)
        .map(|(r, a, b)| vec![format!("{a}, {b}"), number(*r, 3), String::new()])
        .collect();
    let rank = subject.rank;
    for direction in &rank.open {
        let parts: Vec<String> =
            direction.iter().map(|(name, share)| format!("{} {name}", number(*share, 2))).collect();
        rows.push(vec![
            parts.join(", "),
            "open".into(),
            "these changes together, in units of the parameters' sizes (1 for a2), show nowhere in the data".into(),
        ]);
    }
    Table {
        section: section::IDENTIFICATION.into(),
        title: "Rank and correlations".into(),
        caption: format!(
            "The data determine {} of {} directions in the space of the base parameters with a2; along these the standard errors, in \
             units of the parameters' sizes, differ by a factor of {}. exp(-a2) scales h1 and h3 alike, so a2 is fixed at 0. Shown: \
             the strongest correlations, and the open directions. The whole matrix is in report.json.",
            rank.rank,
            rank.parameters.len(),
            number(rank.condition, 2)
        ),
        columns: ["parameters", "correlation", ""].map(String::from).to_vec(),
        rows,
    }
}

/// Most pairs that a person reads.
const MOST_PAIRS: usize = 12;

/// Samples that were passed over because no sensor can mean them.
fn corrupted(subject: &Subject) -> Table {
    let mut rows = Vec::new();
    for run in &subject.loaded.runs {
        for c in Channel::ALL.into_iter().filter(|c| run.corruption.of(*c) > 0) {
            let i = c.index();
            let row = [run_name(&run.entry.file), c.column()].map(String::from).into_iter();
            rows.push(row.chain([run.corruption.spikes[i], run.corruption.still[i]].map(|n| n.to_string())).collect());
        }
    }
    Table {
        section: section::IDENTIFICATION.into(),
        title: "Corrupted samples".into(),
        caption: "Left out of fits and scores as if they were missing: spikes and bursts far from the samples around them, and values \
                  that stand still longer than chance explains."
            .into(),
        columns: ["run", "channel", "spikes", "standing still"].map(String::from).to_vec(),
        rows,
    }
}

fn undetermined(subject: &Subject) -> Table {
    Table {
        section: section::IDENTIFICATION.into(),
        title: "Not determined by this campaign".into(),
        caption: "These keep the value they started from, so that the model can be simulated; it is no result.".into(),
        columns: ["parameter", "why"].map(String::from).to_vec(),
        rows: subject.identified.undetermined.iter().map(|(name, why)| vec![name.clone(), why.clone()]).collect(),
    }
}
