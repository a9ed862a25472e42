//! A run watched and stopped from another machine: over loopback, over a bad network between two network namespaces, and over one that is
//! cut. Without root the namespaces can't be had; the test says so, and with `REC_BENCH_PEERS=required` fails where it is root.
#![allow(clippy::unwrap_used, reason = "a test")]

mod ends;

use ends::network::{Network, RIG};
use ends::{BENCH, Running, compare, read};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::Duration;

const SCRIPT: &str = r#"
name = "crossing"
protocol = "random-steps"
role = "validate"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
fill_bar = 2.8
[[step]]
repeat = REPEAT
  [[step.step]]
  voltage_v = 9.0
  for_s = 0.5
  [[step.step]]
  voltage_v = -9.0
  for_s = 0.5
"#;

/// A folder with a profile of so many seconds.
fn profile(seconds: u32) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("crossing.toml");
    std::fs::write(&path, SCRIPT.replace("REPEAT", &seconds.to_string())).unwrap();
    (dir, path)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Names of the rig's instance and of the far one.
fn instances(test: &str) -> [String; 2] {
    ["rig", "far"].map(|end| format!("link-{test}-{end}-{}", std::process::id()))
}

fn here(_side: usize) -> Command {
    Command::new(BENCH)
}

/// Both ends, connected.
fn link(command: &dyn Fn(usize) -> Command, [rig, far]: &[String; 2], address: &str, control: bool) -> [Running; 2] {
    let more: &[&str] = if control { &["--control"] } else { &[] };
    let serve = ["link", "serve", "--instance", rig, "--listen", address, "--allow-remote"];
    let mut serve = Running::start(command(0), &[&serve, more].concat());
    serve.wait_for("is served on");
    let mut connect = Running::start(command(1), &["link", "connect", address, "--remote", rig, "--instance", far]);
    connect.wait_for(if control { "answers, with commands" } else { "answers, read-only" });
    [serve, connect]
}

fn record(command: Command, out: &Path, instance: &str) -> Running {
    let mut recorder = Running::start(command, &["record", "--out", text(out), "--instance", instance]);
    recorder.wait_for("waiting for a run");
    recorder
}

fn run(command: Command, profile: &Path, out: &Path, instance: &str) -> Running {
    Running::start(command, &["run", text(profile), "--realtime", "--instance", instance, "--out", text(out)])
}

/// A port that nobody has at the moment.
fn loopback() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    format!("127.0.0.1:{}", listener.local_addr().unwrap().port())
}

#[test]
fn over_loopback_everything_crosses_and_the_far_recording_can_be_replayed() {
    let (dir, profile) = profile(3);
    let instances = instances("loopback");
    let address = loopback();
    let [mut serve, mut connect] = link(&here, &instances, &address, false);
    let (own, far) = (dir.path().join("rig.mcap"), dir.path().join("far.mcap"));
    let recorder = record(here(1), &far, &instances[1]);
    let mut running = run(here(0), &profile, &own, &instances[0]);
    connect.wait_for("run 0 begins");

    // The port is taken: said in plain words.
    let again = here(0).args(["link", "serve", "--instance", &instances[0], "--listen", &address]).output().unwrap();
    let said = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(again.status.code() == Some(4) && said.contains("--listen") && !said.contains(".rs"), "{said}");

    // Read-only: to look is allowed, to stop is not.
    let ask = |arguments: &[&str]| {
        let output = Command::new(BENCH).args(arguments).args(["--instance", &instances[1]]).output().unwrap();
        let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
        (output.status.code().unwrap(), said)
    };
    let (code, said) = ask(&["confirm", "--show"]);
    assert_eq!((code, said.trim()), (0, "nothing is asked for"));
    let (code, said) = ask(&["stop", "--emergency"]);
    assert!(code == 4 && said.contains("read-only") && said.contains("--control"), "{code}: {said}");
    serve.wait_for("refused: emergency stop from the other end");

    running.wait_for("recording: ");
    let (code, said) = running.end();
    assert_eq!(code, 0, "the refused stop stopped nothing: {said}");
    let (code, said) = recorder.end();
    let (_, certificate) = compare(&own, &far);
    // A machine that stalls for long enough loses samples here, too; then it is said.
    assert_eq!(code, if certificate.is_lossless() { 0 } else { 6 }, "{said}");
    assert!(certificate.end_seen, "{certificate}");
    if certificate.is_lossless() {
        let replay = Command::new(BENCH).arg("replay").arg(&far).output().unwrap();
        assert!(replay.status.success(), "what the run is has crossed: {}", String::from_utf8_lossy(&replay.stderr));
    }
    for end in [serve, connect] {
        end.interrupt();
        assert_eq!(end.end().0, 0);
    }
}

#[test]
fn over_a_bad_network_gaps_are_certified_and_an_emergency_stop_crosses() {
    let Some(network) = Network::new(Duration::from_millis(20), 0.05) else { return };
    let (dir, profile) = profile(12);
    let instances = instances("bad");
    let command = |side: usize| network.command(side, BENCH);

    // What is usual here, without a link.
    let usual = dir.path().join("usual.mcap");
    let (code, said) = run(command(0), &profile, &usual, &instances[0]).end();
    assert_eq!(code, 0, "{said}");

    let [mut serve, mut connect] = link(&command, &instances, RIG, true);
    let (own, far) = (dir.path().join("rig.mcap"), dir.path().join("far.mcap"));
    let recorder = record(command(1), &far, &instances[1]);
    let running = run(command(0), &profile, &own, &instances[0]);
    connect.wait_for("run 0 begins");
    thread::sleep(Duration::from_secs(3));
    // Longer than what the link holds back: a gap for certain.
    network.black(true);
    thread::sleep(Duration::from_millis(2000));
    network.black(false);
    let (code, said) = running.end();
    assert_eq!(code, 0, "{said}");
    let (code, said) = recorder.end();
    let (crossed, certificate) = compare(&own, &far);
    assert_eq!(code, 6, "{said}");
    eprintln!("{}", connect.so_far());
    assert!(certificate.end_seen && !certificate.gaps.is_empty(), "{certificate}; {}", connect.so_far());
    assert!(crossed.len() > 3_000, "most of what was sent before crossed: {certificate}");
    let (passed, dropped) = network.counts();
    eprintln!("{certificate}; of {} packets {dropped} were lost", passed + dropped);
    assert!(dropped * 100 > passed, "the network was bad");

    // A link costs the loop no ticks: beyond what is usual, few.
    let skipped = |path: &Path| read(path).0.last_key_value().map_or(0, |(_, sample)| sample.skipped);
    let (with, without) = (skipped(&own), skipped(&usual));
    eprintln!("ticks passed over: {without} without a link, {with} with one");
    assert!(with <= without + 1_200, "a tenth of the run more: {without} without a link, {with} with one");

    let tripped = dir.path().join("tripped.mcap");
    connect.wait_for("run 0 has crossed");
    connect.said.clear(); // another program, another run 0
    let running = run(command(0), &profile, &tripped, &instances[0]);
    connect.wait_for("run 0 begins");
    thread::sleep(Duration::from_secs(2));
    let stop = command(1).args(["stop", "--emergency", "--instance", &instances[1]]).output().unwrap();
    let said = [stop.stdout, stop.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert_eq!(stop.status.code(), Some(0), "{said}");
    assert!(said.contains("tripped at tick"), "{said}");
    serve.wait_for("emergency stop from the other end: taken");
    let (code, said) = running.end();
    assert_eq!(code, 5, "{said}");
    let (samples, _) = read(&tripped);
    let last = samples.last_key_value().unwrap().1;
    assert!(last.tripped() && last.voltage_v == 0.0, "{last:?}");
}

#[test]
fn a_link_that_is_cut_leaves_the_run_alone_and_the_far_side_says_so() {
    let Some(network) = Network::new(Duration::from_millis(1), 0.0) else { return };
    let (dir, profile) = profile(14);
    let instances = instances("cut");
    let command = |side: usize| network.command(side, BENCH);
    let [_serve, mut connect] = link(&command, &instances, RIG, true);
    let (own, far) = (dir.path().join("rig.mcap"), dir.path().join("far.mcap"));
    let recorder = record(command(1), &far, &instances[1]);
    let running = run(command(0), &profile, &own, &instances[0]);
    connect.wait_for("run 0 begins");
    thread::sleep(Duration::from_secs(2));
    network.cut();
    connect.wait_for("no sign of life from");
    connect.wait_for("is gone");
    let stop = command(1).args(["stop", "--emergency", "--instance", &instances[1]]).output().unwrap();
    let said = String::from_utf8_lossy(&stop.stderr).into_owned();
    assert!(stop.status.code() == Some(4) && !said.contains("panicked"), "{:?}: {said}", stop.status);

    let (code, said) = recorder.end();
    assert!(code == 6 && said.contains("the service is gone"), "{code}: {said}");
    let (code, said) = running.end();
    assert_eq!(code, 0, "nothing of it reached the run: {said}");
    let (crossed, certificate) = compare(&own, &far);
    assert!(!certificate.end_seen && crossed.len() > 500, "{certificate}");
}
