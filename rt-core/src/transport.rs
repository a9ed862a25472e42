//! The folder in which the transport lists its nodes and services, and whose it is.
//!
//! Whoever of a machine's users comes first makes it, and nobody else may write there (iceoryx2 0.10.0): every other user is refused. It stays
//! where iceoryx2 has it, since programs that are none of this project's look for the services there; a file of iceoryx2's own, which all of
//! them read, leads a user to another one.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use iceoryx2::config::Config;
use rustix::fs::{Access, access};
use rustix::process::geteuid;

use crate::link::quieten;

/// What to do where the folder is another user's.
pub const REMEDY: &str = "run all programs of the rig as that user, or lead this one's to a folder of its own: `root-path = \"/tmp/iceoryx2-NAME\"` below \
     `[global]` in ~/.config/iceoryx2/iceoryx2.toml (docs/RUNNING.md)";

/// Users by name.
const USERS: &str = "/etc/passwd";

/// A folder that this user may not use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Foreign {
    /// The folder.
    pub folder: PathBuf,
    /// Whose it is, by name where it has one.
    pub owner: String,
}

/// The transport's folder, by its configuration.
pub fn folder() -> PathBuf {
    quieten();
    // Without the slash at its end.
    Path::new(&Config::global_config().global.root_path().to_string()).components().collect()
}

/// The transport's folder where another user made it and this one may not use it.
pub fn foreign() -> Option<Foreign> {
    foreign_at(folder())
}

fn foreign_at(folder: PathBuf) -> Option<Foreign> {
    // Where it is not there yet, this user makes it.
    let owner = folder.metadata().ok()?.uid();
    let usable = access(&folder, Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK).is_ok();
    (!usable && owner != geteuid().as_raw()).then(|| Foreign { folder, owner: name_of(owner) })
}

fn name_of(user: u32) -> String {
    let users = std::fs::read_to_string(USERS).unwrap_or_default();
    let named = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        // Between the two stands the password's place.
        (fields.nth(1)?.parse::<u32>() == Ok(user)).then(|| name.to_owned())
    });
    named.unwrap_or_else(|| format!("user {user}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_own_folder_and_one_that_is_not_there_are_nobody_else_s() {
        assert_eq!(foreign_at(std::env::temp_dir().join("rt-core-no-such-folder")), None);
        let own = std::env::temp_dir().join(format!("rt-core-transport-{}", std::process::id()));
        std::fs::create_dir_all(&own).unwrap();
        assert_eq!(foreign_at(own.clone()), None);
        std::fs::remove_dir_all(&own).unwrap();
    }

    #[test]
    fn users_have_their_name_where_there_is_one() {
        assert_eq!(name_of(0), "root");
        assert_eq!(name_of(4_000_000_123), "user 4000000123");
    }

    #[test]
    fn the_folder_is_the_transport_s() {
        assert!(folder().is_absolute() && !folder().to_string_lossy().ends_with('/'), "{}", folder().display());
    }
}
