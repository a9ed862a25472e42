//! The main job from end to end, as a user starts it: emulated rig, campaign, model, named effect.

#![allow(clippy::unwrap_used, reason = "a test that can't go on fails")]

use std::fs;
use std::path::Path;
use std::process::Command;

/// Draws a pressure sensor with an offset: an effect whose diagnosis is quick.
const SEED: &str = "2";

fn demo(out: &Path) -> String {
    let output =
        Command::new(env!("CARGO_BIN_EXE_bench")).args(["demo", "--seed", SEED, "--out"]).arg(out).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{:?}\n{said}\n{errors}", output.status);
    said + &errors
}

#[test]
fn the_demo_names_the_sealed_effect_and_the_same_seed_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let (first, second) = (dir.path().join("first"), dir.path().join("second"));
    let said = demo(&first);
    let truth = fs::read_to_string(first.join("sealed/truth.toml")).unwrap();
    assert!(truth.contains("id = \"pressure_drift\""), "the seed draws another effect now: {truth}");
    assert!(said.contains("the diagnosis named it"), "{said}");

    let findings: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(first.join("analysis/findings.json")).unwrap()).unwrap();
    assert_eq!(findings["verdict"], "attributed");
    assert_eq!(findings["effects"][0]["id"], "pressure_drift");
    for entry in findings["validation"].as_array().unwrap() {
        let number = |key: &str| entry[key].as_f64().unwrap();
        assert!(number("rmse_after") < 1.1 * number("noise_floor"), "{entry}");
    }
    let worst = |key: &str| {
        let ratio = |e: &serde_json::Value| e[key].as_f64().unwrap() / e["noise_floor"].as_f64().unwrap();
        findings["validation"].as_array().unwrap().iter().map(ratio).fold(0.0, f64::max)
    };
    assert!(worst("rmse_before") > 2.0, "the effect mattered: {}", worst("rmse_before"));
    let report = fs::read_to_string(first.join("analysis/report.html")).unwrap();
    assert!(report.contains("uPlot") && !report.contains("src=\"http"), "a report that needs no network");

    // the recordings, the model and the findings of the same seed are the same bytes
    demo(&second);
    let mut compared = 0;
    for entry in fs::read_dir(&first).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "mcap") {
            assert_eq!(fs::read(&path).unwrap(), fs::read(second.join(path.file_name().unwrap())).unwrap(), "{path:?}");
            compared += 1;
        }
    }
    assert_eq!(compared, 11);
    for file in ["campaign.toml", "analysis/model.toml", "analysis/findings.json", "sealed/truth.toml"] {
        assert_eq!(fs::read(first.join(file)).unwrap(), fs::read(second.join(file)).unwrap(), "{file}");
    }
}
