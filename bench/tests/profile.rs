//! `bench profile` through the binary: what it prints, and its exit codes.
#![allow(clippy::unwrap_used, reason = "a test")]

use profiles::{BUILTIN, EXAMPLES, SCHEMA};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn bench(arguments: &[&str], folder: &Path) -> Output {
    let program = env!("CARGO_BIN_EXE_bench");
    Command::new(program).args(["profile"]).args(arguments).current_dir(folder).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

const SCRIPT: &str = r#"name = "mine"
protocol = "square-wave"
role = "identify"
plane = "horizontal"
about = "to and fro"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
fill_bar = 2.8
[[step]]
for_s = 1.0
[[step]]
for_each = { share = { from = 0.5, to = 0.9, step = 0.2 } }
  [[step.step]]
  voltage_u_max = "$share"
  until = [{ channel = "angle_deg", above = 20.0 }]
  timeout_s = 6.0
  [[step.step]]
  voltage_u_max = -0.6
  until = [{ channel = "angle_deg", below = -20.0 }, { channel = "pressure1_bar", steady_within = 0.001, for_s = 0.5 }]
  timeout_s = 6.0
"#;

/// A folder with `mine.toml`.
fn folder(script: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("mine.toml"), script).unwrap();
    folder
}

#[test]
fn a_profile_that_fits_is_said_in_words_with_its_times_and_peaks() {
    let folder = folder(SCRIPT);
    let output = bench(&["check", "mine.toml"], folder.path());
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(0), "{text}{}", stderr(&output));
    for part in [
        "mine: square-wave, identify, horizontal. to and fro",
        "for each share = 0.5 .. 0.9 by 0.2",
        "$share u_max",
        "until angle_deg above 20, at most 6 s",
        "until angle_deg below -20",
        "or pressure1_bar steady within 0.001 for 0.5 s, at most 6 s",
        "operator: nothing is asked, the rig does that part itself",
        "duration: 1.006 .. 37.000 s, ",
        "line 15 (share = 0.9)",
        "pressure 2",
        "within all limits",
    ] {
        assert!(text.contains(part), "{part:?} is missing:\n{text}");
    }
    assert!(!folder.path().join("recordings").exists(), "nothing is recorded");
}

#[test]
fn a_profile_that_would_trip_is_exit_code_3_and_json_says_where() {
    let folder = folder(&format!("{SCRIPT}[envelope]\nangle_max_deg = 15\n"));
    let output = bench(&["check", "mine.toml"], folder.path());
    assert_eq!(output.status.code(), Some(3), "{}", stdout(&output));
    assert!(stdout(&output).contains("WOULD TRIP at "), "{}", stdout(&output));
    let said = stderr(&output);
    assert!(said.contains("mine: would trip in the step of line 15 (share = 0.5): angle 15."), "{said}");

    let output = bench(&["check", "square_h", "mine.toml", "--json"], folder.path());
    assert_eq!(output.status.code(), Some(3));
    let document: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(document["fits"], false);
    let [good, bad] = document["profiles"].as_array().unwrap().as_slice() else { panic!("{document}") };
    assert_eq!((&good["fits"], &good["dry_run"]["trip"]), (&Value::Bool(true), &Value::Null));
    assert_eq!(bad["fits"], false);
    let trip = &bad["dry_run"]["trip"];
    assert_eq!((&trip["line"], &trip["with"]), (&Value::from(15), &Value::from("share = 0.5")));
    assert!((trip["time_s"].as_f64().unwrap() - 1e-3 * trip["tick"].as_f64().unwrap()).abs() < 1e-9);
    assert!(trip["message"].as_str().unwrap().contains("above 15 deg"), "{trip}");
    let angle = bad["dry_run"]["peaks"].as_array().unwrap().iter().find(|peak| peak["channel"] == "angle").unwrap();
    // It turns back at 20 degrees: a third beyond the limit of 15.
    assert!((-36.0..-33.0).contains(&angle["margin_percent"].as_f64().unwrap()), "{angle}");
    assert_eq!(bad["limits"]["angle_max_deg"], 15.0);
    let passes: Vec<&Value> = bad["steps"].as_array().unwrap().iter().map(|step| &step["passes"]).collect();
    assert_eq!(passes, [&Value::Null, &Value::from(1), &Value::Null, &Value::from(3), &Value::from(3)]);
}

#[test]
fn a_wrong_profile_is_exit_code_2_with_line_and_remedy() {
    for (from, to, said) in [
        (
            "fill_bar = 2.8",
            "fill_bar = 280",
            "mine.toml:10: `fill_bar` must lie within 0.1 .. 8, got 280; write it in bar: 280 kPa are 2.8 bar",
        ),
        (
            "voltage_u_max = -0.6",
            "voltage_u_max = -60",
            "mine.toml:20: `voltage_u_max` must lie within -1 .. 1, got -60; it is a fraction: -60 % are -0.6",
        ),
        ("timeout_s = 6.0\n", "timeout_ms = 6.0\n", "mine.toml:18: unknown field `timeout_ms`"),
        (
            "voltage_u_max = -0.6",
            "voltage_v = -60",
            "mine.toml:19: `voltage_v` reaches -60 V, beyond the rig's largest voltage of 24 V",
        ),
        ("[[step]]\nfor_s = 1.0", "[envelope]\nangle_max_deg = 80\n[[step]]\nfor_s = 1.0", "own limit of 60"),
    ] {
        assert!(SCRIPT.contains(from));
        let folder = folder(&SCRIPT.replacen(from, to, 1));
        let output = bench(&["check", "mine.toml"], folder.path());
        assert_eq!(output.status.code(), Some(2), "{to}");
        assert!(stderr(&output).contains(said), "{said:?} is not in {:?}", stderr(&output));
        // What is wrong comes before what would trip, and the others are checked all the same.
        let output = bench(&["check", "mine.toml", "square_h", "--json"], folder.path());
        assert_eq!(output.status.code(), Some(2));
        let document: Value = serde_json::from_str(&stdout(&output)).unwrap();
        assert!(document["profiles"][0]["message"].as_str().unwrap().contains(said));
        assert_eq!(
            (&document["profiles"][0]["fits"], &document["profiles"][1]["fits"]),
            (&Value::Bool(false), &Value::Bool(true))
        );
    }
    let folder = folder(SCRIPT);
    for arguments in
        [&["check"][..], &["check", "nothing_of_that_name"], &["check", "mine.toml", "--model", "none.toml"]]
    {
        assert_eq!(bench(arguments, folder.path()).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn a_wired_rig_asks_people_and_without_a_model_nothing_is_predicted() {
    let rigs = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs");
    let folder = folder(SCRIPT);
    let copy = |name: &str, change: &dyn Fn(String) -> String| {
        let text = std::fs::read_to_string(rigs.join(name)).unwrap();
        std::fs::write(folder.path().join(name), change(text)).unwrap();
    };
    copy("rec.dbc", &|text| text);
    copy("wired.toml", &|text| {
        // Without its automatic fixture.
        let begin = text.find("\n[can.fixture]\n").unwrap();
        let end = begin + 1 + text[begin + 1..].find("\n[").unwrap();
        format!("{}{}", &text[..begin], &text[end..])
    });
    let output = bench(&["check", "torque_map", "--rig", "wired.toml"], folder.path());
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(0), "{text}{}", stderr(&output));
    for part in [
        "NO DRY RUN",
        "--model model.toml",
        "operator: asked up to ",
        "prepare the rig for torque_map",
        "clamp the lever at -30 deg",
        "people take their own time",
    ] {
        assert!(text.contains(part), "{part:?} is missing:\n{text}");
    }
    let model = model::ModelFile::plain(model::Parameters::example()).to_toml();
    std::fs::write(folder.path().join("model.toml"), model).unwrap();
    let output = bench(&["check", "torque_map", "--rig", "wired.toml", "--model", "model.toml"], folder.path());
    let text = stdout(&output);
    assert!(text.contains("dry run on model.toml, without noise"), "{text}{}", stderr(&output));
    let flow = bench(&["check", "constant_flow", "--rig", "wired.toml"], folder.path());
    assert_eq!(flow.status.code(), Some(2));
    assert!(stderr(&flow).contains("set [controller] model"), "{}", stderr(&flow));
}

#[test]
fn every_built_in_profile_is_listed_and_fits_the_emulated_rig() {
    let here = Path::new(".");
    let names: Vec<&str> = BUILTIN.iter().chain(EXAMPLES).map(|(file, _)| file.trim_end_matches(".toml")).collect();
    let list = stdout(&bench(&["list"], here));
    let listed: Vec<&str> = list.lines().skip(1).filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(listed, names);
    let json: Value = serde_json::from_str(&stdout(&bench(&["list", "--json"], here))).unwrap();
    assert_eq!(json.as_array().unwrap().iter().map(|entry| entry["name"].as_str().unwrap()).collect::<Vec<_>>(), names);
    let output = bench(&[&["check", "--json"], names.as_slice()].concat(), here);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn show_and_schema_print_what_the_program_holds() {
    let here = Path::new(".");
    for (file, text) in BUILTIN {
        assert_eq!(stdout(&bench(&["show", file.trim_end_matches(".toml")], here)).trim_end(), text.trim_end());
    }
    assert_eq!(stdout(&bench(&["schema"], here)).trim_end(), SCHEMA.trim_end());
    assert_eq!(bench(&["show", "nothing_of_that_name"], here).status.code(), Some(2));
}
