//! Shared memory that a killed process left half made, and how nobody waits for it for ever.
//!
//! A service's memory is made in two steps, a name and then a size. Who is killed between them leaves a name of size zero, and
//! iceoryx2 0.10.0 waits for its size without an end (`posix_shared_memory.rs`, `open_impl`: `MappingSizeIsZero` looks at no
//! timeout): at the next removal of dead nodes, in whichever process comes first, of whichever instance. It asks again every
//! millisecond, and goes on once the name is gone.

use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, SystemTime};

use iceoryx2::config::Config;
use iceoryx2::node::NodeCreationFailure;
use iceoryx2::prelude::*;

use crate::link::{Ipc, quieten};

/// Where POSIX shared memory has its names on Linux.
const SHARED_MEMORY: &str = "/dev/shm";
/// The two steps are microseconds apart; what had no size for so long gets none.
const ABANDONED_AFTER: Duration = Duration::from_secs(1);
/// Time between two looks while something is waited for.
const AGAIN: Duration = Duration::from_millis(250);

/// A node of this process. Dead nodes are removed here and where a service is opened, both [`watched`]; not when it is dropped,
/// where nobody watches.
pub(crate) fn node() -> Result<Node<Ipc>, NodeCreationFailure> {
    let mut config = Config::global_config().clone();
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    // Signals belong to the program: its handlers zero the outputs first.
    NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled).create()
}

/// Does `work` with the transport, which may remove what dead processes left; what they left half made is removed before it, and
/// while it lasts.
pub(crate) fn watched<T>(work: impl FnOnce() -> T) -> T {
    quieten();
    let remove = || remove_abandoned(Path::new(SHARED_MEMORY), SystemTime::now());
    remove();
    let (done, waiting) = mpsc::channel::<()>();
    thread::scope(move |scope| {
        let watch = move || {
            while waiting.recv_timeout(AGAIN) == Err(RecvTimeoutError::Timeout) {
                remove();
            }
        };
        // Without the thread only what another process leaves during the work is missed.
        if let Err(error) = thread::Builder::new().name("leftovers".to_owned()).spawn_scoped(scope, watch) {
            tracing::debug!(%error, "nobody watches for half-made shared memory");
        }
        let result = work();
        drop(done);
        result
    })
}

/// Removes the transport's files in `folder` that have had no size for longer than it takes to give them one.
fn remove_abandoned(folder: &Path, now: SystemTime) {
    let prefix = Config::global_config().global.prefix.to_string();
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let is_ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(&prefix));
        let abandoned = is_ours
            && entry.metadata().is_ok_and(|meta| {
                let age = meta.modified().ok().and_then(|at| now.duration_since(at).ok());
                meta.is_file() && meta.len() == 0 && age.is_some_and(|age| age > ABANDONED_AFTER)
            });
        if !abandoned {
            continue;
        }
        let path = entry.path();
        match std::fs::remove_file(&path) {
            Ok(()) => tracing::debug!(path = %path.display(), "removed: a killed process left it half made"),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => tracing::warn!(
                path = %path.display(), %error,
                "a killed process left this half made, and it can't be removed; programs may wait for it until its owner does"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_old_empty_and_of_the_transport_is_removed() {
        let folder = std::env::temp_dir().join(format!("rt-core-leftovers-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (name, text) in [("iox2_a.dynamic", ""), ("iox2_b.dynamic", "sized"), ("other", "")] {
            std::fs::write(folder.join(name), text).unwrap();
        }
        let left = || {
            let mut names: Vec<_> =
                std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
            names.sort();
            names
        };
        remove_abandoned(&folder, SystemTime::now());
        assert_eq!(left(), ["iox2_a.dynamic", "iox2_b.dynamic", "other"], "it may be in the making");
        remove_abandoned(&folder, SystemTime::now() + ABANDONED_AFTER * 2);
        assert_eq!(left(), ["iox2_b.dynamic", "other"]);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_work_s_result_comes_back_and_its_panic_too() {
        assert_eq!(watched(|| 7), 7);
        assert!(std::panic::catch_unwind(|| watched(|| panic!("as it is"))).is_err());
    }
}
