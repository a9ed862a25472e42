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
    /// What is in the file already, if there is one.
    ///
    /// # Errors
    /// The file is none of these, or one of another seed (2).
    pub fn open(file: Option<&Path>, seed: u64) -> Result<Store, Failure> {
        let mut store = Store { file: file.map(Path::to_owned), seed, cases: BTreeMap::new() };
        let Some(path) = file.filter(|f| f.exists()) else { return Ok(store) };
        let refused = |what: String| {
            let message = format!("{}: {what}; name another file with --out, or remove this one", path.display());
            Failure::new(Kind::Input, message)
        };
        let text = std::fs::read_to_string(path).map_err(|e| refused(format!("expected to read it, got \"{e}\"")))?;
        let written: Written = serde_json::from_str(&text)
            .map_err(|e| refused(format!("expected the results of a blind run, got a file that is none ({e})")))?;
        if written.format != FORMAT {
            return Err(refused(format!("expected format {FORMAT}, got {}", written.format)));
        }
        if written.seed != seed.to_string() {
            return Err(refused(format!("expected results of seed {seed}, got those of seed {}", written.seed)));
        }
        store.cases = written.cases.into_iter().map(|c| (c.case, c)).collect();
        Ok(store)
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

    /// All cases, in order.
    pub fn cases(&self) -> Vec<Case> {
        self.cases.values().cloned().collect()
    }
}
