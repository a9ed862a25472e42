//! `bench info` and `bench ls`: what they say of good recordings, and of those that are not.
#![allow(clippy::unwrap_used, reason = "a test")]

mod exchange;

use exchange::*;
use recordings::Protocol;
use serde_json::Value;
use std::fs;

#[test]
fn a_good_recording_is_called_good_and_its_numbers_are_right() {
    let dir = tempfile::tempdir().unwrap();
    let mcap = dir.path().join("a.mcap");
    record(&mcap, Protocol::SquareWave, 5_000, Flaws::default());
    let said = done(&["info", text(&mcap)]);
    assert!(said.lines().next().unwrap().ends_with("a.mcap: good"), "{said}");
    for word in ["5000 of 5000 samples", "square-wave", "4.999 s", "1000.0 Hz", "10 segments", "20 steps", "rig.toml"] {
        assert!(said.contains(word), "{word:?} is missing in: {said}");
    }
    assert!(said.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "a plot");
    let all: Value = serde_json::from_str(&done(&["info", "--json", text(&mcap)])).unwrap();
    let info = &all[0];
    assert_eq!((info["good"].as_bool(), info["samples"].as_u64()), (Some(true), Some(5_000)));
    let channel = |name: &str| info["channels"].as_array().unwrap().iter().find(|c| c["name"] == name).unwrap().clone();
    let angles: Vec<f64> = (0..5_000).map(|tick| sample(tick).angle_deg).collect();
    let extreme = |pick: fn(f64, f64) -> f64| angles.iter().copied().reduce(pick);
    assert_eq!(channel("angle_deg")["lowest"].as_f64(), extreme(f64::min));
    assert_eq!(channel("angle_deg")["highest"].as_f64(), extreme(f64::max));
    let mean = angles.iter().sum::<f64>() / 5_000.0;
    assert!((channel("angle_deg")["mean"].as_f64().unwrap() - mean).abs() < 1e-9);
    assert_eq!(channel("torque_nm")["values"].as_u64(), Some(1_667));
    assert_eq!(channel("supply_v")["values"].as_u64(), Some(250));
    assert_eq!(info["events"].as_array().unwrap().len(), 13);
    // Lateness goes round from 0 to 10 us.
    assert_eq!(info["lateness_ns"]["longest"].as_u64().unwrap() / 1_000, 10);
    let page = dir.path().join("a.html");
    done(&["info", "--page", text(&page), text(&mcap)]);
    let html = fs::read_to_string(&page).unwrap();
    assert!(html.contains("pressure2_bar") && html.contains("&quot;a&quot; # &lt;&amp;&gt;"), "escaped");
    refused(&["info", "--page", text(&page), text(&mcap)], &["a.html", "nothing is overwritten"]);
}

#[test]
fn what_is_wrong_with_a_recording_stands_in_the_first_line() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let bad = |name: &str, words: &[&str]| {
        let (code, stdout, stderr) = bench(&["info", "--no-plot", text(&at(name))]);
        assert_eq!(code, 3, "{stdout}{stderr}");
        let first = stdout.lines().next().unwrap();
        assert!(first.contains("NOT GOOD"), "{first}");
        for word in words {
            assert!(first.contains(word), "{word:?} is missing in: {first}");
        }
    };
    record(&at("lossy.mcap"), Protocol::SquareWave, 3_000, Flaws { gap: Some((5, 9)), ..Flaws::default() });
    bad("lossy.mcap", &["lossy", "2995 of 3000"]);
    record(&at("no_end.mcap"), Protocol::SquareWave, 900, Flaws { no_end: true, ..Flaws::default() });
    bad("no_end.mcap", &["lossy"]);
    record(&at("tripped.mcap"), Protocol::SquareWave, 900, Flaws { trip: Some(700), ..Flaws::default() });
    bad("tripped.mcap", &["tripped", "0.700 s", "pressure 1"]);
    record(&at("whole.mcap"), Protocol::SquareWave, 9_000, Flaws::default());
    let bytes = fs::read(at("whole.mcap")).unwrap();
    fs::write(at("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).unwrap();
    bad("cut.mcap", &["damaged", "bench recover"]);
    fs::write(at("open.mcap.part"), &bytes[..bytes.len() * 2 / 3]).unwrap();
    bad("open.mcap.part", &["unfinished", "bench recover"]);
    fs::write(at("foreign.mcap"), "no recording").unwrap();
    refused(&["info", text(&at("foreign.mcap"))], &["foreign.mcap"]);
    refused(&["info", text(&at("none.mcap"))], &["none.mcap", "No such file"]);
}

#[test]
fn a_folder_is_listed_with_campaigns_loose_recordings_and_their_troubles() {
    let dir = tempfile::tempdir().unwrap();
    let campaign_dir = dir.path().join("2026-first");
    fs::create_dir_all(campaign_dir.join("analysis")).unwrap();
    record(&campaign_dir.join("a.mcap"), Protocol::SquareWave, 3_001, Flaws::default());
    record(&campaign_dir.join("b.mcap"), Protocol::ClampSteps, 3_001, Flaws { gap: Some((5, 9)), ..Flaws::default() });
    campaign(&campaign_dir, &[("a.mcap", Protocol::SquareWave), ("b.mcap", Protocol::ClampSteps)]);
    fs::write(campaign_dir.join("analysis/model.toml"), "").unwrap();
    let findings = r#"{"verdict": "attributed", "effects": [{"id": "pump_lag"}]}"#;
    fs::write(campaign_dir.join("analysis/findings.json"), findings).unwrap();
    let whole = fs::read(campaign_dir.join("a.mcap")).unwrap();
    fs::write(campaign_dir.join("c.mcap.part"), &whole[..whole.len() / 2]).unwrap();
    fs::create_dir(dir.path().join("broken")).unwrap();
    fs::write(dir.path().join("broken/campaign.toml"), "format = 9\n").unwrap();
    record(&dir.path().join("loose.mcap"), Protocol::PumpMap, 61_001, Flaws::default());

    let all: Value = serde_json::from_str(&done(&["ls", "--json", text(dir.path())])).unwrap();
    let entry = |name: &str| {
        let found = all.as_array().unwrap().iter().filter(|entry| entry["path"].as_str().unwrap().ends_with(name));
        let found: Vec<_> = found.collect();
        assert_eq!(found.len(), 1, "{name} in {all}");
        found[0].clone()
    };
    assert_eq!(all.as_array().unwrap().len(), 4, "the campaign's own runs are not listed twice: {all}");
    let first = entry("2026-first");
    assert_eq!(
        (first["runs"].as_u64(), first["validate"].as_u64(), first["lost"].as_u64()),
        (Some(2), Some(2), Some(5))
    );
    assert_eq!(
        (first["holds"].as_str(), first["verdict"].as_str()),
        (Some("clamp-steps square-wave"), Some("attributed pump_lag"))
    );
    assert!((first["duration_s"].as_f64().unwrap() - 6.0).abs() < 1e-9);
    assert!(first["model"].as_str().unwrap().ends_with("analysis/model.toml"));
    assert!(first["trouble"][0].as_str().unwrap().contains("b.mcap: lossy"));
    assert_eq!(
        (entry("c.mcap.part")["kind"].as_str(), entry("loose.mcap")["kind"].as_str()),
        (Some("unfinished"), Some("recording"))
    );
    assert!(entry("broken")["trouble"][0].as_str().unwrap().contains("format"));

    let said = done(&["ls", text(dir.path())]);
    for word in ["2026-first", "1:01", "0/2", "verdict attributed pump_lag", "bench recover", "loose.mcap", "pump-map"]
    {
        assert!(said.contains(word), "{word:?} is missing in: {said}");
    }
    assert!(done(&["ls", text(&campaign_dir)]).contains("campaign"), "a campaign's own folder");
    refused(&["ls", text(&dir.path().join("none"))], &["none", "No such file"]);
    let empty = tempfile::tempdir().unwrap();
    assert!(done(&["ls", text(empty.path())]).contains("no recordings"));
}
