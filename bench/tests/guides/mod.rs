//! What the guides' tests have in common: the blocks of a document, run as a reader would.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A block of commands, and the lines that the document quotes of what they say.
pub struct Step {
    /// Line of the document at which it begins, from 1.
    pub line: usize,
    /// For a shell.
    pub commands: String,
    /// Lines of the output, as they stand.
    pub quoted: Vec<String>,
}

/// The blocks marked `sh`, each with the `text` blocks that follow it.
pub fn steps(document: &str) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    let mut lines = document.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let Some(language) = line.strip_prefix("```") else { continue };
        let block: Vec<&str> = lines.by_ref().map(|(_, line)| line).take_while(|line| *line != "```").collect();
        match (language, steps.last_mut()) {
            ("sh", _) => steps.push(Step { line: number + 1, commands: block.join("\n"), quoted: Vec::new() }),
            ("text", Some(step)) => step.quoted.extend(block.iter().map(ToString::to_string)),
            _ => {}
        }
    }
    steps
}

/// Runs the steps in `dir`, with the built program as `bench`, in order. Each must succeed and say what is quoted.
#[track_caller]
pub fn follow(document: &str, name: &str, dir: &Path) {
    let bench = Path::new(env!("CARGO_BIN_EXE_bench"));
    let path = format!(
        "{}:{}",
        bench.parent().expect("a program lies in a folder").display(),
        std::env::var("PATH").unwrap_or_default()
    );
    let steps = steps(document);
    assert!(!steps.is_empty(), "{name} has no commands");
    for Step { line, commands, quoted } in steps {
        let begun = Instant::now();
        let output = Command::new("bash")
            // What fails ends the block, in a pipe too.
            .args(["-euo", "pipefail", "-c", &format!("exec 2>&1\n{commands}")])
            .current_dir(dir)
            .env("PATH", &path)
            .env_remove("RUST_LOG")
            .stdin(Stdio::null())
            .output()
            .expect("bash is there");
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{name}, line {line}: {}\n{commands}\nsaid:\n{said}", output.status);
        for quote in quoted.iter().filter(|quote| !quote.trim().is_empty()) {
            assert!(said.lines().any(|said| said == quote), "{name}, line {line}: {quote:?} is not in:\n{said}");
        }
        let took: Duration = begun.elapsed();
        eprintln!("{name}, line {line}: {:.1} s", took.as_secs_f64());
    }
}
