//! `bench latency`: every figure is there and fits the others. How long anything takes on this machine is not judged here.

use serde_json::Value;
use std::process::{Command, Output};

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench"))
        .args(arguments)
        .env_remove("RUST_LOG")
        .output()
        .expect("the binary was just built")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn number(object: &Value, key: &str) -> f64 {
    object[key].as_f64().unwrap_or_else(|| panic!("{key} is no number in {object}"))
}

/// Quantiles ascend; a distribution of at least `count` durations. Returns p50.
#[track_caller]
fn plausible(object: &Value, count: u64) -> f64 {
    let figures = ["p50", "p99", "p999", "max"].map(|key| number(object, key));
    assert!(figures.is_sorted(), "{object}");
    let slice_p99 = number(object, "slice_p99");
    assert!(slice_p99 >= 0.0 && slice_p99 <= figures[3], "{object}");
    assert!(object["count"].as_u64() >= Some(count), "expected {count} durations: {object}");
    figures[0]
}

#[test]
fn a_short_measurement_has_all_figures() {
    let output = bench(&["latency", "--seconds", "3", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let json: Value = serde_json::from_slice(&output.stdout).expect("stdout is one JSON object");

    let slices = json["slice_figures"].as_array().expect("a list");
    assert_eq!((number(&json, "slices"), number(&json, "slice_s")), (6.0, 0.5));
    let kinds: Vec<_> = slices.iter().map(|s| (s["kind"].as_str(), s["subscribers"].as_u64())).collect();
    let (real, bare) = (|n| (Some("loop"), Some(n)), (Some("bare"), None));
    assert_eq!(kinds, [real(0), bare, real(1), bare, real(10), bare]);

    // A period is either waited for or passed over; the machine may stall, so how many were passed over is open.
    let ticks = |kind: &str| -> u64 {
        let of_kind = slices.iter().filter(|s| s["kind"] == kind);
        of_kind.map(|s| s["ticks"].as_u64().expect("a count")).sum()
    };
    let (loop_ticks, bare_ticks) = (ticks("loop"), ticks("bare"));
    assert!((1..=1500).contains(&loop_ticks) && (1..=1500).contains(&bare_ticks));
    assert!(loop_ticks as f64 + number(&json, "skipped") >= 1500.0, "{json}");
    assert_eq!(json["lateness_us"]["count"], loop_ticks);
    assert_eq!(json["bare_us"]["count"], bare_ticks);
    let late: f64 = slices.iter().filter(|s| s["kind"] == "loop").map(|s| number(s, "over_2ms")).sum();
    assert_eq!(late, number(&json, "over_2ms"));
    assert!(number(&json, "over_2ms_bare") <= bare_ticks as f64);

    let (lateness, bare) = (plausible(&json["lateness_us"], 1), plausible(&json["bare_us"], 1));
    let ratio = number(&json["ratio"], "p50");
    assert!((ratio - lateness / bare).abs() < 1e-9, "{ratio} for {lateness} / {bare}");
    assert!(number(&json["ratio"], "p99") > 0.0);

    // The last tick of a slice has no successor that tells its hand-over.
    let (tick, publish) = (plausible(&json["tick_us"], loop_ticks - 3), plausible(&json["publish_us"], loop_ticks - 3));
    assert!(tick > publish, "a tick holds its hand-over: {tick}, {publish}");
    for stage in ["read", "check", "reference", "control", "write"] {
        assert!(plausible(&json["stages_us"][stage], loop_ticks) < tick, "a tick holds its stage {stage}");
    }

    let woken = plausible(&json["to_subscriber_us"], 1);
    assert!(plausible(&json["scheduled_to_subscriber_us"], 1) >= woken, "the wake-up is not before its time");
    for subscribers in ["0", "1", "10"] {
        let group = &json["subscribers"][subscribers];
        assert_eq!(number(group, "slices"), 1.0);
        plausible(&group["lateness_us"], 1);
        let heard = if subscribers == "0" { 0 } else { 1 };
        assert_eq!(group["to_subscriber_us"].is_object(), heard == 1, "{group}");
    }
    // Whoever is neither stalled nor killed misses nothing, and what was measured there is one duration a sample.
    for (subscribers, left) in [("1", 1), ("10", 8)] {
        let group = &json["subscribers"][subscribers];
        assert_eq!(group["received"], group["expected"], "{subscribers} subscribers");
        assert_eq!(group["to_subscriber_us"]["count"], group["received"]);
        assert_eq!(group["received"].as_u64(), group["lateness_us"]["count"].as_u64().map(|count| count * left));
    }
    assert!(json["cyclictest_us"].is_null(), "it was not asked for");
    assert!(json["system"]["refused"].is_array() && json["system"]["granted"].is_object());
}

#[test]
fn people_get_a_table_and_bars() {
    let output = bench(&["latency", "--seconds", "0.6"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said = String::from_utf8(output.stdout).expect("UTF-8");
    for words in
        ["lateness of the wake-up", "bare loop", "loop / bare loop", "hand-over", "10, one stalled, one killed", "█"]
    {
        assert!(said.contains(words), "{words:?} is missing in:\n{said}");
    }
}

#[test]
fn bad_usage_is_2() {
    for arguments in [
        &["latency"][..],
        &["latency", "--seconds", "0"],
        &["latency", "--seconds", "-3"],
        &["latency", "--seconds", "nan"],
        &["latency", "--seconds", "long"],
        &["latency", "--seconds", "1", "--slice-s", "0"],
        &["latency", "--seconds", "1", "--subscribe", "a"],
    ] {
        let output = bench(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?} said: {}", stderr(&output));
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}
