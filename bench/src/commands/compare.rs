//! `bench compare A/model.toml B/model.toml`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use model::ModelFile;
use model::parameters::NAMES;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Compare two identified models, parameter by parameter, in standard errors
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A `model.toml` that `bench identify` or `bench diagnose` wrote
    a: PathBuf,
    /// Another
    b: PathBuf,
    /// They agree where no difference is larger than so many standard errors of it
    #[arg(long, default_value_t = 3.0)]
    within: f64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    /// No difference is larger than `within` standard errors.
    agree: bool,
    within: f64,
    /// The largest difference, standard errors, and whose it is.
    largest: f64,
    largest_of: &'static str,
    parameters: &'a [Row],
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let rows = differences(&read(&args.a)?, &read(&args.b)?);
    if rows.is_empty() {
        let message = format!(
            "{} and {}: expected standard errors ([std]) of the same parameters in both, got none; only identified models can \
             be compared",
            args.a.display(),
            args.b.display()
        );
        return Err(Failure::new(Kind::Input, message));
    }
    let json = progress;
    let progress = &progress.beside(args.json);
    progress.result(&format!("{:<5} {:>13} {:>13} {:>12} {:>7}", "", "A", "B", "std of A-B", "A-B/std"));
    for Row { name, a, b, std } in &rows {
        progress.result(&format!("{name:<5} {a:>13.6} {b:>13.6} {std:>12.2e} {:>7.2}", (a - b) / std));
    }
    let worst = rows.iter().max_by(|x, y| x.distance().total_cmp(&y.distance()));
    let worst = worst.expect("there is at least one row");
    let verdict = format!(
        "{} parameters, the largest difference is {:.2} standard errors ({}); {} are meant to hold",
        rows.len(),
        worst.distance(),
        worst.name,
        args.within
    );
    let agree = worst.distance() <= args.within;
    if args.json {
        let (largest, largest_of) = (worst.distance(), worst.name);
        json.json(&Document { agree, within: args.within, largest, largest_of, parameters: &rows })?;
    }
    if agree {
        progress.result(&verdict);
        return Ok(());
    }
    Err(Failure::new(Kind::Acceptance, verdict))
}

fn read(path: &Path) -> Result<ModelFile, Failure> {
    ModelFile::read(path).map_err(|e| Failure::of(Kind::Input, &e))
}

/// A parameter that both models have with a standard error.
#[derive(Serialize)]
struct Row {
    name: &'static str,
    a: f64,
    b: f64,
    /// Of the difference.
    std: f64,
}

impl Row {
    fn distance(&self) -> f64 {
        (self.a - self.b).abs() / self.std
    }
}

/// The parameters that both have determined. Their errors count as independent: two campaigns share no noise.
fn differences(a: &ModelFile, b: &ModelFile) -> Vec<Row> {
    let values = a.parameters.to_vector().into_iter().zip(b.parameters.to_vector());
    let rows = NAMES.into_iter().zip(values).filter_map(|(name, (value_a, value_b))| {
        let std = f64::hypot(*a.std.get(name)?, *b.std.get(name)?);
        (std > 0.0).then_some(Row { name, a: value_a, b: value_b, std })
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Parameters;

    #[test]
    fn a_difference_is_measured_in_its_own_standard_errors() {
        let mut a = ModelFile::plain(Parameters::example());
        let mut b = a.clone();
        b.parameters.torque.m3 += 0.5;
        b.parameters.pump.f1 += 1.0;
        a.std = [("m3".to_owned(), 0.3), ("f1".to_owned(), 0.1)].into();
        b.std = [("m3".to_owned(), 0.4), ("m1".to_owned(), 0.1)].into();
        let rows = differences(&a, &b);
        assert_eq!(rows.iter().map(|row| row.name).collect::<Vec<_>>(), ["m3"], "f1 has no error in one of them");
        assert!((rows[0].std - 0.5).abs() < 1e-12 && (rows[0].distance() - 1.0).abs() < 1e-12);
    }
}
