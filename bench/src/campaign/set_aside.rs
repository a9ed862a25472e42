//! What an interrupted, tripped or lossy run left is set aside: moved into a folder of its own, never deleted or overwritten.

use super::plan::file_of;
use crate::failure::{Failure, Kind};
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

/// Folder inside a campaign's folder.
pub const SET_ASIDE: &str = "set_aside";

/// Extension of a recording that was not closed.
const PART: &str = ".part";
/// Extension of the note that says why.
const WHY: &str = "txt";

/// Moves what run `name` left in `dir`, recording and incidents, to `set_aside/NAME-N.*`, with a note that says why; N is the first that
/// is free. Returns where the recording is now; `None` where the run left none.
///
/// # Errors
/// The system refuses (6).
pub fn set_aside(dir: &Path, name: &str, why: &str) -> Result<Option<PathBuf>, Failure> {
    let refused = |error: io::Error| {
        let message = format!(
            "{}: expected to move what run {name} left to {SET_ASIDE}/, got \"{error}\"; check the folder's permissions",
            dir.display()
        );
        Failure::new(Kind::Loss, message)
    };
    let left = files_of(dir, name).map_err(refused)?;
    let Some((last, others)) = left.split_last() else { return Ok(None) };
    let aside = dir.join(SET_ASIDE);
    std::fs::create_dir_all(&aside).map_err(refused)?;
    let taken = |n: u32| {
        let recording = aside.join(file_of(&format!("{name}-{n}")));
        recording.exists() || with_suffix(&recording, PART).exists()
    };
    let number = (1..).find(|&n| !taken(n)).expect("there are more numbers than files");
    let place = |file: &OsString| {
        let rest = file.to_string_lossy()[name.len()..].to_owned();
        aside.join(format!("{name}-{number}{rest}"))
    };
    std::fs::write(aside.join(format!("{name}-{number}.{WHY}")), format!("{why}\n")).map_err(refused)?;
    // The recording is the last to go: where this is interrupted, the next call takes the same number and ends it.
    for file in others.iter().chain([last]) {
        let to = free(place(file));
        std::fs::rename(dir.join(file), to).map_err(refused)?;
    }
    Ok(Some(place(last)))
}

/// What a run left: its incidents, then its recording. Empty where there is nothing of it.
fn files_of(dir: &Path, name: &str) -> io::Result<Vec<OsString>> {
    let recording = file_of(name);
    let mut incidents: Vec<OsString> = Vec::new();
    for entry in std::fs::read_dir(dir)? {
        let file = entry?.file_name();
        let text = file.to_string_lossy();
        if text.strip_prefix(name).is_some_and(|rest| rest.starts_with('.') && rest.ends_with(".json")) {
            incidents.push(file);
        }
    }
    incidents.sort();
    let recordings = [recording.clone(), format!("{recording}{PART}")].map(OsString::from);
    incidents.extend(recordings.into_iter().filter(|file| dir.join(file).exists()));
    Ok(incidents)
}

/// The place, or the first free one beside it: an incident of the same tick may be there from an interrupted move.
fn free(place: PathBuf) -> PathBuf {
    let beside = |n: u32| if n == 0 { place.clone() } else { with_suffix(&place, &format!(".{n}")) };
    (0..).map(beside).find(|path| !path.exists()).expect("there are more names than files")
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn contents(dir: &Path) -> BTreeMap<String, String> {
        let entries = std::fs::read_dir(dir).into_iter().flatten().map(|entry| entry.expect("readable").path());
        entries
            .filter(|path| path.is_file())
            .map(|path| {
                let name = path.file_name().expect("a name").to_string_lossy().into_owned();
                (name, std::fs::read_to_string(path).expect("text"))
            })
            .collect()
    }

    #[test]
    fn nothing_is_overwritten_however_often_a_run_is_set_aside() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let put = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).expect("writable");
        put("square_h.mcap", "another run");
        put("square.12-overrun.json", "first, late");
        put("square.mcap.part", "first");
        let part = set_aside(dir.path(), "square", "killed").expect("movable").expect("there is something");
        assert_eq!(part, dir.path().join("set_aside/square-1.mcap.part"));
        put("square.mcap", "second");
        put("square.99-trip.json", "second, tripped");
        let closed = set_aside(dir.path(), "square", "tripped").expect("movable").expect("there is something");
        assert_eq!(closed, dir.path().join("set_aside/square-2.mcap"));
        assert_eq!(set_aside(dir.path(), "square", "nothing"), Ok(None));
        assert_eq!(contents(dir.path()), BTreeMap::from([("square_h.mcap".into(), "another run".into())]));
        let expected = [
            ("square-1.12-overrun.json", "first, late"),
            ("square-1.mcap.part", "first"),
            ("square-1.txt", "killed\n"),
            ("square-2.99-trip.json", "second, tripped"),
            ("square-2.mcap", "second"),
            ("square-2.txt", "tripped\n"),
        ];
        let expected = expected.map(|(name, text)| (name.to_owned(), text.to_owned()));
        assert_eq!(contents(&dir.path().join(SET_ASIDE)), BTreeMap::from(expected));
    }

    #[test]
    fn a_move_that_was_interrupted_is_ended_under_the_same_number() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let put = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).expect("writable");
        std::fs::create_dir(dir.path().join(SET_ASIDE)).expect("writable");
        put("set_aside/a-1.5-trip.json", "moved before the interruption");
        put("a.mcap", "not moved yet");
        set_aside(dir.path(), "a", "tripped").expect("movable");
        let there = contents(&dir.path().join(SET_ASIDE));
        assert_eq!(there.keys().collect::<Vec<_>>(), ["a-1.5-trip.json", "a-1.mcap", "a-1.txt"]);
    }
}
