//! Everything that is wrong with a file, said at once.

use crate::failure::{Failure, Kind};

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Problem {
    /// From 1; 0 = of the file as a whole.
    line: usize,
    what: String,
}

/// What is wrong with a file.
#[derive(Clone, Debug, Default)]
pub(super) struct Problems(Vec<Problem>);

impl Problems {
    /// `line` is counted from 1.
    pub(super) fn add(&mut self, line: usize, what: impl Into<String>) {
        let problem = Problem { line, what: what.into() };
        if !self.0.contains(&problem) {
            self.0.push(problem);
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Nothing, or a failure (2) that names all, in the order of the file.
    pub(super) fn judge(mut self, file: &str) -> Result<(), Failure> {
        self.0.sort_by_key(|problem| problem.line);
        let located = |Problem { line, what }: &Problem| match line {
            0 => what.clone(),
            line => format!("line {line}: {what}"),
        };
        let message = match self.0.as_slice() {
            [] => return Ok(()),
            [one] => format!("{file}: {}", located(one)),
            several => {
                let lines =
                    several.iter().enumerate().map(|(n, problem)| format!("\n  {}. {}", n + 1, located(problem)));
                format!("{file}: {} problems:{}", several.len(), lines.collect::<String>())
            }
        };
        Err(Failure::new(Kind::Input, message))
    }
}

/// The nearest of some names, as the end of a message; empty where none is near.
pub(super) fn meant<'a>(got: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let distance = |name: &&str| strsim::osa_distance(&got.to_lowercase(), &name.to_lowercase());
    match names.into_iter().min_by_key(distance) {
        Some(name) if distance(&name) <= (got.chars().count() / 3).max(2) => format!(", did you mean {name:?}?"),
        _ => String::new(),
    }
}
