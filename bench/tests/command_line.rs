//! The command line as a user meets it: exit codes, one message on stderr, nothing half-written.

use bench::commands::COMMANDS;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench"))
        .args(arguments)
        .env_remove("RUST_LOG")
        .output()
        .expect("the binary was just built")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("messages are UTF-8")
}

/// Ends with `code` and says every word of `words` in one error message, without a panic.
#[track_caller]
fn refused(arguments: &[&str], code: i32, words: &[&str]) {
    let output = bench(arguments);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?} said: {said}");
    assert_eq!(said.matches("error: ").count(), 1, "one message, got: {said}");
    assert!(!said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "{word:?} is missing in: {said}");
    }
    assert!(output.stdout.is_empty(), "results go to stdout, failures do not");
}

const MODEL: &str = "format = 1
[torque]\nm1 = -1.6\nm2 = -4.0\nm3 = 6.8
[capacity]\nh1 = 7.6\nh2 = -1.5\nh3 = 0.9\na1 = 0.008\na2 = 0.0
[displacement]\nv1 = -9.0\nv2 = 68.0
[pump]\nf1 = 0.61\nf2 = 0.005\nf3 = -0.25\nf4 = -0.60\nu_max = 24.0
[losses]\nl1 = 1.2\nl2 = 2.4\nl3 = 1.1\nl4 = 57.4\na = 0.02
[load]\nJ = 0.085\nG = 4.0
[valves]\nk_b = 40.0
";

const HEADER: &str =
    "time_s,voltage_v,angle_deg,pressure1_bar,pressure2_bar,torque_nm,volume_ml,brake_open,bypass_open,segment\n";

/// A run of `seconds` at 500 Hz: 12 V from 0.1 s on.
fn run_csv(seconds: f64) -> String {
    let mut text = HEADER.to_owned();
    for i in 0..(seconds * 500.0) as usize {
        let voltage_v = if i < 50 { 0.0 } else { 12.0 };
        text += &format!("{:.3},{voltage_v},1.5,2.8,2.8,,,1,0,0\n", i as f64 / 500.0);
    }
    text
}

const CAMPAIGN: &str = "format = 1
name = \"test\"
[rig]\nJ = 0.085\nG = 4.0\nu_max = 24.0
[[run]]\nfile = \"a.csv\"\nprotocol = \"random-steps\"\nrole = \"identify\"\nplane = \"horizontal\"
";

fn folder(files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for (name, content) in files {
        fs::write(dir.path().join(name), content).expect("writable");
    }
    dir
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary paths are UTF-8")
}

#[test]
fn bad_usage_is_2_and_help_is_0() {
    for arguments in [
        &[][..],
        &["levitate"],
        &["identify"],
        &["demo", "--seed", "many"],
        &["demo", "--sed", "1"],
        &["simulate", "m.toml", "r.csv", "--out", "o.csv"],
        &["simulate", "m.toml", "r.csv", "--plane", "diagonal", "--out", "o.csv"],
    ] {
        assert_eq!(bench(arguments).status.code(), Some(2), "{arguments:?}");
    }
    for arguments in [&["--help"][..], &["--version"], &["demo", "--help"], &["simulate", "--help"]] {
        let output = bench(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}");
        assert!(!output.stdout.is_empty());
    }
}

#[test]
fn a_result_that_stdout_does_not_take_is_no_success_and_a_pipe_that_is_closed_is_one() {
    let dir = folder(&[]);
    let recording = dir.path().join("a.mcap");
    let instance = format!("test-full-stdout-{}", std::process::id());
    let run = ["run", "square_h", "--json", "--out", text(&recording), "--instance", &instance];
    let commands = [
        &run[..],
        &["ls", text(dir.path())],
        &["profile", "show", "square_h"],
        &["profile", "list", "--json"],
        &["completions", "bash"],
    ];
    for arguments in commands {
        let full = fs::File::options().write(true).open("/dev/full").expect("Linux has it");
        let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
        let output = command.args(arguments).stdout(full).env_remove("RUST_LOG").output().expect("it starts");
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains("error: stdout: expected to write the results, got \"No space left"), "{said}");
        assert!(said.matches("error: ").count() == 1 && !said.contains("panicked"), "{said}");
    }
    assert!(recording.exists(), "the run came to its end all the same");

    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(["completions", "bash"]).stdout(Stdio::piped()).stderr(Stdio::piped()).env_remove("RUST_LOG");
    let mut child = command.spawn().expect("it starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("a child");
    assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()));
}

#[test]
fn the_readme_names_every_command() {
    let readme = include_str!("../../README.md");
    assert!(COMMANDS.len() >= 4, "{COMMANDS:?}");
    for entry in COMMANDS {
        let command = format!("bench {}", entry.name);
        assert!(readme.contains(&command), "{command} is not in README.md");
    }
}

#[test]
fn a_campaign_that_is_none_is_2_with_the_place() {
    for command in ["identify", "diagnose"] {
        refused(&[command, "/nonexistent/campaign"], 2, &["/nonexistent/campaign", "campaign.toml"]);

        let dir = folder(&[("campaign.toml", CAMPAIGN.as_bytes())]);
        refused(&[command, text(dir.path())], 2, &["campaign.toml", "line", "a.csv"]);

        let dir = folder(&[("campaign.toml", CAMPAIGN.replace("format = 1", "format = 2").as_bytes())]);
        refused(&[command, text(dir.path())], 2, &["campaign.toml", "line 1", "format"]);

        let bad = run_csv(1.0).replace("0.100,12,", "0.098,12,");
        let dir = folder(&[("campaign.toml", CAMPAIGN.as_bytes()), ("a.csv", bad.as_bytes())]);
        refused(&[command, text(dir.path())], 2, &["a.csv", "line 52", "time_s"]);

        let bad = run_csv(1.0).replace("time_s,voltage_v,angle_deg", "time_s,volts,angle_deg");
        let dir = folder(&[("campaign.toml", CAMPAIGN.as_bytes()), ("a.csv", bad.as_bytes())]);
        refused(&[command, text(dir.path())], 2, &["a.csv", "line 1", "voltage_v"]);

        let dir = folder(&[("campaign.toml", CAMPAIGN.as_bytes()), ("a.csv", HEADER.as_bytes())]);
        refused(&[command, text(dir.path())], 2, &["a.csv"]);
        assert!(!dir.path().join("analysis").exists(), "a refused campaign leaves no results");
    }
}

#[test]
fn simulate_writes_the_contract_s_columns() {
    let dir = folder(&[("model.toml", MODEL.as_bytes()), ("run.csv", run_csv(1.0).as_bytes())]);
    let at = |name: &str| dir.path().join(name);
    let (model, run, out) = (at("model.toml"), at("run.csv"), at("out.csv"));
    let output = bench(&["simulate", text(&model), text(&run), "--plane", "horizontal", "--out", text(&out)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));

    let simulated = fs::read_to_string(&out).expect("written");
    assert!(simulated.starts_with(HEADER), "{}", &simulated[..200]);
    let rows: Vec<Vec<&str>> = simulated.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 500);
    let value = |row: usize, column: usize| rows[row][column].parse::<f64>().expect("a number");
    assert!((value(0, 2) - 1.5).abs() < 1e-12, "from the run's first sample");
    assert_eq!((value(0, 3), value(0, 4)), (2.8, 2.8));
    assert!(value(499, 2) > 3.0, "u > 0 drives towards phi > 0: {:?}", rows[499]);
    assert!(value(499, 3) > value(499, 4), "u > 0 raises p1 over p2: {:?}", rows[499]);
    assert_eq!(rows[499][5], "", "a free lever holds no torque");
    assert_eq!(value(499, 0), 0.998);
}

#[test]
fn simulate_minds_the_plane() {
    let dir =
        folder(&[("model.toml", MODEL.as_bytes()), ("run.csv", run_csv(0.5).replace(",1.5,", ",30,").as_bytes())]);
    let at = |name: &str| dir.path().join(name);
    let angle = |plane: &str| {
        let out = at(&format!("{plane}.csv"));
        let output =
            bench(&["simulate", text(&at("model.toml")), text(&at("run.csv")), "--plane", plane, "--out", text(&out)]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let simulated = fs::read_to_string(&out).expect("written");
        simulated
            .lines()
            .last()
            .and_then(|line| line.split(',').nth(2))
            .and_then(|a| a.parse::<f64>().ok())
            .expect("an angle")
    };
    assert!(angle("vertical") < angle("horizontal") - 0.05, "gravity pulls the lever down");
}

#[test]
fn simulate_refuses_what_is_no_model_or_no_start() {
    let dir = folder(&[
        ("model.toml", MODEL.as_bytes()),
        ("format.toml", MODEL.replace("format = 1", "format = 7").as_bytes()),
        ("missing.toml", MODEL.replace("h2 = -1.5\n", "").as_bytes()),
        ("effect.toml", format!("{MODEL}[[effect]]\nid = \"gremlins\"\nparameters = {{ k = 1.0 }}\n").as_bytes()),
        ("run.csv", run_csv(0.5).as_bytes()),
        ("start.csv", run_csv(0.5).replacen(",2.8,2.8,", ",2.8,,", 1).as_bytes()),
        ("empty.csv", HEADER.as_bytes()),
    ]);
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    let out = at("out.csv");
    let simulate = |model: &str, run: &str, more: &[&str], words: &[&str]| {
        let (model, run) = (at(model), at(run));
        let mut arguments = vec!["simulate", &model, &run, "--plane", "horizontal", "--out", &out];
        arguments.extend(more);
        refused(&arguments, 2, words);
        assert!(!Path::new(&out).exists(), "nothing half-written");
    };
    simulate("none.toml", "run.csv", &[], &["none.toml"]);
    simulate("format.toml", "run.csv", &[], &["format.toml", "expected 1", "7"]);
    simulate("missing.toml", "run.csv", &[], &["missing.toml", "h2"]);
    simulate("effect.toml", "run.csv", &["--with-effects"], &["gremlins", "pump_lag"]);
    simulate("model.toml", "none.csv", &[], &["none.csv"]);
    simulate("model.toml", "start.csv", &[], &["start.csv", "pressure2_bar"]);
    simulate("model.toml", "empty.csv", &[], &["empty.csv"]);
}

#[test]
fn simulate_overwrites_nothing_and_says_so_before_it_works() {
    let dir = folder(&[
        ("model.toml", MODEL.as_bytes()),
        ("run.csv", run_csv(1.0).as_bytes()),
        ("other.csv", "kept".as_bytes()),
    ]);
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    let (model, run) = (at("model.toml"), at("run.csv"));
    let simulate = |model: &str, out: &str, words: &[&str]| {
        refused(&["simulate", model, &run, "--plane", "horizontal", "--out", &at(out)], 2, words);
    };
    for out in ["run.csv", "other.csv"] {
        simulate(&model, out, &[out, "got one that exists", "nothing is overwritten"]);
    }
    assert_eq!(fs::read_to_string(&run).expect("there"), run_csv(1.0));
    assert_eq!(fs::read_to_string(at("other.csv")).expect("there"), "kept");
    // Not even the model is read before the name is right.
    simulate("nowhere.toml", "run.mcap", &["--out", "run.mcap", "ends in .csv or .csv.gz"]);
    simulate("nowhere.toml", "other.csv", &["nothing is overwritten"]);
    simulate(&model, "out.parquet", &["out.parquet", "ends in .csv or .csv.gz"]);
    let words = ["run.csv", "expected --plane horizontal or --plane vertical", "a CSV file does not say"];
    refused(&["simulate", &model, &run, "--out", &at("out.csv")], 2, &words);
    assert_eq!(fs::read_dir(dir.path()).expect("there").count(), 3, "nothing half-written");
    // Packed by its name.
    let packed = at("out.csv.gz");
    let output = bench(&["simulate", &model, &run, "--plane", "horizontal", "--out", &packed]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(fs::read(&packed).expect("written").starts_with(&[0x1f, 0x8b]), "gzip");
}

#[test]
fn effects_act_only_when_asked_for() {
    let with = format!("{MODEL}[[effect]]\nid = \"tilt\"\nparameters = {{ s = 0.5, c = 0.0 }}\n");
    let dir = folder(&[
        ("plain.toml", MODEL.as_bytes()),
        ("with.toml", with.as_bytes()),
        ("run.csv", run_csv(1.0).as_bytes()),
    ]);
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    let simulate = |model: &str, more: &[&str]| {
        // A name of its own each time: nothing is overwritten.
        let out = at(&format!("{model}{}.csv", more.concat()));
        let (model, run) = (at(model), at("run.csv"));
        let mut arguments = vec!["simulate", &model, &run, "--plane", "horizontal", "--out", &out];
        arguments.extend(more);
        let output = bench(&arguments);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        (fs::read_to_string(&out).expect("written"), stderr(&output))
    };
    let (plain, _) = simulate("plain.toml", &[]);
    let (reference, said) = simulate("with.toml", &[]);
    assert_eq!(reference, plain);
    assert!(said.contains("without tilt"), "what is left out is said: {said}");
    assert_ne!(simulate("with.toml", &["--with-effects"]).0, plain);
}

#[test]
fn info_of_a_csv_run_names_the_import() {
    let dir = folder(&[("a.csv", run_csv(1.0).as_bytes())]);
    refused(&["info", text(&dir.path().join("a.csv"))], 2, &["a.csv", "bench import", "--protocol"]);
}
