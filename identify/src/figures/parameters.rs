//! Values of the base parameters with their errors, and what the data do not determine.

use model::parameters::{NAMES, UNITS, index};

use crate::figure::Table;
use crate::figures::text::{interval, measured, number};
use crate::figures::{Subject, section};
use crate::fit::Fit;
use crate::uncertainty::Uncertainty;

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    vec![base(subject), undetermined(subject)]
}

fn base(subject: &Subject) -> Table {
    let component = subject.identified.component.to_vector();
    let columns = |fit: &Fit, uncertainty: &Uncertainty, p: usize| {
        let value = fit.layout.parameters(&fit.point.theta).to_vector()[p];
        match uncertainty.of_parameter(p) {
            Some(std) => [measured(value, std), number(std, 2), interval(value, std)],
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
                  continuous."
            .into(),
        columns: heads.into_iter().map(String::from).collect(),
        rows: rows.collect(),
    }
}

/// Known without identification.
fn given(parameter: usize) -> bool {
    [index::A2, index::J, index::G].contains(&parameter)
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
