//! Campaign folders: what is written is what is read, and every fault of `campaign.toml` names its line and key.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::path::Path;

use common::{assert_says, csv_text, sample, write_mcap};
use recordings::{Campaign, CampaignError, Plane, Protocol, RigFacts, Role, RunEntry};

const TOML: &str = r#"format = 1
name = "c01"
[rig]
J = 0.085
G = 4
u_max = 24.0
[[run]]
file = "map.csv"
protocol = "torque-map"
role = "identify"
plane = "horizontal"
[[run]]
file = "square.csv"
protocol = "square-wave"
role = "validate"
plane = "vertical"
"#;

fn open(toml: impl AsRef<[u8]>) -> Result<Campaign, CampaignError> {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("campaign.toml"), toml).unwrap();
    for name in ["map.csv", "square.csv"] {
        fs::write(dir.path().join(name), csv_text(5)).unwrap();
    }
    Campaign::open(dir.path())
}

#[test]
fn the_contracts_example_is_read() {
    let campaign = open(TOML).unwrap();
    assert_eq!(campaign.name, "c01");
    assert_eq!(campaign.rig, RigFacts { inertia_kg_m2: 0.085, gravity_nm: 4.0, u_max_v: 24.0 });
    let run = |file: &str, protocol, role, plane| RunEntry { file: file.to_owned(), protocol, role, plane };
    assert_eq!(
        campaign.runs,
        [
            run("map.csv", Protocol::TorqueMap, Role::Identify, Plane::Horizontal),
            run("square.csv", Protocol::SquareWave, Role::Validate, Plane::Vertical),
        ]
    );
}

#[test]
fn a_folder_written_is_the_folder_read() {
    let dir = tempfile::tempdir().unwrap();
    let runs = Protocol::ALL
        .iter()
        .enumerate()
        .map(|(index, &protocol)| RunEntry {
            file: format!("run {index}.csv"),
            protocol,
            role: if index % 2 == 0 { Role::Identify } else { Role::Validate },
            plane: if index % 3 == 0 { Plane::Horizontal } else { Plane::Vertical },
        })
        .collect();
    let rig = RigFacts { inertia_kg_m2: 0.1 + 0.2, gravity_nm: 0.0, u_max_v: 24.0 };
    let name = "a \"name\"\nof two lines, 2 °C".to_owned();
    let campaign = Campaign { dir: dir.path().to_owned(), name, rig, runs };
    campaign.write_toml().unwrap();
    assert_says(Campaign::open(dir.path()), &["campaign.toml, line ", "file", "run 0.csv", "put the recording there"]);
    for run in &campaign.runs {
        fs::write(dir.path().join(&run.file), csv_text(5)).unwrap();
    }
    assert_eq!(Campaign::open(dir.path()).unwrap(), campaign);
    for run in &campaign.runs {
        assert_eq!(campaign.read(run).unwrap().len(), 5);
    }
}

#[test]
fn a_campaign_that_could_not_be_opened_is_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let rig = RigFacts { inertia_kg_m2: f64::NAN, gravity_nm: 1.0, u_max_v: 24.0 };
    let run = RunEntry {
        file: "a.csv".to_owned(),
        protocol: Protocol::SquareWave,
        role: Role::Identify,
        plane: Plane::Horizontal,
    };
    let mut campaign = Campaign { dir: dir.path().to_owned(), name: String::new(), rig, runs: vec![run.clone()] };
    assert_says(campaign.write_toml(), &["campaign.toml, line 5, J", "nan"]);
    campaign.rig.inertia_kg_m2 = 0.1;
    campaign.runs.push(run);
    assert_says(campaign.write_toml(), &["file", "each file once"]);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn every_fault_names_its_line_and_key() {
    let cases: &[(&str, &str, &[&str])] = &[
        ("format = 1", "format = 2", &["line 1, format", "the number 1", "got \"2\"", "format 1"]),
        ("format = 1", "format = \"1\"", &["line 1, format"]),
        ("format = 1", "format = 1.0", &["line 1, format"]),
        ("format = 1\n", "", &["format", "expected the key \"format\"", "name, rig, run"]),
        ("name = \"c01\"", "name = 1", &["line 2, name", "text in quotes", "got \"1\""]),
        ("[rig]", "[rigg]", &["rig", "expected the key \"rig\"", "rigg"]),
        ("J = 0.085", "J = 0", &["line 4, J", "> 0", "got \"0\""]),
        ("J = 0.085", "J = -0.1", &["line 4, J", "-0.1"]),
        ("J = 0.085", "J = nan", &["line 4, J", "nan"]),
        ("J = 0.085", "J = 1e999", &["line 4, J"]),
        ("J = 0.085", "J = true", &["line 4, J", "true"]),
        ("J = 0.085\n", "", &["line 3, J", "[rig]", "G, u_max"]),
        ("G = 4", "G = -4", &["line 5, G", ">= 0", "-4"]),
        ("u_max = 24.0", "u_max = inf", &["line 6, u_max", "> 0 (V)", "inf"]),
        ("u_max = 24.0", "umax = 24.0", &["line 3, u_max", "umax"]),
        ("\"torque-map\"", "\"torque map\"", &["line 9, protocol", "\"torque-map\", \"volume-map\"", "torque map"]),
        ("\"torque-map\"", "7", &["line 9, protocol", "text in quotes"]),
        ("\"identify\"", "\"fit\"", &["line 10, role", "\"identify\", \"validate\"", "fit"]),
        ("\"vertical\"", "\"Vertical\"", &["line 16, plane", "\"horizontal\", \"vertical\"", "Vertical"]),
        ("plane = \"vertical\"\n", "", &["line 12, plane", "[run 2]", "file, protocol, role"]),
        ("\"map.csv\"", "\"square.csv\"", &["line 13, file", "each file once", "line 8"]),
        ("\"map.csv\"", "\"./square.csv\"", &["line 13, file", "each file once", "line 8"]),
        ("\"map.csv\"", "\"../map.csv\"", &["line 8, file", "inside the campaign's folder", "../map.csv"]),
        ("\"map.csv\"", "\"/tmp/map.csv\"", &["line 8, file", "inside the campaign's folder"]),
        ("\"map.csv\"", "\"map.txt\"", &["line 8, file", ".mcap, .csv or .csv.gz", "map.txt"]),
        ("\"map.csv\"", "\"gone.csv\"", &["line 8, file", "gone.csv", "put the recording there"]),
        ("name = \"c01\"", "name = \"c01", &["line 2", "valid TOML"]),
        ("name = \"c01\"", "format = 1", &["line 2", "valid TOML", "duplicate key"]),
    ];
    for (right, wrong, parts) in cases {
        assert!(TOML.contains(right), "{right}");
        let message = assert_says(open(TOML.replacen(right, wrong, 1)), parts);
        assert!(message.contains("campaign.toml") && message.contains("expected"), "{message}");
    }
}

#[test]
fn no_run_is_an_error() {
    let head = &TOML[..TOML.find("[[run]]").unwrap()];
    assert_says(open(head), &["campaign.toml", "expected the key \"run\""]);
    assert_says(open(format!("run = []\n{head}")), &["line 1, run", "at least one table [[run]]"]);
    assert_says(open(format!("run = 3\n{head}")), &["line 1, run", "at least one table [[run]]"]);
    assert_says(open(format!("run = [3]\n{head}")), &["line 1, run", "a table [[run]]"]);
}

#[test]
fn keys_of_other_tools_are_accepted_everywhere() {
    let toml = TOML.replace("[rig]", "operator = \"x\"\n[tool]\na = 1\n[rig]\noil = \"HLP 22\"");
    let toml = toml.replace("plane =", "comment = \"after lunch\"\nplane =");
    assert_eq!(open(toml).unwrap().runs.len(), 2);
}

#[test]
fn a_folder_without_campaign_and_a_file_not_in_utf8_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    assert_says(Campaign::open(dir.path()), &["campaign.toml", "No such file"]);
    let mut bytes = TOML.as_bytes().to_vec();
    let at = TOML.find("c01").unwrap();
    bytes[at] = 0xe4;
    assert_says(open(bytes), &["campaign.toml, line 2", "UTF-8"]);
}

fn mcap_campaign(dir: &Path, plane: Plane) -> Campaign {
    let run = RunEntry { file: "square.mcap".to_owned(), protocol: Protocol::SquareWave, role: Role::Identify, plane };
    let rig = RigFacts { inertia_kg_m2: 0.1, gravity_nm: 1.0, u_max_v: 24.0 };
    Campaign { dir: dir.to_owned(), name: "mcap".to_owned(), rig, runs: vec![run] }
}

#[test]
fn mcap_runs_are_read_through_the_campaign_which_decides_the_role_but_not_the_plane() {
    let dir = tempfile::tempdir().unwrap();
    let samples: Vec<_> = (0..100).map(sample).collect();
    write_mcap(&dir.path().join("square.mcap"), &samples, 100);
    mcap_campaign(dir.path(), Plane::Vertical).write_toml().unwrap();
    let campaign = Campaign::open(dir.path()).unwrap();
    assert_eq!(campaign.read(&campaign.runs[0]).unwrap().len(), 100);
    let flat = mcap_campaign(dir.path(), Plane::Horizontal);
    assert_says(flat.read(&flat.runs[0]), &["square.mcap, plane", "horizontal", "vertical", "campaign.toml"]);
}

#[test]
fn a_run_that_was_never_closed_is_named_as_such() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("square.mcap.part"), b"").unwrap();
    mcap_campaign(dir.path(), Plane::Vertical).write_toml().unwrap();
    assert_says(Campaign::open(dir.path()), &["line 10, file", "square.mcap", "never closed"]);
}
