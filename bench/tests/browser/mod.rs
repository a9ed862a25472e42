//! Node, its packages and Chromium, for tests of the web monitor.
//!
//! The packages lie below the target directory, installed once for each content of `package-lock.json`. Where node, npm, chromium or the
//! package registry is missing the test says so on stderr and is left out; with `REC_BENCH_PEERS=required` it fails instead.

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const POLICY: &str = "REC_BENCH_PEERS";
const BROWSERS: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// What the scripts beside this file need.
pub struct Peers {
    /// Folder that holds `node_modules`.
    pub packages: PathBuf,
    /// The browser's program.
    pub chromium: PathBuf,
}

/// Where this file and the scripts lie.
pub fn scripts() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser")
}

/// Node alone, without packages or a browser.
///
/// # Panics
/// Where it can't be had and `REC_BENCH_PEERS=required`.
pub fn node() -> Option<PathBuf> {
    or_say(program(&["node", "nodejs"]))
}

/// Node with its packages, and a browser.
///
/// # Panics
/// Where they can't be had and `REC_BENCH_PEERS=required`.
pub fn peers() -> Option<Peers> {
    or_say(program(&["node", "nodejs"]).and_then(|_| {
        let chromium = program(&BROWSERS)?;
        Ok(Peers { packages: packages()?, chromium })
    }))
}

fn or_say<T>(found: Result<T, String>) -> Option<T> {
    let why = match found {
        Ok(found) => return Some(found),
        Err(why) => why,
    };
    let test = std::thread::current().name().unwrap_or("?").to_owned();
    let text = format!(
        "\n*** NOT RUN: {test}: it needs node, npm with a package registry, and chromium.\n*** {}\n*** To run it: apt-get install nodejs npm \
         chromium, then {POLICY}=required cargo test --release -p bench --test web_monitor {test}\n\n",
        why.trim().replace('\n', "\n*** "),
    );
    assert!(std::env::var(POLICY).as_deref() != Ok("required"), "{text}");
    // The test harness swallows what `eprint` prints, not this.
    std::io::stderr().write_all(text.as_bytes()).unwrap();
    None
}

/// The first of these programs that is on the path.
fn program(names: &[&str]) -> Result<PathBuf, String> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = names
        .iter()
        .find_map(|name| std::env::split_paths(&path).map(|dir| dir.join(name)).find(|file| file.is_file()));
    found.ok_or_else(|| format!("none of {} is on the path", names.join(", ")))
}

/// Finds or installs the packages. One test binary at a time: the others wait for the lock.
fn packages() -> Result<PathBuf, String> {
    let files = ["package.json", "package-lock.json", ".npmrc"].map(|name| (name, scripts().join(name)));
    let mut hasher = DefaultHasher::new();
    for (_, file) in &files {
        fs::read(file).map_err(|e| at(file, e))?.hash(&mut hasher);
    }
    let root = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let home = root.join(format!("browser-{:016x}", hasher.finish()));
    let complete = home.join("complete");
    fs::create_dir_all(root).map_err(|e| at(root, e))?;
    let lock_path = home.with_extension("lock");
    let lock = File::create(&lock_path).map_err(|e| at(&lock_path, e))?;
    // Released with the file.
    lock.lock().map_err(|e| at(&lock_path, e))?;
    if complete.exists() {
        return Ok(home);
    }
    if home.exists() {
        fs::remove_dir_all(&home).map_err(|e| at(&home, e))?;
    }
    fs::create_dir_all(&home).map_err(|e| at(&home, e))?;
    for (name, file) in &files {
        fs::copy(file, home.join(name)).map_err(|e| at(file, e))?;
    }
    run(Command::new("npm").args(["ci", "--no-audit", "--no-fund", "--ignore-scripts"]).current_dir(&home))?;
    fs::write(&complete, "").map_err(|e| at(&complete, e))?;
    Ok(home)
}

fn at(path: &Path, e: std::io::Error) -> String {
    format!("{}: {e}", path.display())
}

/// Runs a command to its end; what it said where it fails.
pub fn run(command: &mut Command) -> Result<Output, String> {
    let output = command.output().map_err(|e| format!("{command:?}: {e}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let (told, complained) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    Err(format!("{command:?} ended with {}\n{told}{complained}", output.status))
}
