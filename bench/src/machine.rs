//! The machine and the program that ran the loop, for the recording.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Program, version and commit: `rec-bench 0.1.0 (commit 0123456789ab)`. `unknown` where it was not built out of a repository; `with changes`
/// where its sources were not those of the commit.
pub fn program() -> String {
    let commit = option_env!("REC_BENCH_COMMIT").unwrap_or("unknown");
    format!("rec-bench {} (commit {commit})", env!("CARGO_PKG_VERSION"))
}

/// What of this machine bears on a run: `hostname`, `kernel` (release and version), `machine` (architecture), `cpu_model`, `cpus` (those
/// that are on line), `memory_gib`. What the system does not tell is left out. Nothing of it changes while the machine runs, so that
/// the same run on it gives the same recording.
pub fn host() -> BTreeMap<String, String> {
    below(Path::new("/"))
}

/// The same of the machine whose `/proc` is below `root`.
fn below(root: &Path) -> BTreeMap<String, String> {
    let text = |path: &str| fs::read_to_string(root.join(path)).ok().map(|text| text.trim().to_owned());
    let cpuinfo = text("proc/cpuinfo").unwrap_or_default();
    let release = text("proc/sys/kernel/osrelease");
    let version = text("proc/sys/kernel/version").map_or(String::new(), |version| format!(" {version}"));
    let cpus = cpuinfo.lines().filter(|line| key(line) == Some("processor")).count();
    let facts = [
        ("hostname", text("proc/sys/kernel/hostname")),
        ("kernel", release.map(|release| format!("Linux {release}{version}"))),
        ("machine", Some(text("proc/sys/kernel/arch").unwrap_or_else(|| std::env::consts::ARCH.to_owned()))),
        ("cpu_model", model(&cpuinfo)),
        ("cpus", (cpus > 0).then(|| cpus.to_string())),
        ("memory_gib", text("proc/meminfo").and_then(|meminfo| memory_gib(&meminfo))),
    ];
    facts.into_iter().filter_map(|(name, fact)| Some((name.to_owned(), fact?))).collect()
}

/// Name of a line `name : value`.
fn key(line: &str) -> Option<&str> {
    Some(line.split_once(':')?.0.trim())
}

/// x86 calls it `model name`; a device tree's name of the whole board is `Model`.
fn model(cpuinfo: &str) -> Option<String> {
    let named = |name: &str| {
        let line = cpuinfo.lines().find(|line| key(line) == Some(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    ["model name", "Model", "cpu model", "Hardware"].into_iter().find_map(named).filter(|model| !model.is_empty())
}

/// Rounded: the kernel's own share changes a little from boot to boot.
fn memory_gib(meminfo: &str) -> Option<String> {
    let total = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: f64 = total.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(format!("{:.1}", kib / (1024.0 * 1024.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_is_told_as_its_kernel_tells_it() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        for (path, text) in [
            ("proc/sys/kernel/hostname", "rig-1\n"),
            ("proc/sys/kernel/osrelease", "6.1.0-rt\n"),
            ("proc/sys/kernel/version", "#1 SMP PREEMPT_RT\n"),
            ("proc/sys/kernel/arch", "aarch64\n"),
            ("proc/cpuinfo", "processor\t: 0\nBogoMIPS\t: 108\n\nprocessor\t: 1\n\nModel\t\t: Board 4: B\n"),
            ("proc/meminfo", "MemTotal:        3882972 kB\nMemFree: 1 kB\n"),
        ] {
            let path = dir.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("writable");
            fs::write(path, text).expect("writable");
        }
        let expected = [
            ("hostname", "rig-1"),
            ("kernel", "Linux 6.1.0-rt #1 SMP PREEMPT_RT"),
            ("machine", "aarch64"),
            ("cpu_model", "Board 4: B"),
            ("cpus", "2"),
            ("memory_gib", "3.7"),
        ];
        assert_eq!(below(dir.path()), expected.map(|(name, fact)| (name.to_owned(), fact.to_owned())).into());
    }

    #[test]
    fn what_is_not_told_is_left_out() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        assert_eq!(below(dir.path()).into_keys().collect::<Vec<_>>(), ["machine"]);
    }

    #[test]
    fn this_machine_and_program_have_a_name() {
        let host = host();
        assert!(host["kernel"].starts_with("Linux ") && host["cpus"].parse::<u32>().is_ok(), "{host:?}");
        assert_eq!(host, super::host());
        let program = program();
        assert!(program.starts_with("rec-bench ") && program.contains("(commit "), "{program}");
    }
}
