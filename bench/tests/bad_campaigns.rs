//! Campaigns that can't be used end with 2 and one message that names the place, before anything is computed or written;
//! one that can is identified.

use bench::simulation::free_run;
use model::effects::EffectSet;
use model::{ModelFile, Parameters};
use recordings::{Plane, Recording};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench"))
        .args(arguments)
        .env_remove("RUST_LOG")
        .output()
        .expect("the binary was just built")
}

/// A run of the example rig at 250 Hz with a free lever: rest, then voltages of 0.8 s each, some with a valve switched. The
/// noise is a fixed sequence without structure.
fn run(seconds: f64, seed: u32) -> Recording {
    let rows = (seconds * 250.0) as usize;
    let levels = [9.0, -14.0, 20.0, -21.0, 4.0, -8.0, 16.0, -18.0, 12.0, -3.0, 21.0, -12.0];
    let step = |i: usize| ((i as f64 / 250.0 - 1.0) / 0.8).floor() as i64 + 1;
    let input: Vec<i64> = (0..rows).map(|i| step(i).max(0)).collect();
    let mut r = Recording {
        time_s: (0..rows).map(|i| i as f64 / 250.0).collect(),
        voltage_v: input
            .iter()
            .map(|&n| if n == 0 { 0.0 } else { levels[(n as usize * 5 + seed as usize) % 12] })
            .collect(),
        angle_deg: vec![0.0; rows],
        pressure1_bar: vec![2.8; rows],
        pressure2_bar: vec![2.8; rows],
        torque_nm: vec![f64::NAN; rows],
        volume_ml: vec![f64::NAN; rows],
        brake_open: input.iter().map(|n| n % 7 != 6).collect(),
        bypass_open: input.iter().map(|n| n % 5 == 4).collect(),
        segment: input,
    };
    let model = ModelFile::plain(Parameters::example());
    r = free_run(&model, &EffectSet::none(), &r, Plane::Horizontal).expect("the example runs");
    let mut state = seed.wrapping_mul(747_796_405).wrapping_add(1);
    let mut noise = || {
        // sum of three uniform numbers of a linear congruence: white, of variance 1
        let mut sum = 0.0;
        for _ in 0..3 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += f64::from(state >> 8) / f64::from(1u32 << 24) - 0.5;
        }
        2.0 * sum
    };
    for i in 0..rows {
        r.angle_deg[i] += 0.01 * noise();
        r.pressure1_bar[i] += 0.006 * noise();
        r.pressure2_bar[i] += 0.006 * noise();
    }
    r
}

/// A folder with this campaign.toml and runs `a.csv` (identify) and `b.csv` (validate).
fn campaign(seconds: f64) -> TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    fs::write(dir.path().join("campaign.toml"), CAMPAIGN).expect("writable");
    run(seconds, 1).write_csv(&dir.path().join("a.csv")).expect("writable");
    run(seconds, 2).write_csv(&dir.path().join("b.csv")).expect("writable");
    dir
}

const CAMPAIGN: &str = "format = 1
name = \"small\"
[rig]\nJ = 0.085\nG = 4.0\nu_max = 24.0
[[run]]\nfile = \"a.csv\"\nprotocol = \"random-steps\"\nrole = \"identify\"\nplane = \"horizontal\"
[[run]]\nfile = \"b.csv\"\nprotocol = \"random-steps\"\nrole = \"validate\"\nplane = \"horizontal\"
";

/// Changes a text file of the folder.
fn edit(dir: &TempDir, file: &str, change: impl Fn(String) -> String) {
    let path = dir.path().join(file);
    let text = fs::read_to_string(&path).expect("readable");
    let changed = change(text.clone());
    assert_ne!(changed, text, "the test changes something");
    fs::write(path, changed).expect("writable");
}

/// Replaces one field of one line (both counted from 1).
fn field(dir: &TempDir, file: &str, line: usize, column: usize, to: &str) {
    edit(dir, file, |text| {
        let change = |(n, old): (usize, &str)| {
            let mut fields: Vec<&str> = old.split(',').collect();
            if n + 1 == line {
                fields[column - 1] = to;
            }
            fields.join(",") + "\n"
        };
        text.lines().enumerate().map(change).collect()
    });
}

/// Both commands refuse the folder, with every word in one message.
#[track_caller]
fn refused(dir: &TempDir, words: &[&str]) {
    for command in ["identify", "diagnose"] {
        let output = bench(&[command, dir.path().to_str().expect("UTF-8")]);
        let said = String::from_utf8(output.stderr).expect("messages are UTF-8");
        assert_eq!(output.status.code(), Some(2), "{command}: {said}");
        assert_eq!(said.matches("error: ").count(), 1, "one message, got: {said}");
        assert!(!said.contains("panicked"), "{said}");
        for word in words {
            assert!(said.contains(word), "{word:?} is missing in: {said}");
        }
        assert!(output.stdout.is_empty(), "no results");
        assert!(!dir.path().join("analysis").exists(), "a refused campaign leaves no results");
    }
}

#[test]
fn a_missing_file_or_a_wrong_format_number_is_named_with_its_line() {
    let dir = campaign(2.0);
    fs::remove_file(dir.path().join("b.csv")).expect("there");
    refused(&dir, &["campaign.toml", "line 13", "b.csv"]);

    let dir = campaign(2.0);
    edit(&dir, "campaign.toml", |text| text.replace("format = 1", "format = 3"));
    refused(&dir, &["campaign.toml", "line 1", "format", "3"]);

    let dir = campaign(2.0);
    fs::remove_file(dir.path().join("campaign.toml")).expect("there");
    refused(&dir, &["campaign.toml"]);
}

#[test]
fn a_bad_row_is_named_with_file_line_and_column() {
    let dir = campaign(2.0);
    edit(&dir, "b.csv", |text| text.replacen("pressure2_bar", "p2", 1));
    refused(&dir, &["b.csv", "line 1", "pressure2_bar"]);

    let dir = campaign(2.0);
    field(&dir, "a.csv", 40, 2, "NaN");
    refused(&dir, &["a.csv", "line 40", "voltage_v"]);

    let dir = campaign(2.0);
    field(&dir, "a.csv", 41, 2, "");
    refused(&dir, &["a.csv", "line 41", "voltage_v"]);

    let dir = campaign(2.0);
    field(&dir, "b.csv", 42, 3, "twelve");
    refused(&dir, &["b.csv", "line 42", "angle_deg", "twelve"]);

    let dir = campaign(2.0);
    field(&dir, "a.csv", 100, 1, "0.2");
    refused(&dir, &["a.csv", "line 100", "time_s"]);

    let dir = campaign(2.0);
    edit(&dir, "a.csv", |text| text.lines().next().expect("a header").to_string() + "\n");
    refused(&dir, &["a.csv", "at least one"]);
}

#[test]
fn a_truncated_gz_is_named() {
    let dir = campaign(2.0);
    edit(&dir, "campaign.toml", |text| text.replace("b.csv", "b.csv.gz"));
    let path = dir.path().join("b.csv.gz");
    run(2.0, 2).write_csv(&path).expect("writable");
    let bytes = fs::read(&path).expect("just written");
    fs::write(&path, &bytes[..bytes.len() / 2]).expect("writable");
    refused(&dir, &["b.csv.gz"]);
}

#[test]
fn a_campaign_without_a_run_to_fit_or_to_validate_is_refused() {
    let dir = campaign(2.0);
    edit(&dir, "campaign.toml", |text| text.replace("\"validate\"", "\"identify\""));
    refused(&dir, &["campaign.toml", "role = \"validate\"", "got none of 2", "add a run"]);

    let dir = campaign(2.0);
    edit(&dir, "campaign.toml", |text| text.replace("\"identify\"", "\"validate\""));
    refused(&dir, &["role \"identify\""]);
}

#[test]
fn a_run_without_its_initial_rest_is_named() {
    for file in ["a.csv", "b.csv"] {
        let dir = campaign(2.0);
        edit(&dir, file, |text| {
            let moved = text.lines().map(|line| line.replacen(",0.0,", ",5.0,", 1) + "\n");
            moved.collect()
        });
        refused(&dir, &[file, "rest"]);
    }
}

#[test]
fn results_that_can_t_be_written_are_refused_before_the_work() {
    let dir = campaign(2.0);
    let out = dir.path().join("taken");
    fs::write(&out, "a file").expect("writable");
    let arguments = ["identify", dir.path().to_str().expect("UTF-8"), "--out", out.to_str().expect("UTF-8")];
    let output = bench(&arguments);
    let said = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("taken") && said.contains("--out") && !said.contains("joint fit"), "{said}");
    assert_eq!(fs::read_to_string(&out).expect("still there"), "a file");
}

/// Changes one column of a run, row by row.
fn column(dir: &TempDir, file: &str, column: usize, change: impl Fn(f64) -> f64) {
    edit(dir, file, |text| {
        let mut lines = text.lines();
        let head = lines.next().expect("a header").to_owned() + "\n";
        let change = |line: &str| {
            let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
            let value: f64 = fields[column - 1].parse().expect("a number");
            fields[column - 1] = change(value).to_string();
            fields.join(",") + "\n"
        };
        lines.fold(head, |text, line| text + &change(line))
    });
}

#[test]
fn wrong_units_and_exchanged_columns_are_refused_with_the_likely_cause() {
    let dir = campaign(8.0);
    column(&dir, "a.csv", 4, |bar| bar * 1e5);
    refused(&dir, &["a.csv", "pressure1_bar", "bar absolute", "in Pa", "1e-5"]);

    let dir = campaign(8.0);
    column(&dir, "b.csv", 2, |v| v * 1e3);
    refused(&dir, &["b.csv", "voltage_v", "u_max", "mV"]);

    let dir = campaign(8.0);
    for file in ["a.csv", "b.csv"] {
        edit(&dir, file, |text| text.replacen("pressure1_bar,pressure2_bar", "pressure2_bar,pressure1_bar", 1));
    }
    refused(&dir, &["a.csv", "pressure1_bar, pressure2_bar", "exchanged"]);

    let dir = campaign(8.0);
    for file in ["a.csv", "b.csv"] {
        column(&dir, file, 3, |deg| -deg);
    }
    refused(&dir, &["a.csv", "angle_deg", "inverted"]);

    let dir = campaign(8.0);
    edit(&dir, "a.csv", |text| {
        let twice = |(n, line): (usize, &str)| format!("{line}\n").repeat(if n == 50 { 2 } else { 1 });
        text.lines().enumerate().map(twice).collect()
    });
    refused(&dir, &["a.csv", "line 52", "time_s", "repeated"]);
}

#[test]
fn a_broken_sensor_of_the_only_run_is_the_error() {
    let dir = campaign(8.0);
    column(&dir, "a.csv", 5, |_| 2.8);
    refused(&dir, &["a.csv", "pressure2_bar", "identify", "no effect of the plant"]);
}

#[test]
fn a_small_campaign_is_identified_and_what_it_can_t_tell_is_said() {
    let dir = campaign(16.0);
    let output = bench(&["identify", dir.path().to_str().expect("UTF-8")]);
    let said = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(output.status.code(), Some(0), "{said}");
    let results = String::from_utf8(output.stdout).expect("UTF-8");
    for word in ["b.csv", "angle_deg", "noise floor", "model.toml", "report.html", "is not determined by this campaign"]
    {
        assert!(results.contains(word), "{word:?} is missing in: {results}");
    }
    let analysis = dir.path().join("analysis");
    let mut files: Vec<String> = fs::read_dir(&analysis)
        .expect("made")
        .map(|f| f.expect("readable").file_name().into_string().expect("UTF-8"))
        .collect();
    files.sort_unstable();
    assert_eq!(files, ["model.toml", "report.html", "report.json"], "no findings without a diagnosis");
    let model = ModelFile::read(&analysis.join("model.toml")).expect("it loads back");
    assert!(model.source.contains_key("not_determined"));
    simulates(&analysis.join("model.toml"), dir.path());
}

/// The model file runs in `bench simulate`, near the measured angle.
fn simulates(model: &Path, dir: &Path) {
    let path = |p: &Path| p.to_str().expect("UTF-8").to_owned();
    let (run, out) = (path(&dir.join("b.csv")), path(&dir.join("simulated.csv")));
    let output = bench(&["simulate", &path(model), &run, "--plane", "horizontal", "--out", &out]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let read = |file: &str| Recording::read(Path::new(file), recordings::Protocol::RandomSteps).expect("readable");
    let (measured, simulated) = (read(&run), read(&out));
    let errors = measured.angle_deg.iter().zip(&simulated.angle_deg).map(|(m, s)| (m - s).abs());
    let largest = errors.fold(0.0, f64::max);
    assert!(largest < 0.5, "from one noisy sample, {largest} deg off at most");
}
