//! `bench check`: the wired rig's file passes, and each thing that can be wrong with one is said with its line, without a wire.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod signals;

use bench::failure::Failure;
use bench::rig_file::{DeviceSpec, EMULATED, Rig, WIRED};
use bench::setup::Knowledge;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn rigs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs")
}

fn database() -> String {
    std::fs::read_to_string(rigs().join("rec.dbc")).unwrap()
}

/// The wired rig's file with some text replaced, beside a database with some text replaced.
struct Changed {
    rig: String,
    database: String,
}

impl Changed {
    fn none() -> Self {
        Changed { rig: WIRED.to_owned(), database: database() }
    }

    fn rig(mut self, from: &str, to: &str) -> Self {
        assert!(self.rig.contains(from), "wired.toml has no {from:?} any more: adapt the test");
        self.rig = self.rig.replacen(from, to, 1);
        self
    }

    fn database(mut self, from: &str, to: &str) -> Self {
        assert!(self.database.contains(from), "rec.dbc has no {from:?} any more: adapt the test");
        self.database = self.database.replacen(from, to, 1);
        self
    }

    /// Takes a table with all its keys away.
    fn without(mut self, table: &str) -> Self {
        let begin = self.rig.find(&format!("\n{table}\n")).unwrap() + 1;
        let rest = &self.rig[begin + table.len()..];
        let end = rest.find("\n[").map_or(self.rig.len(), |end| begin + table.len() + end + 1);
        self.rig.replace_range(begin..end, "");
        self
    }

    fn read(&self) -> Result<Rig, Failure> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("rec.dbc"), &self.database).unwrap();
        Rig::parse(&self.rig, "rig.toml", folder.path())
    }

    /// Refused with one problem, in the line of the rig file that holds `at`, in these words.
    fn refused(&self, at: &str, words: &[&str]) {
        let failure = self.read().expect_err(&format!("{at}: expected a refusal with {words:?}"));
        assert_eq!(failure.exit_code(), 2, "{failure}");
        let line = self.rig[..self.rig.find(at).expect(at)].matches('\n').count() + 1;
        let place = format!("rig.toml: line {line}: ");
        assert!(failure.message.starts_with(&place), "expected {place:?}, got: {failure}");
        for word in words {
            assert!(failure.message.contains(word), "expected {word:?} in: {failure}");
        }
    }
}

fn changed(from: &str, to: &str) -> Changed {
    Changed::none().rig(from, to)
}

fn check(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench")).arg("check").args(arguments).output().unwrap()
}

#[test]
fn the_wired_rig_fits_and_says_how_it_was_understood() {
    let output = check(&[rigs().join("wired.toml").to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.ends_with("\nfits\n"), "{text}");
    for words in
        ["VESC", "can0", "rec.dbc", "ENCODER", "Pressure1Bar", "heartbeat, 20 ms", "serial port, to", "of 1000.0 bits"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn what_an_amplifier_clips_as_it_is_delivered_is_said() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rec.dbc"), database()).unwrap();
    let said = |changed: &Changed| {
        let rig = Rig::parse(&changed.rig, "rig.toml", folder.path()).unwrap();
        let parts = bench::rig_file::Understood::of(&rig).unwrap().parts;
        parts.into_iter().find(|part| part.name == "warning").map(|part| part.is)
    };
    let warning = said(&Changed::none()).expect("24 V of 24 V");
    assert!(["VESC", "95 %", "22.8", "u_max_v = 24"].iter().all(|word| warning.contains(word)), "{warning}");
    assert_eq!(said(&changed("u_max_v = 24.0", "u_max_v = 22.8")), None);
    assert_eq!(said(&changed("protocol = \"vesc\"", "protocol = \"tmcl\"")), None);
}

#[test]
fn machines_get_the_same_as_json() {
    let output = check(&["--json", rigs().join("wired.toml").to_str().unwrap()]);
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &document["fits"]), (Some(0), &true.into()));
    let pressure = document["mapping"].as_array().unwrap().iter().find(|m| m["key"] == "pressure1_bar").unwrap();
    assert_eq!((&pressure["message"], &pressure["id"]), (&"PRESSURES".into(), &"182".into()));
    for wire in document["budget"].as_array().unwrap() {
        let sum: f64 = wire["entries"].as_array().unwrap().iter().map(|entry| entry[1].as_f64().unwrap()).sum();
        assert!((sum - wire["bits"].as_f64().unwrap()).abs() < 1e-9 && sum > 0.0, "{wire}");
        assert!((sum / wire["carries_bits"].as_f64().unwrap() - wire["share"].as_f64().unwrap()).abs() < 1e-9);
    }

    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.toml");
    std::fs::write(&bad, "nmae = \"a\"\n").unwrap();
    let output = check(&["--json", bad.to_str().unwrap()]);
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &document["fits"]), (Some(2), &false.into()));
    assert!(document["message"].as_str().unwrap().contains("did you mean \"name\"?"), "{document}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("line 1: nmae: unknown key"));
}

#[test]
fn the_emulated_rig_is_checked_too() {
    let output = check(&[rigs().join("emulated.toml").to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("emulated") && text.ends_with("\nfits\n"), "{text}");
    let missing = check(&["nowhere/rig.toml"]);
    let said = String::from_utf8(missing.stderr).unwrap();
    assert_eq!(missing.status.code(), Some(2));
    assert!(said.contains("nowhere/rig.toml: expected a rig file"), "{said}");
}

#[test]
fn what_wired_toml_calls_a_default_is_one() {
    let spelled = Changed::none().read().unwrap();
    let bare: String = WIRED
        .lines()
        .filter(|line| !line.contains("# default;") && !line.ends_with("# default"))
        .collect::<Vec<_>>()
        .join("\n");
    assert!(WIRED.lines().count() > bare.lines().count() + 20, "wired.toml marks its defaults");
    let bare = Changed { rig: bare, database: database() }.read().unwrap();
    let settings = |rig: &Rig| match &rig.device {
        DeviceSpec::Wired(settings) => {
            let mut settings = (**settings).clone();
            // Each test's own folder.
            settings.can.dbc = "rec.dbc".into();
            settings
        }
        DeviceSpec::Emulated(_) => panic!("wired.toml is a wired rig's"),
    };
    assert_eq!(settings(&spelled), settings(&bare));
    assert_eq!((spelled.facts, spelled.limits, spelled.most_share), (bare.facts, bare.limits, bare.most_share));
    assert_eq!(spelled.knowledge, Knowledge::Nothing);
    assert_eq!((settings(&spelled).amplifier.baud, spelled.most_share), (460_800, 0.8));
}

#[test]
fn both_documented_files_name_every_key_of_the_wires() {
    // What the settings know, written out, must stand in the documented file, as a key or as a comment.
    let DeviceSpec::Wired(settings) = Changed::none().read().unwrap().device else { panic!("wired") };
    let text = toml::to_string(&*settings).unwrap();
    let keys = text.lines().filter_map(|line| line.split_once(" = ").map(|(key, _)| key.trim()));
    for key in keys {
        let there =
            |text: &str| text.lines().any(|line| line.trim_start_matches("# ").starts_with(&format!("{key} = ")));
        assert!(there(WIRED) || there(EMULATED), "{key}");
    }
}

#[test]
fn keys_and_values_are_held_against_the_list() {
    for (from, to, words) in [
        ("baud = 460_800 ", "buad = 460_800 ", &["[amplifier] buad: unknown key, did you mean \"baud\"?"] as &[&str]),
        (
            "baud = 460_800 ",
            "baud = 460_801 ",
            &["[amplifier] baud: expected a rate that serial ports have, got 460801", "460800"],
        ),
        ("baud = 460_800 ", "baud = 0 ", &["[amplifier] baud: expected a whole number from 1", "got 0"]),
        ("baud = 460_800 ", "baud = \"fast\" ", &["expected a whole number", "got \"fast\""]),
        (
            "full_scale_v = 24.0",
            "full_scale_v = 0.0",
            &["[amplifier] full_scale_v: expected a finite number above 0 (V), got 0.0"],
        ),
        ("full_scale_v = 24.0", "full_scale_v = inf", &["full_scale_v: expected a finite number above 0 (V), got inf"]),
        ("full_scale_v = 24.0", "full_scale_v = 12.0", &["u_max_v = 24", "got 12", "clipped"]),
        (
            "protocol = \"vesc\"",
            "protocol = \"vecs\"",
            &["[amplifier] protocol: expected one of \"vesc\"", "did you mean \"vesc\"?"],
        ),
        ("protocol = \"vesc\"", "protocol = \"\"", &["[amplifier] protocol: expected a text that is not empty"]),
        (
            "telemetry_every_ticks = 10 ",
            "telemetry_every_ticks = 0 ",
            &["telemetry_every_ticks: expected a whole number from 1"],
        ),
        ("pole_pairs = 1 ", "pole_pairs = 0 ", &["[amplifier.vesc] pole_pairs: expected a whole number from 1 to 255"]),
        ("timeout_ms = 100.0", "timeout_ms = 15.0", &["expected at least 20 ms", "one lost answer"]),
        ("interface = \"can0\"", "interface = \"/dev/can 0\"", &["[can] interface:", "`can0`"]),
        (
            "bitrate = 1_000_000",
            "bitrate = 5_000_000",
            &["[can] bitrate: expected a whole number from 10000 to 1000000"],
        ),
        ("dbc = \"rec.dbc\"", "dbc = \"nowhere.dbc\"", &["[can] dbc:", "nowhere.dbc"]),
        ("gain = 1.0", "gain = 0.0", &["[can.sensors.angle_deg] gain: expected a finite number other than 0, got 0.0"]),
        ("gain = 1.0", "gain = nan", &["gain: expected a finite number other than 0, got nan"]),
        ("offset = 0.0", "offset = inf", &["offset: expected a finite number, got inf"]),
        (
            "period_ms = 20.0",
            "period_ms = 0.0",
            &["[[can.heartbeat]] 1, period_ms: expected a finite number, 1 or more (ms), got 0.0"],
        ),
        ("most_share = 0.8", "most_share = 1.5", &["[budget] most_share: expected a number above 0, at most 1"]),
        ("most_share = 0.8", "most_share = 0", &["[budget] most_share: expected a number above 0, at most 1"]),
        ("kind = \"wired\"", "kind = \"usb\"", &["[device] kind: expected \"emulated\" or \"wired\", got \"usb\""]),
        ("u_max_v = 24.0", "u_max_v = -24.0", &["[rig] u_max_v: expected a finite number above 0 (V), got -24.0"]),
        (
            "brake = \"closed\"",
            "brake = \"ajar\"",
            &["[safe_state] brake: expected \"open\" or \"closed\", got \"ajar\""],
        ),
        (
            "pressure_min_bar = 0.5",
            "pressure_min_bar = 9.0",
            &["[limits] pressure_max_bar: expected above pressure_min_bar, got 8"],
        ),
        ("age_max_ms = 20.0", "age_max_ms = 0.5", &["[limits] age_max_ms: expected a finite number, 1 or more (ms)"]),
        (
            "age_max_ms = 20.0",
            "age_max_ms = 5000.0",
            &["[limits] age_max_ms: expected at least 1, a period, and below 4294.967295", "got 5000"],
        ),
        ("reversed = false", "reversed = 0", &["[amplifier] reversed: expected true or false, got 0"]),
    ] {
        // The message names the line of the key; for the two limits that of the other one.
        let at = if from.starts_with("pressure_min") { "pressure_max_bar" } else { to };
        changed(from, to).refused(at, words);
    }
}

#[test]
fn sections_that_are_missing_or_too_many_are_said() {
    Changed::none().without("[rig]").refused("[device]", &["[rig]: missing", "inertia_kg_m2", "no plant"]);
    Changed::none()
        .without("[can.sensors.pressure2_bar]")
        .refused("[can.sensors.angle_deg]", &["[can.sensors.pressure2_bar]: missing; expected a table with signal"]);
    Changed::none()
        .without("[can.command]")
        .refused("[can]", &["[can.command]: missing; expected a table with brake_open, bypass_open"]);
    changed("running = ", "bypass_open = ").refused("bypass_open = \"VALVES.Running\"", &["duplicate key"]);
    changed("bypass_open = \"VALVES.BypassOpen\"", "")
        .refused("[can.command]\nbrake", &["[can.command] bypass_open: missing"]);
    changed("kind = \"wired\"", "kind = \"wired\"\nmodel = \"model.toml\"")
        .refused("model = \"model.toml\"", &["[device] model: is the plant of the emulated rig"]);
    let failure = changed("kind = \"wired\"", "kind = \"emulated\"").read().expect_err("wires without a use");
    for section in ["[amplifier]", "[can]", "[budget]"] {
        assert!(failure.message.contains(&format!("{section}: only for [device] kind = \"wired\"")), "{failure}");
    }
    let failure = Rig::parse("[device]\nkind = \"wired\"\n", "rig.toml", Path::new("")).expect_err("no wires");
    for section in ["[rig]", "[amplifier]", "[can]"] {
        assert!(failure.message.contains(&format!("{section}: missing")), "{failure}");
    }
}

#[test]
fn everything_that_is_wrong_is_said_at_once() {
    let failure = changed("baud = 460_800 ", "baud = 1 ")
        .rig("gain = 1.0", "gian = 1.0")
        .rig("signal = \"CLAMP.TorqueNm\"", "signal = \"CLAMP.Torque\"")
        .rig("most_share = 0.8", "most_share = -1")
        .rig("name = \"wired rig\"", "name = 3")
        .rig("bypass_open = \"VALVES.BypassOpen\"", "")
        .rig("message = \"VALVES_STATUS\"", "message = \"NOBODY\"")
        .read()
        .expect_err("seven problems");
    assert!(failure.message.starts_with("rig.toml: 7 problems:\n  1. line 4: name: expected a text"), "{failure}");
    for word in ["2. line", "7. line", "baud", "gian", "CLAMP", "most_share", "bypass_open: missing", "NOBODY"] {
        assert!(failure.message.contains(word), "{word}: {failure}");
    }
    let lines: Vec<usize> = failure
        .message
        .lines()
        .filter_map(|line| line.split_once("line ")?.1.split_once(':')?.0.parse().ok())
        .collect();
    assert!(lines.len() == 7 && lines.is_sorted(), "{failure}");

    let syntax = Rig::parse("name = \n[limits\nage_max_ms = 3\n", "rig.toml", Path::new("")).expect_err("no TOML");
    assert!(syntax.message.contains("line 1") && syntax.message.contains("line 2"), "{syntax}");
}

#[test]
fn no_text_makes_it_panic() {
    // Each line left out, cut in half, and its value replaced by others.
    let lines: Vec<&str> = WIRED.lines().collect();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rec.dbc"), database()).unwrap();
    let mut refused = 0;
    for (n, line) in lines.iter().enumerate() {
        let half = &line[..line.len() / 2];
        let key = line.split('=').next().unwrap();
        let others = ["\"\"", "-1", "1e400", "{}", "[[]]", "true", "nan", "2000-01-01", "99999999999999999999"];
        for other in [String::new(), half.to_owned()].into_iter().chain(others.map(|value| format!("{key} = {value}")))
        {
            let mut changed = lines.clone();
            changed[n] = &other;
            refused += usize::from(Rig::parse(&changed.join("\n"), "rig.toml", folder.path()).is_err());
        }
    }
    assert!(refused > 400, "{refused}");
}
