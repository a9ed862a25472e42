//! What a script meets: docs/SCRIPTS.md as it stands, JSON alone on stdout, completions that complete.
#![allow(clippy::unwrap_used, reason = "a test")]

mod guides;

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const SCRIPTS: &str = include_str!("../../docs/SCRIPTS.md");

fn bench(dir: &Path, arguments: &[&str]) -> Output {
    let bench = env!("CARGO_BIN_EXE_bench");
    Command::new(bench).args(arguments).current_dir(dir).env_remove("RUST_LOG").output().unwrap()
}

/// Exit code and stdout, which must be one JSON value.
#[track_caller]
fn json(dir: &Path, arguments: &[&str]) -> (i32, Value) {
    let output = bench(dir, arguments);
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let value = serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{arguments:?}: {e}\n{stdout}\n{stderr}"));
    (output.status.code().unwrap(), value)
}

/// The keys that the document's table has in the row of a command, without those in brackets.
fn documented(command: &str) -> Vec<String> {
    let row = SCRIPTS.lines().find(|line| line.starts_with(&format!("| `{command} --json` |")));
    let keys = row.unwrap_or_else(|| panic!("{command} is not in docs/SCRIPTS.md")).split(" | ").nth(2).unwrap();
    let (mut depth, mut plain) = (0, String::new());
    for c in keys.chars() {
        depth += i32::from(c == '(') - i32::from(c == ')');
        if depth == 0 {
            plain.push(c);
        }
    }
    plain.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

#[track_caller]
fn has_keys(value: &Value, command: &str) {
    let object = value.as_object().unwrap_or_else(|| panic!("{command}: no object: {value}"));
    let keys = documented(command);
    assert!(!keys.is_empty(), "{command}");
    for key in keys {
        assert!(object.contains_key(&key), "{command}: {key} is not in {:?}", object.keys().collect::<Vec<_>>());
    }
}

#[test]
fn the_document_does_what_it_says() {
    let dir = tempfile::tempdir().unwrap();
    guides::follow(SCRIPTS, "docs/SCRIPTS.md", dir.path());
    let read = |name: &str| -> Value {
        serde_json::from_str(&std::fs::read_to_string(dir.path().join(name)).unwrap()).unwrap()
    };
    assert_eq!(read("check.json")["fits"], false);
    has_keys(&read("run.json"), "run");
    has_keys(&read("info.json")[0], "info");
    has_keys(&read("plan.json"), "campaign --plan-only");
    has_keys(&read("profiles.json")[0], "profile list");
    assert_eq!(read("info.json")[0]["samples"], read("run.json")["samples"]);
    let man = std::fs::read_dir(dir.path().join("man/man1")).unwrap().count();
    assert!(man > bench::commands::COMMANDS.len(), "{man} pages");
}

#[test]
fn the_exit_codes_in_the_document_are_the_program_s() {
    for (code, meaning) in bench::failure::EXIT_CODES {
        assert!(SCRIPTS.contains(&format!("| {code} | {meaning} |")), "{code}: {meaning}");
    }
}

#[test]
fn a_run_that_trips_says_so_in_json_and_by_its_exit_code() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("narrow.toml"), "[limits]\nangle_max_deg = 20.0\n").unwrap();
    let (code, run) = json(
        dir.path(),
        &["run", "square_h", "--rig", "narrow.toml", "--out", "a.mcap", "--instance", "scripts-trip", "--json"],
    );
    assert_eq!((code, &run["outcome"], &run["lossless"]), (5, &Value::from("tripped"), &Value::from(true)));
    assert!(run["trip"].as_str().unwrap().contains("angle"), "{run}");
    has_keys(&run, "run");
    // What ends before there is a result leaves stdout empty.
    let refused = bench(dir.path(), &["run", "square_h", "--rig", "none.toml", "--json"]);
    assert_eq!((refused.status.code(), refused.stdout.len()), (Some(2), 0));
}

#[test]
fn a_campaign_and_what_is_made_of_it_speak_json() {
    let dir = tempfile::tempdir().unwrap();
    let runs =
        ["torque_map", "volume_map", "pump_map", "clamp_steps", "constant_flow", "random_a", "square_a", "random_b"];
    let campaign: Vec<&str> = ["campaign", "--out", "c", "--json"].into_iter().chain(runs).collect();
    let (code, value) = json(dir.path(), &campaign);
    assert_eq!(code, 0);
    has_keys(&value, "campaign");
    assert_eq!(value["runs"].as_array().unwrap().len(), runs.len());
    has_keys(&json(dir.path(), &["ls", ".", "--json"]).1[0], "ls");

    let (code, identified) = json(dir.path(), &["identify", "c", "--json"]);
    assert_eq!(code, 0);
    has_keys(&identified, "identify");
    let m3 = &identified["parameters"]["m3"];
    assert!((m3["value"].as_f64().unwrap() - 6.8).abs() < 0.5 && m3["std"].as_f64().unwrap() > 0.0, "{m3}");
    assert!(identified["written"].as_array().unwrap().iter().all(|f| dir.path().join(f.as_str().unwrap()).is_file()));

    let model = "c/analysis/model.toml";
    let (code, same) = json(dir.path(), &["compare", model, model, "--json"]);
    assert_eq!((code, &same["agree"], &same["largest"]), (0, &Value::from(true), &Value::from(0.0)));
    has_keys(&same, "compare");
    let text = std::fs::read_to_string(dir.path().join(model)).unwrap();
    let moved: String = text
        .lines()
        .map(|line| {
            if line.starts_with("f1 = ") && !text.split("[std]").nth(1).unwrap().contains(line) {
                "f1 = 0.9\n".to_owned()
            } else {
                format!("{line}\n")
            }
        })
        .collect();
    std::fs::write(dir.path().join("moved.toml"), moved).unwrap();
    let (code, other) = json(dir.path(), &["compare", model, "moved.toml", "--json"]);
    assert_eq!((code, &other["agree"], &other["largest_of"]), (3, &Value::from(false), &Value::from("f1")));
}

#[test]
fn bash_completes_commands_and_options() {
    let dir = tempfile::tempdir().unwrap();
    let script = bench(dir.path(), &["completions", "bash"]);
    assert!(script.status.success());
    std::fs::write(dir.path().join("bench.bash"), &script.stdout).unwrap();
    let complete = |words: &str, at: usize| {
        let line = format!(
            "source ./bench.bash; COMP_WORDS=({words}); COMP_CWORD={at}; _bench bench \"${{COMP_WORDS[{at}]}}\" \"\"; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        );
        let output = Command::new("bash").args(["-c", &line]).current_dir(dir.path()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        said.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(complete("bench emu", 1), ["emulate"]);
    assert!(complete("bench run --real", 2).contains(&"--realtime".to_owned()));
    for shell in ["zsh", "fish", "elvish", "powershell"] {
        let script = bench(dir.path(), &["completions", shell]);
        let text = String::from_utf8_lossy(&script.stdout).into_owned();
        for entry in bench::commands::COMMANDS {
            assert!(text.contains(entry.name), "{} is not in the completions of {shell}", entry.name);
        }
    }
    assert_eq!(bench(dir.path(), &["completions", "tcsh"]).status.code(), Some(2));
}
