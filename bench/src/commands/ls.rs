//! `bench ls [DIR] [--json]`

use crate::failure::{Failure, Kind};
use crate::look::listing::{Entry, list};
use crate::progress::Progress;
use std::path::PathBuf;

/// Where campaigns and recordings go unless another folder is named.
const DATA: &str = "recordings/data";

/// What a folder of recordings holds: campaigns and loose recordings, how long, what for, loss, identified model, verdict
///
/// Unfinished and damaged recordings are shown with what to do about them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder
    #[arg(default_value = DATA)]
    dir: PathBuf,
    /// For scripts
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let Args { dir, json } = args;
    let entries = list(dir).map_err(|error| {
        let message = format!("{}: expected a readable folder, got \"{error}\"; name another one", dir.display());
        Failure::new(Kind::Input, message)
    })?;
    if *json {
        let text = serde_json::to_string_pretty(&entries).map_err(|e| Failure::of(Kind::Internal, &e))?;
        progress.result(&text);
        return Ok(());
    }
    if entries.is_empty() {
        progress.result(&format!("{}: no recordings", dir.display()));
        return Ok(());
    }
    let names: Vec<String> = entries.iter().map(|entry| name(entry, dir)).collect();
    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(4);
    let head = format!(
        "{:<width$} {:<10} {:>4} {:>9} {:>9} {:>8} {:>9}  ",
        "name", "kind", "runs", "fit/check", "length", "lost", "size"
    );
    progress.result(&format!("{head}holds"));
    for (entry, name) in entries.iter().zip(&names) {
        progress.result(&line(entry, name, width));
        let results = entry.model.as_ref().map(|model| format!("model {}", relative(model, dir)));
        let verdict = entry.verdict.as_ref().map(|verdict| format!("verdict {verdict}"));
        let results: Vec<String> = results.into_iter().chain(verdict).collect();
        if !results.is_empty() {
            progress.result(&format!("  {}", results.join(", ")));
        }
        entry.trouble.iter().for_each(|trouble| progress.result(&format!("  ! {trouble}")));
    }
    Ok(())
}

fn name(entry: &Entry, dir: &std::path::Path) -> String {
    relative(&entry.path, dir)
}

fn relative(path: &std::path::Path, dir: &std::path::Path) -> String {
    let inside = path.strip_prefix(dir).unwrap_or(path);
    if inside.as_os_str().is_empty() { ".".to_owned() } else { inside.display().to_string() }
}

fn line(entry: &Entry, name: &str, width: usize) -> String {
    let roles = format!("{}/{}", entry.identify, entry.validate);
    let length = entry.duration_s.map_or("?".to_owned(), |s| format!("{}:{:02}", s as u64 / 60, s as u64 % 60));
    let lost = entry.lost.map_or("?".to_owned(), |lost| lost.to_string());
    let size = format!("{:.1} MB", entry.bytes as f64 * 1e-6);
    let Entry { kind, runs, holds, .. } = entry;
    format!("{name:<width$} {kind:<10} {runs:>4} {roles:>9} {length:>9} {lost:>8} {size:>9}  {holds}")
        .trim_end()
        .to_owned()
}
