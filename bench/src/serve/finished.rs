//! Finished runs: the recordings below a folder, each read once.

use crate::look::page::page;
use crate::look::summary::Summary;
use crate::look::words::{facts, verdict};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use recordings::Severity;
use serde::Serialize;
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use super::state::Outcome;

/// Folders within folders that are looked into.
const DEPTH: usize = 4;
/// Stands for the folders' `/` in an id.
const SLASH: char = '~';

/// What is written as it is in an address.
const IN_A_PATH: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.').remove(b'~');

/// A finished run, for clients.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// Names it; the recording's path below the folder, without its ending.
    pub id: String,
    name: String,
    protocol: Option<String>,
    utc: String,
    duration_s: Option<f64>,
    outcome: &'static str,
    samples: String,
    lossless: bool,
    recording: String,
    page: String,
}

/// See the module.
#[derive(Debug)]
pub struct Finished {
    folder: PathBuf,
    /// By path; good as long as size and time of the file are these.
    read: Mutex<HashMap<PathBuf, Known>>,
}

#[derive(Clone, Debug)]
struct Known {
    bytes: u64,
    changed: SystemTime,
    line: Arc<Line>,
}

/// Id of a recording below the folder; `None`: it lies elsewhere, or has a name that an id can't hold.
pub fn id_of(folder: &Path, recording: &Path) -> Option<String> {
    let below = recording.strip_prefix(folder).ok()?.to_str()?.strip_suffix(".mcap")?;
    (!below.contains(SLASH)).then(|| below.replace('/', &SLASH.to_string()))
}

impl Finished {
    /// The recordings below this folder.
    pub fn of(folder: &Path) -> Self {
        Finished { folder: folder.to_owned(), read: Mutex::default() }
    }

    /// Newest first. Reads what is new: to be called where waiting does no harm.
    pub fn lines(&self) -> Vec<Arc<Line>> {
        let mut files = Vec::new();
        walk(&self.folder, DEPTH, &mut files);
        let mut lines: Vec<(SystemTime, Arc<Line>)> =
            files.iter().filter_map(|path| self.line(path)).map(|known| (known.changed, known.line)).collect();
        lines.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| b.1.id.cmp(&a.1.id)));
        lines.into_iter().map(|(_, line)| line).collect()
    }

    fn line(&self, path: &Path) -> Option<Known> {
        let id = id_of(&self.folder, path)?;
        let metadata = path.metadata().ok()?;
        let (bytes, changed) = (metadata.len(), metadata.modified().ok()?);
        let known = || self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = known().get(path).filter(|known| (known.bytes, known.changed) == (bytes, changed)) {
            return Some(known.clone());
        }
        let line = Arc::new(line(id, path, changed));
        let new = Known { bytes, changed, line };
        known().insert(path.to_owned(), new.clone());
        Some(new)
    }

    /// The recording of this id. Only what is listed is found: no id leads out of the folder.
    pub fn path(&self, id: &str) -> Option<PathBuf> {
        let mut files = Vec::new();
        walk(&self.folder, DEPTH, &mut files);
        files.into_iter().find(|path| id_of(&self.folder, path).as_deref() == Some(id))
    }

    /// The page of a recording; `None`: there is no recording of this id.
    ///
    /// # Errors
    /// It can't be read, and why.
    pub fn page(&self, id: &str) -> Option<Result<String, String>> {
        let path = self.path(id)?;
        Some(match Summary::read(&path) {
            Ok(summary) => Ok(page(&summary, &verdict(&summary.faults_found()), &facts(&summary))),
            Err(error) => Err(error.to_string()),
        })
    }
}

fn walk(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) {
    // A folder that can't be read, or is not there yet, has nothing to show.
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        if path.is_dir() {
            if depth > 0 {
                walk(&path, depth - 1, files);
            }
        } else if path.extension().is_some_and(|end| end == "mcap") {
            files.push(path);
        }
    }
}

fn line(id: String, path: &Path, changed: SystemTime) -> Line {
    let page = format!("/api/v1/runs/{}", utf8_percent_encode(&id, IN_A_PATH));
    let recording = format!("{page}/recording");
    let closed = jiff::Timestamp::try_from(changed).unwrap_or_default();
    let line = Line {
        id,
        name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        protocol: None,
        utc: closed.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        duration_s: None,
        outcome: Outcome::Failed.as_str(),
        samples: "not readable".to_owned(),
        lossless: false,
        recording,
        page,
    };
    let Ok(summary) = Summary::read(path) else { return line };
    let certificate = summary.certificate.as_ref();
    Line {
        name: summary.run.name.clone(),
        protocol: Some(summary.run.protocol.to_string()),
        duration_s: Some(summary.duration_s()),
        outcome: outcome(&summary).as_str(),
        samples: certificate.map_or_else(
            || format!("{}, no certificate", summary.samples),
            |certificate| format!("{} of {}", certificate.received, certificate.expected),
        ),
        lossless: certificate.is_some_and(|certificate| certificate.is_lossless()),
        ..line
    }
}

fn outcome(summary: &Summary) -> Outcome {
    let aborted = summary.events.iter().any(|event| event.source == "loop" && event.severity == Severity::Error);
    if summary.tripped.is_some() {
        Outcome::Tripped
    } else if summary.faults > 0 || summary.samples == 0 || summary.trouble.is_some() {
        Outcome::Failed
    } else if summary.stopped_s.is_some() {
        Outcome::Stopped
    } else if aborted || !summary.certificate.as_ref().is_some_and(|certificate| certificate.is_lossless()) {
        Outcome::Aborted
    } else {
        Outcome::Completed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_names_one_file_below_the_folder_and_no_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let data = folder.path().join("data");
        fs::create_dir_all(data.join("campaign")).expect("made");
        for name in ["data/a.mcap", "data/campaign/b.mcap", "secret.mcap", "data/a.mcap.part", "data/x.toml"] {
            fs::write(folder.path().join(name), "no recording").expect("written");
        }
        let finished = Finished::of(&data);
        let mut ids: Vec<String> = finished.lines().iter().map(|line| line.id.clone()).collect();
        ids.sort();
        assert_eq!(ids, ["a", "campaign~b"]);
        assert_eq!(finished.path("campaign~b"), Some(data.join("campaign/b.mcap")));
        for id in ["..~secret", "../secret", "secret", "", "/etc/passwd", "a.mcap", "x"] {
            assert_eq!(finished.path(id), None, "{id}");
        }
        let line = finished.lines()[0].clone();
        assert_eq!((line.outcome, line.lossless), ("failed", false), "what can't be read is no success");
        assert!(finished.page("a").expect("it is there").is_err());
        assert!(Finished::of(&folder.path().join("none")).lines().is_empty());
    }
}
