//! The web monitor in a browser, against a service with an emulated rig; and its decoding and decimation in node.
//!
//! ```text
//! REC_BENCH_PEERS=required cargo test --release -p bench --test web_monitor -- --nocapture   # fails where chromium can't be had
//! ```
//!
//! The scripts in `tests/browser` do what a person would; what they saw is printed. With `MONITOR_SCREENSHOT=FILE.png` the picture of the
//! README is taken on the way.
#![allow(clippy::unwrap_used, reason = "a test")]

mod browser;

use browser::{Peers, peers, scripts};
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

/// Nothing takes so long; the machine may be slow.
const PATIENCE: Duration = Duration::from_secs(120);
const TOKEN: &str = "a-token-of-the-web-monitor-test";
/// The sensor of pressure 1 is wrong for this one tick, by one bit: 3.75 bar.
const SPIKE_S: f64 = 7.5;
/// No pressure of the run comes here; with the bit it does.
const SPIKE_BAR: f64 = 5.5;

/// A program that ends with the test, whatever its outcome.
struct Running {
    child: Child,
    /// What it said that has not been looked at yet.
    said: Receiver<String>,
}

impl Running {
    fn start(args: &[&str]) -> Running {
        let mut child = Command::new(env!("CARGO_BIN_EXE_bench"))
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (sender, said) = channel();
        listen(child.stdout.take().unwrap(), sender.clone());
        listen(child.stderr.take().unwrap(), sender);
        Running { child, said }
    }

    /// The first line that holds `what`.
    fn line_with(&self, what: &str) -> String {
        let mut all = String::new();
        loop {
            match self.said.recv_timeout(PATIENCE) {
                Ok(line) if line.contains(what) => return line,
                Ok(line) => all += &(line + "\n"),
                Err(RecvTimeoutError::Timeout) => panic!("no line with {what:?} after {PATIENCE:?}:\n{all}"),
                Err(RecvTimeoutError::Disconnected) => panic!("it ended without a line with {what:?}:\n{all}"),
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself. A stopped process is killed as well.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn listen(stream: impl Read + Send + 'static, sender: Sender<String>) {
    thread::spawn(move || {
        // Read to its end also when nobody looks at it any more, so that the program is not held up.
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            let _ = sender.send(line);
        }
    });
}

fn instance(name: &str) -> String {
    format!("test-web-{name}-{}", std::process::id())
}

/// A service of this test alone, with the address that it prints. Its profiles are written already.
fn serve(dir: &Path, name: &str, more: &[&str]) -> (Running, String) {
    let path = |name: &str| dir.join(name).display().to_string();
    let instance = instance(name);
    fs::create_dir_all(dir.join("data")).unwrap();
    let (profiles, data) = (path("profiles"), path("data"));
    let usual = ["--listen", "127.0.0.1:0", "--profiles", &profiles, "--data", &data, "--instance", &instance];
    let service = Running::start(&[&["serve"], more, &usual[..]].concat());
    let line = service.line_with("http://127.0.0.1:");
    let address = line.split_whitespace().find(|word| word.starts_with("http://")).unwrap();
    (service, address.trim_end_matches(|c: char| ",.;)".contains(c)).to_owned())
}

fn token_file(dir: &Path) -> String {
    let file = dir.join("token");
    fs::write(&file, TOKEN).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    file.display().to_string()
}

/// Runs one of the scripts to its end and prints what it saw.
fn script(name: &str, peers: &Peers, variables: &[(&str, &str)]) {
    let mut command = Command::new("node");
    command.arg(scripts().join(name)).envs(variables.iter().copied());
    command.env("MONITOR_PACKAGES", &peers.packages).env("MONITOR_CHROMIUM", &peers.chromium);
    let told = browser::run(&mut command).unwrap_or_else(|told| panic!("{told}"));
    let told = String::from_utf8_lossy(&told.stdout);
    assert!(told.contains("all seen"), "{told}");
    println!("{told}");
}

/// Moves the lever to both sides for long enough to be watched; one sample of a sensor is wrong meanwhile.
fn moving_profile(dir: &Path) {
    let text = format!(
        "name = \"to_be_watched\"\nprotocol = \"square-wave\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
         about = \"The lever to both sides, with one wrong sample\"\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nfor_s = 0.5\n\
         [[step]]\nrepeat = 25\n\
         [[step.step]]\ntarget = {{ quantity = \"angle_deg\", wave = \"sine\", amplitude = 8.0, frequency_hz = 0.2 }}\nfor_s = 5.0\n\
         [[step.step]]\nbypass = \"open\"\nbrake = \"closed\"\nvoltage_v = 0.0\nfor_s = 0.5\n\
         [[step.step]]\nbypass = \"closed\"\nbrake = \"open\"\nvoltage_u_max = 0.2\nuntil = [{{ channel = \"angle_deg\", above = 4.0 }}]\ntimeout_s = 2.0\n\
         [[step.step]]\ntarget = {{ pressure1_bar = 2.9 }}\nfor_s = 2.0\n\
         [[step.step]]\ntarget = {{ quantity = \"angle_deg\", wave = \"ramp\", to = 0.0, rate_per_s = 5.0 }}\nfor_s = 2.0\n\
         [[fault]]\nkind = \"bit-flip\"\ninput = \"pressure1_bar\"\nat_s = {SPIKE_S}\nfor_s = 0.001\nbit = 13\nrange = [0.0, 30.0]\n"
    );
    fs::create_dir_all(dir.join("profiles")).unwrap();
    fs::write(dir.join("profiles/to_be_watched.toml"), text).unwrap();
}

#[test]
fn a_run_is_started_watched_and_stopped_in_a_browser() {
    let Some(peers) = peers() else { return };
    let dir = tempfile::tempdir().unwrap();
    moving_profile(dir.path());
    let token = token_file(dir.path());
    let (service, address) = serve(dir.path(), "monitor", &["--control", "--token-file", &token]);
    let address = format!("{}#token={TOKEN}", address.split('#').next().unwrap());
    let (pid, spike_s, spike_bar) = (service.child.id().to_string(), SPIKE_S.to_string(), SPIKE_BAR.to_string());
    let variables = [
        ("MONITOR_ADDRESS", address.as_str()),
        ("MONITOR_PID", &pid),
        ("MONITOR_PROFILE", "to_be_watched"),
        ("MONITOR_SPIKE_S", &spike_s),
        ("MONITOR_SPIKE_BAR", &spike_bar),
    ];
    script("monitor.js", &peers, &variables);
}

#[test]
fn people_confirm_in_the_browser() {
    let Some(peers) = peers() else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let (pump, can, folder) = (path("pump"), format!("unix:{}", path("can")), path("rig"));
    let rig = ["emulate", "--serial", &pump, "--can", &can, "--write-rig", &folder];
    let slow = ["--node-timeout-ms", "60000", "--amplifier-timeout-ms", "60000"];
    let emulated = Running::start(&[&rig[..], &slow[..]].concat());
    emulated.line_with("run against it");
    without_fixture(&dir.path().join("rig/rig.toml"));
    fs::create_dir_all(dir.path().join("profiles")).unwrap();
    let steps = "name = \"asks\"\nprotocol = \"clamp-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
         [start]\nfixture = \"free\"\nbrake = \"closed\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nfor_s = 0.1\n\
         [[step]]\nfixture = \"clamped\"\nangle_deg = 0.0\nfor_s = 0.1\n\
         [[step]]\noperator = \"Weigh what came out\"\namount = \"volume_ml\"\n\
         [[step]]\nfor_s = 0.1\n";
    fs::write(dir.path().join("profiles/asks.toml"), steps).unwrap();
    let (rig, token) = (path("rig/rig.toml"), token_file(dir.path()));
    let (_service, address) = serve(dir.path(), "confirm", &[&rig, "--control", "--token-file", &token]);
    let address = format!("{}#token={TOKEN}", address.split('#').next().unwrap());
    script("confirm.js", &peers, &[("MONITOR_ADDRESS", &address), ("MONITOR_PROFILE", "asks")]);
}

/// A rig whose fixture people move, with the patience of a loaded machine.
fn without_fixture(file: &Path) {
    let written = fs::read_to_string(file).unwrap();
    let mut kept = String::new();
    let mut within = false;
    for line in written.lines() {
        if line.starts_with('[') {
            within = line.starts_with("[can.fixture]");
        }
        if !within {
            kept += &format!("{line}\n");
        }
    }
    assert!(kept.len() < written.len(), "{written}");
    for (key, patient) in [
        ("age_max_ms = 20.0 ", "missing_max_ticks = 60000\nage_max_ms = 4000.0 "),
        ("heartbeat_max_ms = 100.0", "heartbeat_max_ms = 4000.0"),
        ("timeout_ms = 100.0", "timeout_ms = 60000.0"),
    ] {
        assert!(kept.contains(key), "{key}");
        kept = kept.replace(key, patient);
    }
    fs::write(file, kept).unwrap();
}

#[test]
fn a_read_only_service_follows_a_run_of_another_process_and_offers_no_controls() {
    let Some(peers) = peers() else { return };
    let dir = tempfile::tempdir().unwrap();
    moving_profile(dir.path());
    let (_service, address) = serve(dir.path(), "read-only", &[]);
    let profile = dir.path().join("profiles/to_be_watched.toml").display().to_string();
    let out = dir.path().join("data/a.mcap").display().to_string();
    let _run = Running::start(&["run", &profile, "--realtime", "--instance", &instance("read-only"), "--out", &out]);
    script("read_only.js", &peers, &[("MONITOR_ADDRESS", &address)]);
}

#[test]
fn decoding_decimation_and_formats_hold_their_promises() {
    let Some(node) = browser::node() else { return };
    let mut tests: Vec<_> = fs::read_dir(scripts()).unwrap().map(|entry| entry.unwrap().path()).collect();
    tests.retain(|path| path.to_string_lossy().ends_with(".test.js"));
    tests.sort();
    assert!(tests.len() >= 3, "{tests:?}");
    let told = browser::run(Command::new(node).arg("--test").args(&tests)).unwrap_or_else(|told| panic!("{told}"));
    let told = String::from_utf8_lossy(&told.stdout);
    assert!(told.contains("fail 0") && !told.contains("pass 0"), "{told}");
}

#[test]
fn the_page_s_modules_pass_the_type_checker() {
    let Some(peers) = peers() else { return };
    let compiler = peers.packages.join("node_modules/typescript/bin/tsc");
    browser::run(Command::new("node").arg(compiler).arg("--project").arg(scripts()))
        .unwrap_or_else(|told| panic!("{told}"));
}
