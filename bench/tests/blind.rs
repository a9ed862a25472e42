//! Blind trials as a user starts them: one sealed campaign diagnosed and opened, and a run that goes on where it was.

#![allow(clippy::unwrap_used, reason = "a test that can't go on fails")]

use recordings::Campaign;
use serde_json::Value;
use std::fs;
use std::process::{Command, Output};

fn blind(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench")).arg("blind").args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A case without effect: its diagnosis is quick.
const SEED: &str = "1";
const CASE: &str = "0";

#[test]
fn a_case_is_diagnosed_opened_and_not_done_twice() {
    let dir = tempfile::tempdir().unwrap();
    let (out, keep) = (dir.path().join("blind.json"), dir.path().join("kept"));
    let arguments = ["--seed", SEED, "--case", CASE, "--out", out.to_str().unwrap(), "--keep", keep.to_str().unwrap()];
    let first = blind(&arguments);
    let said = text(&first.stdout);
    assert!(first.status.success(), "{:?}\n{said}\n{}", first.status, text(&first.stderr));
    assert!(said.starts_with("case   0 none     nothing -> none (right)"), "the seed draws another case now: {said}");
    assert!(said.contains("false alarms without effect"), "{said}");

    let written: Value = serde_json::from_str(&fs::read_to_string(&out).unwrap()).unwrap();
    let case = &written["cases"][0];
    assert_eq!((&written["seed"], &case["kind"], &case["outcome"]), (&"1".into(), &"none".into(), &"right".into()));
    assert!((0.9..1.3).contains(&case["figures"]["before"].as_f64().unwrap()), "{}", case["figures"]);

    // what is kept is a campaign like any other, and the truth does not lie in it
    let campaign = Campaign::open(&keep.join("case-0")).unwrap();
    assert_eq!(campaign.runs.len(), 11);
    campaign.runs.iter().for_each(|run| assert!(campaign.read(run).unwrap().len() > 100, "{}", run.file));
    assert!(keep.join("case-0-truth.toml").exists());
    assert!(
        fs::read_dir(keep.join("case-0"))
            .unwrap()
            .all(|f| !text(f.unwrap().file_name().as_encoded_bytes()).contains("truth"))
    );

    // the same command again has nothing to do, and says the same
    let before = fs::read(&out).unwrap();
    let again = blind(&arguments);
    assert!(again.status.success());
    assert!(text(&again.stderr).contains("1 of 1 cases are there already"), "{}", text(&again.stderr));
    assert_eq!(fs::read(&out).unwrap(), before);
    let table = |said: &str| said[said.find("\ncases ").unwrap()..].to_owned();
    assert_eq!(table(&said), table(&text(&again.stdout)));

    // as has a machine that is given the file of the one that did it
    let elsewhere = dir.path().join("elsewhere.json");
    let shared =
        ["--seed", SEED, "--cases", "1", "--with", out.to_str().unwrap(), "--out", elsewhere.to_str().unwrap()];
    let shared = blind(&shared);
    assert!(text(&shared.stderr).contains("1 of 1 cases are there already"), "{}", text(&shared.stderr));
    assert_eq!(table(&said), table(&text(&shared.stdout)));
    let counted: Value = serde_json::from_str(&fs::read_to_string(&elsewhere).unwrap()).unwrap();
    assert_eq!(counted["cases"], written["cases"], "what was counted is in the file");

    // results of another diagnosis are shown as they are, and never added to
    let mut other = written;
    other["cases"][0]["diagnosis"] = "0123456789ab".into();
    fs::write(&out, other.to_string()).unwrap();
    assert!(blind(&arguments).status.success());
    let refused = blind(&["--seed", SEED, "--cases", "2", "--out", out.to_str().unwrap()]);
    let why = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2), "{why}");
    ["case 0", "0123456789ab", "another --out"].iter().for_each(|words| assert!(why.contains(words), "{why}"));
    assert_eq!(fs::read_to_string(&out).unwrap(), other.to_string());
}

#[test]
fn what_does_not_fit_is_said_before_anything_is_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("blind.json");
    let refused = |arguments: &[&str], words: &[&str]| {
        let output = blind(arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        words.iter().for_each(|word| assert!(said.contains(word), "{arguments:?}: {said}"));
    };
    refused(&["--only", "several"], &["several", "outside"]);
    refused(&["--cases", "0"], &["0"]);
    refused(&["--cases", "20", "--from", "20"], &["--from 20", "--cases 20"]);
    refused(&["--with", "nowhere.json"], &["nowhere.json", "No such file"]);
    fs::write(&out, r#"{"format": 1, "seed": "7", "cases": []}"#).unwrap();
    refused(&["--seed", "8", "--out", out.to_str().unwrap()], &["seed 8", "seed 7", "another file"]);
    fs::write(&out, "{}").unwrap();
    refused(&["--seed", "8", "--out", out.to_str().unwrap()], &["blind.json", "a file that is none"]);
}

#[test]
fn results_of_several_seeds_are_counted_together_and_each_case_once() {
    let kept = |seed: &str| format!("{}/../benchmarks/blind/{seed}.json", env!("CARGO_MANIFEST_DIR"));
    let (one, other) = (kept("20261203"), kept("20261204"));
    let output = blind(&["--count", &one, &other, &one]);
    let said = text(&output.stdout);
    assert!([Some(0), Some(3)].contains(&output.status.code()), "{}", text(&output.stderr));
    assert!(said.contains("44 cases of 2 seeds, by the diagnosis of 2 commits"), "{said}");
    assert!(said.contains(" 0 of  11 "), "no false alarm in six and five: {said}");
    let output = blind(&["--count", &one, "--cases", "5"]);
    assert_eq!(output.status.code(), Some(2), "a count draws nothing");
}
