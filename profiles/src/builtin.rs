//! The paper's experiments, in the order of a campaign, and scripts from a folder.

use crate::error::ScriptError;
use crate::script::Script;
use std::path::{Path, PathBuf};

/// The built-in scripts: file name and text, in the order in which a campaign runs them. One line a script; the files lie in
/// this crate's folder.
pub const BUILTIN: &[(&str, &str)] = &[
    ("torque_map.toml", include_str!("../torque_map.toml")),
    ("volume_map.toml", include_str!("../volume_map.toml")),
    ("pump_map.toml", include_str!("../pump_map.toml")),
    ("clamp_steps.toml", include_str!("../clamp_steps.toml")),
    ("constant_flow.toml", include_str!("../constant_flow.toml")),
    ("random_a.toml", include_str!("../random_a.toml")),
    ("square_a.toml", include_str!("../square_a.toml")),
    ("square_b.toml", include_str!("../square_b.toml")),
    ("square_h.toml", include_str!("../square_h.toml")),
    ("square_v.toml", include_str!("../square_v.toml")),
    ("random_b.toml", include_str!("../random_b.toml")),
];

/// Scripts beyond the campaign, which show what the language can do: file name and text.
pub const EXAMPLES: &[(&str, &str)] = &[
    ("angle_sine.toml", include_str!("../angle_sine.toml")),
    ("pressure_steps.toml", include_str!("../pressure_steps.toml")),
    ("multisine.toml", include_str!("../multisine.toml")),
];

/// JSON schema of the language (draft 7), for editors. What depends on more than one place of a script is beyond it: [`Script::parse`] has
/// the last word.
pub const SCHEMA: &str = include_str!("../profile.schema.json");

/// The built-in scripts, parsed, in the order of [`BUILTIN`].
///
/// # Errors
/// None in a released state: a test parses them all.
pub fn builtin() -> Result<Vec<Script>, ScriptError> {
    BUILTIN.iter().map(|(file, text)| Script::parse(text, file)).collect()
}

/// Why scripts could not be loaded from files.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// A script could not be read.
    #[error("{path}: expected a script (*.toml), got \"{source}\"; check the name and the permissions")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A folder could not be read.
    #[error("{path}: expected a folder of scripts, got \"{source}\"; check the name and the permissions")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The folder holds no script.
    #[error("{path}: expected at least one script (*.toml), got none")]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// A script is wrong.
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// Two scripts would write the same run.
    #[error("{second}: the name {name:?} is already that of {first}: rename one")]
    DuplicateName {
        /// The name that both have.
        name: String,
        /// The file that has it first.
        first: String,
        /// The file that has it again.
        second: String,
    },
}

/// All scripts (`*.toml`, but no `Cargo.toml`) of a folder, in the order of their file names.
///
/// # Errors
/// An unreadable folder or file, a folder without scripts, the first script that is wrong, two of one name.
pub fn load_folder(folder: &Path) -> Result<Vec<Script>, LoadError> {
    let read_error = |path: &Path| {
        let path = path.to_owned();
        move |source| LoadError::Folder { path, source }
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read_error(folder))? {
        let path = entry.map_err(read_error(folder))?.path();
        let is_script = path.extension().is_some_and(|ext| ext == "toml");
        if is_script && path.file_name().is_some_and(|name| name != "Cargo.toml") {
            files.push(path);
        }
    }
    files.sort();
    let mut scripts: Vec<Script> = Vec::with_capacity(files.len());
    for path in files {
        let script = Script::read(&path)?;
        if let Some(first) = scripts.iter().find(|first| first.name == script.name) {
            return Err(LoadError::DuplicateName { name: script.name, first: first.file.clone(), second: script.file });
        }
        scripts.push(script);
    }
    if scripts.is_empty() {
        return Err(LoadError::Empty { path: folder.to_owned() });
    }
    Ok(scripts)
}
