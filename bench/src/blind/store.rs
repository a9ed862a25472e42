//! Results on disk: written after each case, so that a run that was ended goes on where it was.

use super::case::Case;
use super::table::{Target, targets};
use crate::failure::{Failure, Kind};
use identify::analysis::write_whole;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const FORMAT: u32 = 1;

/// Cases by their number.
pub struct Store {
    file: Option<PathBuf>,
    seed: u64,
    cases: BTreeMap<usize, Case>,
}

#[derive(Serialize, Deserialize)]
struct Written {
    format: u32,
    /// As text: not every program keeps 64 bits of a number.
    seed: String,
    cases: Vec<Case>,
}

#[derive(Serialize)]
struct Whole<'a> {
    format: u32,
    seed: String,
    targets: Vec<Target>,
    cases: Vec<&'a Case>,
}

impl Store {
    /// What is in the file already, if there is one, and what other machines found.
    ///
    /// # Errors
    /// One of them is none of these, or one of another seed, or one of `others` is not there (2).
    pub fn open(file: Option<&Path>, others: &[PathBuf], seed: u64) -> Result<Store, Failure> {
        let own = file.filter(|f| f.exists());
        let mut cases = BTreeMap::new();
        for path in others.iter().map(PathBuf::as_path).chain(own) {
            let written = read(path)?;
            if written.seed != seed.to_string() {
                let what = format!("expected results of seed {seed}, got those of seed {}", written.seed);
                return Err(refused(path, &what));
            }
            cases.extend(written.cases.into_iter().map(|c| (c.case, c)));
        }
        Ok(Store { file: file.map(Path::to_owned), seed, cases })
    }

    /// The case of this number is there.
    pub fn holds(&self, case: usize) -> bool {
        self.cases.contains_key(&case)
    }

    /// Adds a case and writes the file.
    ///
    /// # Errors
    /// The system refuses.
    pub fn add(&mut self, case: Case) -> Result<(), Failure> {
        self.cases.insert(case.case, case);
        self.write()
    }

    /// Writes the file, where there is to be one: with what other machines found.
    ///
    /// # Errors
    /// The system refuses.
    pub fn write(&self) -> Result<(), Failure> {
        let Some(file) = &self.file else { return Ok(()) };
        let cases = self.cases();
        let whole = Whole {
            format: FORMAT,
            seed: self.seed.to_string(),
            targets: targets(&cases),
            cases: self.cases.values().collect(),
        };
        let text = serde_json::to_string_pretty(&whole).expect("plain data with string keys has a JSON form");
        write_whole(file, &text).map_err(|e| Failure::of(Kind::Loss, &e)).map(drop)
    }

    /// The cases are all of the diagnosis of this commit, so that it may add to them: figures of two are figures of neither.
    ///
    /// # Errors
    /// One is of another or does not say of which (2).
    pub fn is_of(&self, diagnosis: Option<&str>) -> Result<(), Failure> {
        let Some(other) = self.cases.values().find(|c| c.diagnosis.as_deref() != diagnosis) else { return Ok(()) };
        let known = |commit: Option<&str>| commit.unwrap_or("unknown").to_owned();
        let message = format!(
            "case {}: expected results of the diagnosis that this program holds (commit {}), got those of another (commit {}); \
             name another --out, or ask only for cases that are there already",
            other.case,
            known(diagnosis),
            known(other.diagnosis.as_deref()),
        );
        Err(Failure::new(Kind::Input, message))
    }

    /// All cases, in order.
    pub fn cases(&self) -> Vec<Case> {
        self.cases.values().cloned().collect()
    }
}

/// What files hold, whatever their seeds and diagnoses: by seed and number, so that a case in two files counts once.
///
/// # Errors
/// One of them is none (2).
pub fn of_files(files: &[PathBuf]) -> Result<BTreeMap<(String, usize), Case>, Failure> {
    let mut cases = BTreeMap::new();
    for path in files {
        let written = read(path)?;
        cases.extend(written.cases.into_iter().map(|c| ((written.seed.clone(), c.case), c)));
    }
    Ok(cases)
}

fn read(path: &Path) -> Result<Written, Failure> {
    let text =
        std::fs::read_to_string(path).map_err(|e| refused(path, &format!("expected to read it, got \"{e}\"")))?;
    let written: Written = serde_json::from_str(&text)
        .map_err(|e| refused(path, &format!("expected the results of a blind run, got a file that is none ({e})")))?;
    if written.format != FORMAT {
        return Err(refused(path, &format!("expected format {FORMAT}, got {}", written.format)));
    }
    Ok(written)
}

fn refused(path: &Path, what: &str) -> Failure {
    Failure::new(Kind::Input, format!("{}: {what}; name another file, or remove this one", path.display()))
}
