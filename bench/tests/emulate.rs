//! `bench emulate` as a person uses it: a rig on wires in one process, the bench that runs it in another.

use recordings::{AmplifierReport, Item, McapReader};
use rt_core::{Input, PERIOD_NS, Sample, flags};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Output, Stdio};

fn bench(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(args).stdin(Stdio::null());
    command
}

fn output(args: &[&str]) -> Output {
    bench(args).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// An emulated rig that serves; ends with the test, whatever its outcome.
struct Rig {
    child: Child,
    stdout: BufReader<ChildStdout>,
}

impl Rig {
    /// Started, with its wires open.
    fn start(args: &[&str]) -> Rig {
        let mut all = vec!["emulate"];
        all.extend(args);
        let mut child = bench(&all).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
        // The last line of the greeting.
        let mut line = String::new();
        while !line.starts_with("run against it") {
            line.clear();
            let read = stdout.read_line(&mut line).expect("text");
            if read == 0 {
                let mut stderr = String::new();
                let _ = child.stderr.take().expect("piped").read_to_string(&mut stderr);
                panic!("it ended by itself: {stderr}");
            }
        }
        Rig { child, stdout }
    }

    /// Ctrl-C. What it says at its end: stdout, stderr, exit code.
    fn end(mut self) -> (String, String, Option<i32>) {
        kill_process(Pid::from_child(&self.child), Signal::INT).expect("it still runs");
        let (mut stdout, mut stderr) = (String::new(), String::new());
        self.stdout.read_to_string(&mut stdout).expect("text");
        let _ = self.child.stderr.take().expect("piped").read_to_string(&mut stderr);
        let code = self.child.wait().expect("a child").code();
        (stdout, stderr, code)
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn samples(path: &Path) -> Vec<Sample> {
    let reader = McapReader::open(path).expect("a recording");
    let items = reader.map(|item| item.expect("a sound recording"));
    items.filter_map(|item| if let Item::Sample(sample) = item { Some(sample) } else { None }).collect()
}

/// The recording holds the amplifier's reports, each within its tick, and the files of the rig.
fn reported(recording: &Path, samples: &[Sample], rig: &Path) {
    let reader = McapReader::open(recording).expect("a recording");
    let run = reader.run().clone();
    for (name, file) in [("rig.toml", "rig.toml"), ("rig.dbc", "rec.dbc")] {
        assert_eq!(run.files[name], std::fs::read_to_string(rig.join(file)).expect("a rig's file"));
    }
    assert!(
        run.calibration.contains("full_scale_v") && run.calibration.contains("pressure1_bar"),
        "{}",
        run.calibration
    );
    let reports =
        reader.filter_map(|item| if let Item::Amplifier(report) = item.expect("sound") { Some(report) } else { None });
    let reports: Vec<AmplifierReport> = reports.collect();
    let last = samples.last().expect("samples").tick;
    assert!(reports.len() > 20, "{} reports of {last} ticks", reports.len());
    assert!(reports.is_sorted_by_key(|report| report.arrived_ns));
    for report in &reports {
        assert!(report.tick == report.arrived_ns / PERIOD_NS && report.tick <= last, "{report:?}");
        assert!((20.0..30.0).contains(&report.supply_v) && report.fault.is_none(), "{report:?}");
    }
    let any = |of: &dyn Fn(&AmplifierReport) -> bool| reports.iter().any(of);
    assert!(any(&|report| report.motor_current_a > 0.05) && any(&|report| report.motor_current_a < -0.05), "both ways");
}

/// Two seconds at +-6 V. The limits of age are those of a loaded machine.
fn profile(dir: &Path) -> String {
    let text = "name = \"short\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nrepeat = 2\n[[step.step]]\nvoltage_v = 6.0\nfor_s = 0.5\n[[step.step]]\nvoltage_v = -6.0\nfor_s = 0.5\n";
    let path = dir.join("short.toml");
    std::fs::write(&path, text).expect("a temporary folder");
    path.display().to_string()
}

/// With patience: a machine that others load holds threads up for longer than a rig may be silent.
fn patient(rig: &Path) {
    let text = std::fs::read_to_string(rig).expect("written by the program");
    let mut changed = text.clone();
    for (key, patient) in [
        ("age_max_ms = 20.0 ", "missing_max_ticks = 4000\nage_max_ms = 4000.0 "),
        ("heartbeat_max_ms = 100.0", "heartbeat_max_ms = 4000.0"),
        ("timeout_ms = 100.0", "timeout_ms = 4000.0"),
    ] {
        assert!(changed.contains(key), "{key}");
        changed = changed.replace(key, patient);
    }
    std::fs::write(rig, changed).expect("a temporary folder");
}

#[test]
fn a_run_over_both_wires_moves_the_rig_and_the_rig_ends_cleanly() {
    for protocol in ["vesc", "tmcl"] {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let file = |name: &str| dir.path().join(name).display().to_string();
        let (pump, can, folder) = (file("pump"), format!("unix:{}", file("can")), file("rig"));
        let slow = ["--node-timeout-ms", "4000", "--amplifier-timeout-ms", "4000"];
        let mut args = vec!["--serial", &pump, "--can", &can, "--write-rig", &folder, "--protocol", protocol];
        args.extend(slow);
        let emulated = Rig::start(&args);
        assert!(std::fs::read_link(&pump).is_ok_and(|to| to.exists()), "the port is there");

        let rig = dir.path().join("rig/rig.toml");
        patient(&rig);
        let rig = rig.display().to_string();
        let check = output(&["check", &rig]);
        assert!(check.status.success(), "{}{}", text(&check.stdout), text(&check.stderr));

        let (recording, instance) = (file("run.mcap"), format!("test-emulate-{protocol}-{}", std::process::id()));
        let run = output(&[
            "run",
            &profile(dir.path()),
            "--realtime",
            "--rig",
            &rig,
            "--out",
            &recording,
            "--instance",
            &instance,
        ]);
        assert!(run.status.success(), "{}{}", text(&run.stdout), text(&run.stderr));
        let all = samples(Path::new(&recording));
        let last = all.last().expect("samples");
        assert_eq!(all.len() as u64 + last.skipped, 2000);
        // What is read at a tick was measured on a command before it.
        let wanted = Input::Angle.bit() | Input::Pressure1.bit() | Input::Pressure2.bit();
        let measured: Vec<&Sample> = all.iter().skip(50).filter(|s| s.quality & wanted == wanted).collect();
        assert!(measured.len() > 1000, "{} of {} samples hold all that is measured", measured.len(), all.len());
        assert!(measured.iter().all(|s| s.age_ns[0] >= 1_000_000 && s.flags & flags::FAULT == 0));
        let pressures = measured.iter().map(|s| s.pressure1_bar);
        let (low, high) = pressures.fold((f64::INFINITY, 0.0f64), |(low, high), p| (low.min(p), high.max(p)));
        assert!(high - low > 0.1, "the pump moves oil: {low} .. {high} bar");

        reported(Path::new(&recording), &all, &dir.path().join("rig"));

        let (stdout, stderr, code) = emulated.end();
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        assert!(stdout.contains("command frames") && stderr.contains("run 0: prepared"), "{stdout}{stderr}");
        assert!(!Path::new(&pump).is_symlink(), "the link is taken away");
    }
}

#[test]
fn what_cannot_be_put_on_wires_is_told_with_an_exit_code() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| dir.path().join(name).display().to_string();
    let (pump, can) = (file("pump"), format!("unix:{}", file("can")));
    std::fs::write(file("taken"), "a file of somebody's").expect("a temporary folder");
    std::fs::create_dir_all(file("old")).expect("a temporary folder");
    std::fs::write(file("old/rig.toml"), "calibrated").expect("a temporary folder");
    std::fs::write(file("emulated.toml"), "name = \"a\"\n").expect("a temporary folder");
    let (taken, old, emulated, nowhere) = (file("taken"), file("old"), file("emulated.toml"), file("nowhere.toml"));
    let cases: [(&[&str], i32, &str); 9] = [
        (&["--serial", &pump, "--can", "can 0"], 2, "can 0"),
        (&["--serial", &pump, "--can", "nosuch0"], 4, "nosuch0"),
        (&["--serial", &pump, "--can", &can, "--protocol", "modbus"], 2, "\"vesc\""),
        (&["--serial", &taken, "--can", &can], 4, "taken"),
        (&["--serial", &pump, "--can", &can, "--rig", &nowhere], 2, "nowhere.toml"),
        (&["--serial", &pump, "--can", &can, "--rig", &emulated], 2, "wired"),
        (&["--serial", &pump, "--can", &can, "--model", &nowhere], 2, "nowhere.toml"),
        (&["--serial", &pump, "--can", &can, "--node-timeout-ms", "0"], 2, "node_timeout_ms"),
        (&["--serial", &pump, "--can", &can, "--write-rig", &old], 2, "old"),
    ];
    for (args, code, says) in cases {
        let mut all = vec!["emulate"];
        all.extend(args);
        let ended = output(&all);
        let stderr = text(&ended.stderr);
        assert_eq!(ended.status.code(), Some(code), "{args:?}: {stderr}");
        assert!(stderr.contains(says), "{args:?}: {stderr}");
    }
    assert_eq!(std::fs::read_to_string(file("old/rig.toml")).expect("still there"), "calibrated");
    assert_eq!(std::fs::read_to_string(taken).expect("still there"), "a file of somebody's");
}
