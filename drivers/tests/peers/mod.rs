//! Python with pinned packages, for tests against programs that nobody here wrote. Other crates' tests take this file by its path.
//!
//! [`python`] makes a virtual environment below the target directory, once for each set of packages. It needs `python3` with `venv`
//! and, the first time, a package index. Where one is missing the test says so on stderr and is left out; with
//! `REC_BENCH_PEERS=required` it fails instead.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// This variable with the value `required` makes a peer that can't be had a failure.
const POLICY: &str = "REC_BENCH_PEERS";

/// The interpreter of an environment that holds `packages`, each pinned (`cantools==45.1.0`); `None` where it can't be had here, which
/// is then said on stderr. The test returns early on `None`.
///
/// # Panics
/// Where it can't be had and `REC_BENCH_PEERS=required`.
pub fn python(packages: &[&str]) -> Option<PathBuf> {
    for package in packages {
        assert!(package.contains("=="), "expected a pinned package (name==version), got {package}");
    }
    match environment(packages) {
        Ok(python) => Some(python),
        Err(why) => {
            let test = std::thread::current().name().unwrap_or("?").to_owned();
            let text = format!(
                "\n*** NOT RUN: {test}: it needs python3 with venv and the packages {}.\n*** {}\n*** To run it: install python3 and \
                 python3-venv, let pip reach a package index, then {POLICY}=required cargo test --release -p {} {test}\n\n",
                packages.join(", "),
                why.trim().replace('\n', "\n*** "),
                env!("CARGO_PKG_NAME"),
            );
            assert!(std::env::var(POLICY).as_deref() != Ok("required"), "{text}");
            // The test harness swallows what `eprint` prints, not this.
            std::io::stderr().write_all(text.as_bytes()).unwrap();
            None
        }
    }
}

/// Finds or makes the environment. One test binary at a time: the others wait for the lock.
fn environment(packages: &[&str]) -> Result<PathBuf, String> {
    let mut hasher = DefaultHasher::new();
    packages.hash(&mut hasher);
    let root = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let home = root.join(format!("peers-{:016x}", hasher.finish()));
    let (python, complete) = (home.join("bin/python"), home.join("complete"));
    let at = |path: &Path, e: std::io::Error| format!("{}: {e}", path.display());

    fs::create_dir_all(root).map_err(|e| at(root, e))?;
    let lock_path = home.with_extension("lock");
    let lock = File::create(&lock_path).map_err(|e| at(&lock_path, e))?;
    // Released with the file.
    lock.lock().map_err(|e| at(&lock_path, e))?;
    // An interpreter that was removed since leaves a dangling link behind.
    if complete.exists() && python.exists() {
        return Ok(python);
    }
    if home.exists() {
        fs::remove_dir_all(&home).map_err(|e| at(&home, e))?;
    }
    run(Command::new("python3").args(["-m", "venv"]).arg(&home))?;
    run(Command::new(&python).args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]).args(packages))?;
    fs::write(&complete, packages.join("\n")).map_err(|e| at(&complete, e))?;
    Ok(python)
}

fn run(command: &mut Command) -> Result<Output, String> {
    let output = command.output().map_err(|e| format!("{command:?}: {e}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let (told, complained) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    Err(format!("{command:?} ended with {}\n{told}{complained}", output.status))
}
