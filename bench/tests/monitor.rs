//! `bench monitor` as a person sees it: in a terminal, beside a real run that it must not disturb, and what a script gets.
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "monitor/terminal.rs"]
mod terminal;

use bench::monitor::screen::Screen;
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use terminal::Terminal;

/// Set for the child of the test of a panic.
const PANICS: &str = "REC_BENCH_TEST_MONITOR_PANICS";

fn bench(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(args).stdin(Stdio::null()).env_remove("RUST_LOG");
    command
}

/// Ends with the test, whatever its outcome.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn instance(name: &str) -> String {
    format!("test-monitor-{name}-{}", std::process::id())
}

/// A run of many seconds at 6 V and 0 V in turns, in real time.
fn start_run(dir: &Path, instance: &str) -> Running {
    let profile = dir.join("short.toml");
    let text = "name = \"short\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nrepeat = 300\n[[step.step]]\nvoltage_v = 6.0\nfor_s = 0.5\n[[step.step]]\nvoltage_v = -6.0\nfor_s = 0.5\n";
    std::fs::write(&profile, text).unwrap();
    let (profile, out) = (profile.display().to_string(), dir.join("short.mcap").display().to_string());
    let child = bench(&["run", &profile, "--realtime", "--out", &out, "--instance", instance])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    Running(child)
}

#[test]
fn it_waits_for_a_run_shows_it_at_any_size_and_trips_it_where_that_is_allowed() {
    let dir = tempfile::tempdir().unwrap();
    let instance = instance("shows");
    let mut terminal = Terminal::start(&mut bench(&["monitor", "--control", "--instance", &instance]), 24, 80);
    terminal.shows(&["NO RUN YET", "waiting for a run", "EMERGENCY STOP"]);

    let mut run = start_run(dir.path(), &instance);
    terminal.shows(&[
        "RUNNING",
        "run 0: short, square-wave",
        "asked for",
        "V    voltage",
        "lateness p50",
        "run 0 begins",
    ]);
    terminal.shows(&["6 V", "pass 1 of 300"]);
    let narrow = terminal.text();
    assert!(!narrow.contains("lateness, ms"), "no room for that curve:\n{narrow}");

    terminal.resize(60, 180);
    terminal.shows(&["RUNNING", "voltage, V", "pressures, bar", "angle, deg", "lateness, ms"]);
    terminal.resize(10, 40);
    terminal.shows(&["RUNNING", "asked for"]);
    terminal.resize(24, 80);
    terminal.types("+");
    terminal.shows(&["last 30 s"]);

    terminal.types("E");
    terminal.shows(&["ENDED", "tripped, emergency stop demanded", "emergency stop was taken by the run"]);
    assert_eq!(run.0.wait().unwrap().code(), Some(5), "the run tripped, and ended as such");
    terminal.types("q");
    assert_eq!(terminal.ends().code(), Some(0));
    terminal.is_given_back();
}

#[test]
fn a_service_that_is_killed_is_said_to_be_silent_then_gone_and_a_signal_gives_the_terminal_back() {
    let dir = tempfile::tempdir().unwrap();
    let instance = instance("killed");
    let mut terminal = Terminal::start(&mut bench(&["monitor", "--instance", &instance]), 24, 80);
    terminal.shows(&["NO RUN YET"]);
    let mut run = start_run(dir.path(), &instance);
    terminal.shows(&["RUNNING"]);
    terminal.types("E");
    terminal.shows(&["start the monitor with --control"]);
    terminal.shows(&["RUNNING"]);
    run.0.kill().unwrap();
    run.0.wait().unwrap();
    terminal.shows(&["no samples for", "nobody publishes", "the service is gone"]);
    // Another one is picked up.
    let again = tempfile::tempdir().unwrap();
    let _again = start_run(again.path(), &instance);
    terminal.shows(&["RUNNING"]);
    terminal.signal(libc::SIGTERM);
    assert_eq!(terminal.ends().code(), Some(130));
    terminal.is_given_back();
}

#[test]
fn a_panic_gives_the_terminal_back() {
    if std::env::var_os(PANICS).is_some() {
        let mut screen = Screen::open().unwrap();
        screen.terminal.draw(|frame| frame.render_widget("drawn before the panic", frame.area())).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(300));
        panic!("on purpose");
    }
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["a_panic_gives_the_terminal_back", "--exact", "--nocapture", "--test-threads=1"]).env(PANICS, "1");
    let mut terminal = Terminal::start(&mut command, 24, 80);
    terminal.shows(&["drawn before the panic"]);
    assert_eq!(terminal.ends().code(), Some(101));
    terminal.is_given_back();
    assert!(terminal.text().contains("on purpose"), "its message stands on the shell's screen:\n{}", terminal.text());
}

fn output(args: &[&str]) -> (i32, String, String) {
    let Output { status, stdout, stderr } = bench(args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (status.code().unwrap(), text(&stdout), text(&stderr))
}

#[test]
fn a_script_gets_one_snapshot_and_no_terminal_is_refused_with_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let instance = instance("script");
    let (code, stdout, stderr) = output(&["monitor", "--instance", &instance]);
    assert!(code == 2 && stdout.is_empty() && stderr.contains("--once"), "{code}: {stderr}");
    let (code, _, stderr) = output(&["monitor", "--json", "--instance", &instance]);
    assert!(code == 2 && stderr.contains("--once"), "{code}: {stderr}");

    let (code, stdout, stderr) = output(&["monitor", "--once", "--json", "--wait-s", "0.3", "--instance", &instance]);
    let nothing: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((code, &nothing["state"], &nothing["run"]), (4, &Value::from("no-run-yet"), &Value::Null), "{stderr}");
    assert!(stderr.contains("waited 0.3 s") && stderr.contains("bench run"), "{stderr}");

    let _run = start_run(dir.path(), &instance);
    let (code, stdout, stderr) = output(&["monitor", "--once", "--json", "--wait-s", "60", "--instance", &instance]);
    assert_eq!(code, 0, "{stderr}");
    let told: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((&told["state"], &told["run"]["name"]), (&Value::from("running"), &Value::from("short")), "{stdout}");
    let sample = &told["sample"];
    assert_eq!(sample["voltage_v"].as_f64().unwrap().abs(), 6.0, "{stdout}");
    assert_eq!((&sample["target"]["of"], &sample["target"]["value"]), (&Value::from("voltage"), &sample["voltage_v"]));
    assert!(sample["inputs"]["pressure1_bar"]["value"].as_f64().unwrap() > 0.5, "{stdout}");
    assert!(told["timing"]["ticks"].as_u64().unwrap() > 100, "it followed the run for a second: {stdout}");

    let (code, stdout, _) = output(&["monitor", "--once", "--instance", &instance]);
    assert!(code == 0 && stdout.contains("RUNNING") && stdout.contains("pressure 1"), "{stdout}");
}
