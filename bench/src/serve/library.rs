//! The profiles that can be queued: the built-in ones and those of a folder.

use crate::failure::{Failure, Kind};
use profiles::{BUILTIN, EXAMPLES, Script};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A profile that can be queued.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Its script.
    pub script: Script,
    /// Its file; `None`: built in.
    pub file: Option<PathBuf>,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Library(Vec<Entry>);

/// A line of the list for clients.
#[derive(Clone, Debug, Serialize)]
pub struct Line<'a> {
    name: &'a str,
    protocol: &'static str,
    role: &'static str,
    title: &'a str,
    duration_s: f64,
    file: Option<String>,
}

impl Library {
    /// Reads the folder; a script of the name of a built-in one replaces it.
    ///
    /// # Errors
    /// The folder or one of its scripts is wrong (2).
    pub fn read(folder: Option<&Path>) -> Result<Library, Failure> {
        let input = |error: &dyn std::error::Error| Failure::of(Kind::Input, error);
        let mut entries = Vec::new();
        if let Some(folder) = folder {
            // Names and files together: the script alone does not say where it lies.
            profiles::load_folder(folder).map_err(|e| input(&e))?;
            let listed = std::fs::read_dir(folder).map_err(|e| input(&e))?;
            let mut files: Vec<PathBuf> = listed.filter_map(|entry| Some(entry.ok()?.path())).collect();
            files.retain(|path| {
                path.extension().is_some_and(|end| end == "toml")
                    && path.file_name().is_some_and(|name| name != "Cargo.toml")
            });
            files.sort();
            for file in files {
                let script = Script::read(&file).map_err(|e| input(&e))?;
                let file = std::path::absolute(&file).unwrap_or(file);
                entries.push(Entry { script, file: Some(file) });
            }
        }
        for (name, text) in BUILTIN.iter().chain(EXAMPLES) {
            let script = Script::parse(text, name).map_err(|e| Failure::of(Kind::Internal, &e))?;
            if !entries.iter().any(|entry: &Entry| entry.script.name == script.name) {
                entries.push(Entry { script, file: None });
            }
        }
        Ok(Library(entries))
    }

    /// The profile of this name.
    pub fn find(&self, name: &str) -> Option<&Entry> {
        self.0.iter().find(|entry| entry.script.name == name)
    }

    /// All names, in words.
    pub fn names(&self) -> String {
        self.0.iter().map(|entry| entry.script.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// For clients.
    pub fn lines(&self) -> Vec<Line<'_>> {
        self.0.iter().map(Entry::line).collect()
    }
}

impl Entry {
    fn line(&self) -> Line<'_> {
        let Script { name, protocol, role, about, .. } = &self.script;
        Line {
            name,
            protocol: protocol.as_str(),
            role: role.as_str(),
            title: about.trim().lines().next().unwrap_or_default(),
            duration_s: self.script.duration_bound_s(),
            file: self.file.as_ref().map(|file| file.display().to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_s_profile_replaces_the_built_in_one_of_its_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let (_, text) = BUILTIN.iter().find(|(file, _)| *file == "square_h.toml").expect("it is built in");
        std::fs::write(folder.path().join("mine.toml"), text).expect("written");
        let library = Library::read(Some(folder.path())).expect("it is sound");
        assert_eq!(library.0.len(), BUILTIN.len() + EXAMPLES.len());
        assert!(library.find("square_h").is_some_and(|entry| entry.file.is_some()));
        assert!(library.find("random_a").is_some_and(|entry| entry.file.is_none()));
        assert!(library.find("none").is_none());
        std::fs::write(folder.path().join("broken.toml"), "name = 3").expect("written");
        let failure = Library::read(Some(folder.path())).expect_err("it is none");
        assert!(failure.exit_code() == 2 && failure.message.contains("broken.toml"), "{failure}");
    }
}
