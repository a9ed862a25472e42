//! Tells the program out of which commit it is built: `REC_BENCH_COMMIT`, and which commit last changed what a blind trial comes from:
//! `REC_BENCH_DIAGNOSIS`. Where there is no git or no repository (a tarball) both are left out, and the program says `unknown`.

use std::path::Path;
use std::process::Command;

/// What the program is made of, below the workspace's folder. A change elsewhere makes no other program.
const SOURCES: [&str; 19] = [
    "Cargo.toml",
    "Cargo.lock",
    "model/Cargo.toml",
    "model/src",
    "rt-core/Cargo.toml",
    "rt-core/src",
    "recordings/Cargo.toml",
    "recordings/proto",
    "recordings/src",
    "profiles",
    "drivers/Cargo.toml",
    "drivers/src",
    "identify/Cargo.toml",
    "identify/src",
    "bench/Cargo.toml",
    "bench/build.rs",
    "bench/assets",
    "bench/rigs",
    "bench/src",
];

/// What a blind trial's result comes from: rigs, experiments, identification, diagnosis and the libraries below them.
const DIAGNOSIS: [&str; 8] = [
    "Cargo.lock",
    "model/src",
    "rt-core/src",
    "recordings/src",
    "profiles",
    "drivers/src",
    "identify/src",
    "bench/src/blind",
];

fn main() {
    // From the crate's folder, where this runs: absolute paths would be those of another checkout where two share a target folder, and its commit with them.
    let root = Path::new("..");
    // A path that is not there would make cargo run this each time.
    let watch = |path: &Path| {
        if path.exists() {
            println!("cargo::rerun-if-changed={}", path.display());
        }
    };
    SOURCES.iter().for_each(|source| watch(&root.join(source)));
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        // Not the repository whose hook runs this; and nothing is locked or refreshed.
        for name in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
            command.env_remove(name);
        }
        let output = command.arg("--no-optional-locks").arg("-C").arg(root).args(arguments).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| text.trim().to_owned())
    };
    // The folder may lie in a repository that does not hold it.
    if git(&["ls-files", "--error-unmatch", "bench/Cargo.toml"]).is_none() {
        return;
    }
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else { return };
    // Each commit, checkout or reset writes a line there. Without such a log a branch's own file tells of most of them.
    let branch = git(&["symbolic-ref", "--quiet", "HEAD"]);
    for name in ["logs/HEAD", "HEAD", "packed-refs"].into_iter().chain(branch.as_deref()) {
        if let Some(path) = git(&["rev-parse", "--git-path", name]) {
            watch(&root.join(path));
        }
    }
    let with_changes = |commit: &str, paths: &[&str]| {
        let status = [&["status", "--porcelain", "--untracked-files=no", "--"], paths].concat();
        let changed = git(&status).is_none_or(|changes| !changes.is_empty());
        format!("{commit}{}", if changed { " with changes" } else { "" })
    };
    println!("cargo::rustc-env=REC_BENCH_COMMIT={}", with_changes(&commit, &SOURCES));
    let last = git(&[&["log", "-1", "--abbrev=12", "--format=%h", "--"], &DIAGNOSIS[..]].concat());
    if let Some(last) = last.filter(|last| !last.is_empty()) {
        println!("cargo::rustc-env=REC_BENCH_DIAGNOSIS={}", with_changes(&last, &DIAGNOSIS));
    }
}
