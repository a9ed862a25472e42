//! What a folder of recordings holds: campaigns, and recordings that belong to none.

use super::summary::Summary;
use recordings::{CAMPAIGN_FILE, Campaign, Protocol, RunEntry};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders within folders that are looked into.
const DEPTH: usize = 4;

/// One line of the list.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Entry {
    /// Folder of the campaign, or the recording.
    pub path: PathBuf,
    /// `campaign`, `recording` or `unfinished`.
    pub kind: &'static str,
    /// What it holds: names of the runs or the protocol.
    pub holds: String,
    /// Runs, and how many of them may be fitted and are for validation.
    pub runs: usize,
    /// Runs of role `identify`.
    pub identify: usize,
    /// Runs of role `validate`.
    pub validate: usize,
    /// All runs together, s; `null` where a run is CSV.
    pub duration_s: Option<f64>,
    /// Samples that are missing; `null` where that is not known.
    pub lost: Option<u64>,
    /// Size of the runs.
    pub bytes: u64,
    /// The model that was identified from it, where it was.
    pub model: Option<PathBuf>,
    /// Verdict of its diagnosis.
    pub verdict: Option<String>,
    /// What is wrong, with what to do.
    pub trouble: Vec<String>,
}

/// The campaigns and recordings below `dir`, in the order of their names.
///
/// # Errors
/// The folder can't be read.
pub fn list(dir: &Path) -> std::io::Result<Vec<Entry>> {
    let mut entries = Vec::new();
    if dir.join(CAMPAIGN_FILE).exists() {
        entries.push(campaign(dir));
    }
    walk(dir, DEPTH, &mut entries)?;
    Ok(entries)
}

fn walk(dir: &Path, depth: usize, entries: &mut Vec<Entry>) -> std::io::Result<()> {
    let mut paths: Vec<PathBuf> = fs::read_dir(dir)?.map(|entry| entry.map(|e| e.path())).collect::<Result<_, _>>()?;
    paths.sort_unstable();
    // What a campaign lists is no recording of its own.
    let listed: BTreeSet<PathBuf> = match Campaign::open(dir) {
        Ok(campaign) => campaign.runs.iter().map(|run| dir.join(&run.file)).collect(),
        Err(_) => BTreeSet::new(),
    };
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            if path.join(CAMPAIGN_FILE).exists() {
                entries.push(campaign(&path));
            }
            // A folder that can't be read is no reason to say nothing of the others.
            let below = if depth > 0 { walk(&path, depth - 1, entries) } else { Ok(()) };
            if let Err(error) = below {
                let trouble = format!("{}: expected a readable folder, got \"{error}\"", path.display());
                entries.push(Entry { trouble: vec![trouble], ..Entry::blank(&path, "folder") });
            }
        } else if name.ends_with(".mcap.part") || (name.ends_with(".mcap") && !listed.contains(&path)) {
            entries.push(recording(&path));
        }
    }
    Ok(())
}

impl Entry {
    fn blank(path: &Path, kind: &'static str) -> Entry {
        Entry {
            path: path.to_owned(),
            kind,
            holds: String::new(),
            runs: 0,
            identify: 0,
            validate: 0,
            duration_s: None,
            lost: None,
            bytes: 0,
            model: None,
            verdict: None,
            trouble: Vec::new(),
        }
    }

    fn count(&mut self, role: recordings::Role) {
        self.runs += 1;
        match role {
            recordings::Role::Identify => self.identify += 1,
            recordings::Role::Validate => self.validate += 1,
        }
    }
}

fn recording(path: &Path) -> Entry {
    let unfinished = path.extension().is_some_and(|extension| extension == "part");
    let mut entry = Entry::blank(path, if unfinished { "unfinished" } else { "recording" });
    entry.bytes = path.metadata().map_or(0, |metadata| metadata.len());
    match Summary::read(path) {
        Ok(summary) => {
            entry.count(summary.run.role);
            entry.holds = summary.run.protocol.to_string();
            entry.duration_s = Some(summary.duration_s());
            entry.lost = lost(&summary);
            entry.trouble = summary.faults_found();
        }
        Err(error) => entry.trouble.push(error.to_string()),
    }
    entry
}

fn lost(summary: &Summary) -> Option<u64> {
    summary.certificate.as_ref().map(|certificate| certificate.expected.saturating_sub(certificate.received))
}

fn campaign(dir: &Path) -> Entry {
    let mut entry = Entry::blank(dir, "campaign");
    let campaign = match Campaign::open(dir) {
        Ok(campaign) => campaign,
        Err(error) => {
            entry.trouble.push(error.to_string());
            return entry;
        }
    };
    let mut protocols: Vec<Protocol> = campaign.runs.iter().map(|run| run.protocol).collect();
    protocols.sort_unstable();
    protocols.dedup();
    entry.holds = protocols.iter().map(|protocol| protocol.as_str()).collect::<Vec<_>>().join(" ");
    (entry.duration_s, entry.lost) = (Some(0.0), Some(0));
    for run in &campaign.runs {
        entry.count(run.role);
        add_run(&mut entry, dir, run);
    }
    let results = dir.join("analysis");
    entry.model = Some(results.join("model.toml")).filter(|model| model.is_file());
    entry.verdict = findings(&results.join("findings.json"));
    entry
}

fn add_run(entry: &mut Entry, dir: &Path, run: &RunEntry) {
    let path = dir.join(&run.file);
    entry.bytes += path.metadata().map_or(0, |metadata| metadata.len());
    if !run.file.ends_with(".mcap") {
        // What a CSV run lacks nobody knows, and its length is not worth reading it.
        (entry.duration_s, entry.lost) = (None, None);
        return;
    }
    match Summary::read(&path) {
        Ok(summary) => {
            entry.duration_s = entry.duration_s.map(|sum_s| sum_s + summary.duration_s());
            entry.lost = entry.lost.zip(lost(&summary)).map(|(sum, lost)| sum + lost);
            entry.trouble.extend(summary.faults_found().iter().map(|found| format!("{}: {found}", run.file)));
        }
        Err(error) => entry.trouble.push(error.to_string()),
    }
}

/// The verdict, with the effects that were named.
fn findings(path: &Path) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    let Ok(found) = serde_json::from_str::<serde_json::Value>(&text) else {
        return Some("findings.json is not readable".to_owned());
    };
    let effects = found["effects"].as_array().into_iter().flatten().filter_map(|effect| effect["id"].as_str());
    let words: Vec<&str> = found["verdict"].as_str().into_iter().chain(effects).collect();
    Some(words.join(" "))
}
