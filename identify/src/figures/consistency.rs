//! The checks of the model's physics, as a table.

use crate::consistency::Check;
use crate::figure::Table;
use crate::figures::text::{measured, number};
use crate::figures::{Subject, section};

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let row = |c: &Check| {
        let value = match (c.value, c.std) {
            (Some(value), Some(std)) => measured(value, std),
            (Some(value), None) => number(value, 3),
            _ => "-".into(),
        };
        let std = c.std.map_or(String::new(), |s| number(s, 2));
        let what = if c.unit == "1" { c.what.clone() } else { format!("{} / {}", c.what, c.unit) };
        vec![what, value, std, c.outcome.as_str().into(), c.meaning.clone()]
    };
    vec![Table {
        section: section::IDENTIFICATION.into(),
        title: "Consistency checks".into(),
        caption: "Of the reference model's equations with the identified values: each value is 0 where its physics holds. A check fails \
                  where the value is more than three standard errors from 0 and large enough to matter."
            .into(),
        columns: ["check", "value", "std. error", "verdict", "meaning"].map(String::from).to_vec(),
        rows: subject.checks.iter().map(row).collect(),
    }]
}
