//! docs/TUTORIAL.md, followed to the letter in an empty folder.
#![allow(clippy::unwrap_used, reason = "a test")]

mod guides;

const TUTORIAL: &str = include_str!("../../docs/TUTORIAL.md");

#[test]
fn the_tutorial_does_what_it_says() {
    let dir = tempfile::tempdir().unwrap();
    guides::follow(TUTORIAL, "docs/TUTORIAL.md", dir.path());
    let findings = std::fs::read_to_string(dir.path().join("campaign/analysis/findings.json")).unwrap();
    let findings: serde_json::Value = serde_json::from_str(&findings).unwrap();
    let effects = findings["effects"].as_array().unwrap();
    assert_eq!(effects.iter().map(|e| &e["id"]).collect::<Vec<_>>(), ["cross_leakage"]);
    let k = effects[0]["parameters"]["k"]["value"].as_f64().unwrap();
    assert!((k / 0.15 - 1.0).abs() < 0.05, "the text promises the value of plant.toml, got {k}");
    let listing = std::fs::read_to_string(dir.path().join("listing.json")).unwrap();
    assert!(serde_json::from_str::<serde_json::Value>(&listing).unwrap().is_array(), "{listing}");
}

#[test]
fn a_command_that_fails_or_a_line_that_is_not_said_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let wrong = |document: &'static str| {
        let dir = dir.path().to_owned();
        std::panic::catch_unwind(move || guides::follow(document, "a document", &dir)).is_err()
    };
    assert!(!wrong("```sh\nbench --version | cut -d' ' -f1\n```\n\n```text\nbench\n```\n"));
    assert!(wrong("```sh\nbench --version\n```\n\n```text\nanother line\n```\n"));
    assert!(wrong("```sh\nbench levitate | cat\n```\n"));
    assert!(wrong("no commands at all"));
}
