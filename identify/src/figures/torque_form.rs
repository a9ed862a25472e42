//! The torque as eq. (2) against its third order, where that was asked for.

use crate::figure::Table;
use crate::figures::text::{measured, number, run_name};
use crate::figures::{Subject, section};
use crate::refit::advantage;
use crate::score::clusters;
use crate::torque_form::third_order;

pub(super) fn tables(subject: &Subject) -> Vec<Table> {
    let Some(c) = Comparison::of(subject) else { return Vec::new() };
    let header = third_order().header();
    let terms = header.parameters.iter().zip(&c.terms).map(|(p, (value, std))| {
        vec![
            p.name.to_string(),
            "0".into(),
            format!("{} +- {}", measured(*value, *std), number(*std, 2)),
            p.unit.into(),
        ]
    });
    let mut rows: Vec<Vec<String>> = terms.collect();
    rows.push(vec![
        "weighted sum of squares".into(),
        number(c.cost.0, 6),
        number(c.cost.1, 6),
        format!("better by {} standard errors, cluster by cluster", number(c.standard_errors, 2)),
    ]);
    for (what, before, after) in &c.validation {
        rows.push(vec![what.clone(), number(*before, 3), number(*after, 3), "noise floors".into()]);
    }
    vec![Table {
        section: section::IDENTIFICATION.into(),
        title: "Torque: eq. (2) against its third order".into(),
        caption: format!(
            "Both fitted to the same runs. Third order: {}. {} {}",
            header.equation,
            if c.is_asked_for() { "The data ask for it." } else { "The data do not ask for it: eq. (2) is enough." },
            "Below: RMS errors of the validation runs."
        ),
        columns: ["", "eq. (2)", "third order", ""].map(String::from).to_vec(),
        rows,
    }]
}

/// Both forms.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Comparison {
    /// Weighted sums of squares: eq. (2), third order.
    pub cost: (f64, f64),
    /// Significance of the difference.
    pub standard_errors: f64,
    /// Terms of third order with their standard errors.
    pub terms: Vec<(f64, f64)>,
    /// Run and channel; RMS error over the noise floor: eq. (2), third order.
    pub validation: Vec<(String, f64, f64)>,
}

impl Comparison {
    /// `None` where the third order was not asked for, or a form can't be simulated.
    pub fn of(subject: &Subject) -> Option<Self> {
        let second = subject.identified.by_eq2.as_ref()?;
        let third = &subject.identified.fit;
        let problem = &subject.identified.problem;
        let before = problem.residuals(&second.layout, &second.point).ok()?;
        let after = problem.residuals(&third.layout, &third.point).ok()?;
        let (members, count) = clusters(problem);
        let (_, standard_errors) = advantage(&before, &after, &members, count);
        let first = third.layout.first_of(0);
        let of = |i: usize| (third.point.theta[first + i], subject.uncertainty.of_entry(first + i));
        let terms = (0..third_order().header().parameters.len()).map(of).collect();
        let mut validation = Vec::new();
        for (a, b) in subject.by_eq2?.iter().zip(subject.validation) {
            let name = run_name(&b.prepared.file);
            for (a, b) in a.compared().iter().zip(b.compared()) {
                let what = format!("{name} {}", b.before.channel.column());
                validation.push((what, a.before.rmse / a.noise_floor, b.before.rmse / b.noise_floor));
            }
        }
        Some(Comparison { cost: (second.cost, third.cost), standard_errors, terms, validation })
    }

    /// A term is more than four standard errors from 0.
    pub fn is_asked_for(&self) -> bool {
        self.terms.iter().any(|(value, std)| value.abs() > 4.0 * std)
    }
}
