//! `bench doctor [--json] [--serial PATH]... [--can IFACE]... [--dir DIR]`

use crate::doctor::{Asked, Finding, State, Surroundings, examine};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Where recordings go unless somebody says otherwise.
const RECORDINGS: &str = "recordings/data";

/// Check this machine for real time, and say what to change (3 if there is a problem)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
    /// Serial port of the rig, such as /dev/serial/by-id/...; may be repeated
    #[arg(long, value_name = "PATH")]
    serial: Vec<PathBuf>,
    /// CAN interface of the rig, such as can0; may be repeated
    #[arg(long, value_name = "IFACE")]
    can: Vec<String>,
    /// Directory for the recordings
    #[arg(long, value_name = "DIR", default_value = RECORDINGS)]
    dir: PathBuf,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Document {
    problems: usize,
    advice: usize,
    checks: Vec<Finding>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let Args { json, serial, can, dir } = args;
    let asked = Asked { serial: absolute(serial)?, can: can.clone(), directory: dir.clone() };
    let checks = examine(&Surroundings::here(asked));
    let count = |state| checks.iter().filter(|finding| finding.state == state).count();
    let problems: Vec<&str> = checks.iter().filter(|f| f.state == State::Problem).map(|f| f.name).collect();
    let outcome = match problems.as_slice() {
        [] => Ok(()),
        names => Err(Failure::new(
            Kind::Acceptance,
            format!(
                "{} of {} checks found a problem: {}; what to do stands with each",
                names.len(),
                checks.len(),
                names.join(", ")
            ),
        )),
    };
    if *json {
        let document = Document { problems: count(State::Problem), advice: count(State::Advice), checks };
        let text = serde_json::to_string_pretty(&document).map_err(|e| Failure::of(Kind::Internal, &e))?;
        progress.result(&text);
    } else {
        progress.result(&table(&checks));
    }
    outcome
}

/// The checks look below a root: a relative path would mean another place there.
fn absolute(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let whole = |path: &PathBuf| {
        std::path::absolute(path).map_err(|e| {
            Failure::new(
                Kind::Input,
                format!("{}: expected a path, got \"{e}\"; name the port by its whole path", Path::display(path)),
            )
        })
    };
    paths.iter().map(whole).collect()
}

/// One line per check, and one below it with what to do.
fn table(findings: &[Finding]) -> String {
    let width = findings.iter().map(|finding| finding.name.len()).max().unwrap_or(0);
    let mut lines = Vec::new();
    for Finding { name, state, found, remedy } in findings {
        lines.push(format!("{state:<8} {name:<width$}  {found}"));
        if !remedy.is_empty() && *state > State::Ok {
            lines.push(format!("{:8} {:width$}  -> {remedy}", "", ""));
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_for_each_check_and_one_for_what_to_do() {
        let finding = |name, state, found: &str, remedy: &str| Finding {
            name,
            state,
            found: found.to_owned(),
            remedy: remedy.to_owned(),
        };
        let findings = [
            finding("clock source", State::Ok, "tsc", ""),
            finding("disk", State::Problem, "full", "make room"),
            finding("CAN", State::Absent, "none", "nothing to do"),
        ];
        let expected = "\
ok       clock source  tsc
problem  disk          full
                       -> make room
absent   CAN           none";
        assert_eq!(table(&findings), expected);
    }
}
