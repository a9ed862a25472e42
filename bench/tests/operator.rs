//! Runs on a rig that needs people: asked in the run's own terminal, confirmed there or from another process, recorded and replayed.

use recordings::{Event, Item, McapReader};
use rt_core::Sample;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Nothing takes so long; the machine may be slow.
const PATIENCE: Duration = Duration::from_secs(120);

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

/// Ends with the test, whatever its outcome.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// An emulated rig on wires whose rig file says nothing of an automatic fixture: people do its work.
struct Rig {
    _serves: Running,
    dir: tempfile::TempDir,
}

impl Rig {
    fn start() -> Rig {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let file = |name: &str| dir.path().join(name).display().to_string();
        let (pump, can, folder) = (file("pump"), format!("unix:{}", file("can")), file("rig"));
        let args = ["emulate", "--serial", &pump, "--can", &can, "--write-rig", &folder];
        let slow = ["--node-timeout-ms", "60000", "--amplifier-timeout-ms", "60000"];
        let mut child = bench(&[&args[..], &slow[..]].concat())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut line = String::new();
        while !line.starts_with("run against it") {
            line.clear();
            assert!(stdout.read_line(&mut line).expect("text") > 0, "it ended by itself");
        }
        // It may go on talking; nobody listens.
        thread::spawn(move || std::io::copy(&mut stdout, &mut std::io::sink()));
        let rig = Rig { _serves: Running(child), dir };
        rig.without_fixture();
        rig
    }

    /// No fixture, and the patience of a loaded machine.
    fn without_fixture(&self) {
        let file = self.file("rig/rig.toml");
        let written = std::fs::read_to_string(&file).expect("written by the program");
        let mut kept = String::new();
        let mut within = false;
        for line in written.lines() {
            if line.starts_with('[') {
                within = line.starts_with("[can.fixture]");
            }
            if !within {
                kept.push_str(line);
                kept.push('\n');
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
        std::fs::write(&file, kept).expect("a temporary folder");
    }

    fn file(&self, name: &str) -> String {
        self.dir.path().join(name).display().to_string()
    }

    /// A clamp, and a reading.
    fn profile(&self) -> String {
        let path = self.file("asks.toml");
        let steps = "name = \"asks\"\nprotocol = \"clamp-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
             [start]\nfixture = \"free\"\nbrake = \"closed\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
             [[step]]\nfor_s = 0.1\n\
             [[step]]\nfixture = \"clamped\"\nangle_deg = 0.0\nfor_s = 0.1\n\
             [[step]]\noperator = \"Weigh what came out\"\namount = \"volume_ml\"\n\
             [[step]]\nfor_s = 0.1\n";
        std::fs::write(&path, steps).expect("a temporary folder");
        path
    }

    /// The arguments of a run that records into a file of this name.
    fn run(&self, name: &str, instance: &str) -> Vec<String> {
        let (profile, rig, out) = (self.profile(), self.file("rig/rig.toml"), self.file(name));
        ["run", &profile, "--realtime", "--rig", &rig, "--out", &out, "--instance", instance]
            .map(str::to_owned)
            .to_vec()
    }
}

fn instance(name: &str) -> String {
    format!("test-operator-{name}-{}", std::process::id())
}

fn recorded(path: &Path) -> (Vec<Sample>, Vec<Event>) {
    let (mut samples, mut events) = (Vec::new(), Vec::new());
    for item in McapReader::open(path).expect("a recording") {
        match item.expect("a sound recording") {
            Item::Sample(sample) => samples.push(sample),
            Item::Event(event) => events.push(event),
            Item::Amplifier(_) => {}
        }
    }
    (samples, events)
}

/// What the recording says of the run above, which was confirmed with this amount.
fn assert_recorded(path: &str, volume_ml: f64) {
    let (samples, events) = recorded(Path::new(path));
    let confirmed: Vec<&Sample> = samples.iter().filter(|s| s.confirmed()).collect();
    assert_eq!(confirmed.len(), 2);
    assert!(samples.iter().filter(|s| s.waiting()).all(|s| s.voltage_v == 0.0 && s.step > 0 && s.step < 3));
    assert_eq!(confirmed[1].volume_ml, volume_ml);
    assert!(confirmed[1].age_ns[4] == 0 && confirmed[1].quality & 1 << 4 != 0, "a valid value of that tick");
    // The wait for the clamp is a segment of its own.
    assert_eq!(confirmed.iter().map(|s| (s.step, s.segment)).collect::<Vec<_>>(), [(1, 1), (2, 3)]);
    let told: Vec<&str> =
        events.iter().filter(|event| event.source == "operator").map(|event| event.text.as_str()).collect();
    assert_eq!(told.len(), 5, "{told:?}");
    assert!(told[0].contains("prepare the rig for asks: lever turns in the horizontal plane"), "{told:?}");
    assert!(told[1].ends_with("clamp the lever at 0 deg") && told[2].starts_with("confirmed after "), "{told:?}");
    assert!(told[3].ends_with("Weigh what came out") && told[4].ends_with(&format!(": {volume_ml} ml")), "{told:?}");

    let replay = output(&["replay", path]);
    assert!(replay.status.success(), "{}{}", text(&replay.stdout), text(&replay.stderr));
}

/// Asks again and again until the command says what is expected.
fn until(args: &[&str], run: &mut Child, expected: impl Fn(&Output) -> bool) -> Output {
    let begun = Instant::now();
    loop {
        let said = output(args);
        if expected(&said) {
            return said;
        }
        let told = format!("{}{}", text(&said.stdout), text(&said.stderr));
        assert!(run.try_wait().expect("a child").is_none(), "the run ended by itself: {told}");
        assert!(begun.elapsed() < PATIENCE, "{args:?}: {told}");
        thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn another_process_confirms_and_what_does_not_fit_is_refused_with_the_reason() {
    let rig = Rig::start();
    let instance = instance("confirm");
    let args = rig.run("a.mcap", &instance);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let mut run =
        Running(bench(&args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"));
    let show = ["confirm", "--show", "--instance", &instance];
    let asked = |what: &'static str| move |said: &Output| text(&said.stdout).contains(what);
    let confirm = |more: &[&str]| output(&[&["confirm", "--instance", &instance], more].concat());

    until(&show, &mut run.0, asked("asked: prepare the rig for asks"));
    assert!(confirm(&[]).status.success());
    until(&show, &mut run.0, asked("asked: clamp the lever at 0 deg"));
    let wrong = confirm(&["--volume-ml", "2"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(text(&wrong.stderr).contains("expected a confirmation without an amount"), "{}", text(&wrong.stderr));
    assert!(confirm(&[]).status.success());
    until(&show, &mut run.0, asked("with an amount in ml: Weigh what came out"));
    let wrong = confirm(&[]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(text(&wrong.stderr).contains("expected the amount in ml"), "{}", text(&wrong.stderr));
    let taken = confirm(&["--volume-ml", "1.25"]);
    assert!(taken.status.success() && text(&taken.stdout).starts_with("confirmed at tick "), "{}", text(&taken.stderr));

    let mut said = String::new();
    run.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    assert_eq!(run.0.wait().expect("a child").code(), Some(0), "{said}");
    assert!(said.contains("ASKED: clamp the lever at 0 deg (confirm with `bench confirm --instance"), "{said}");
    assert_recorded(&rig.file("a.mcap"), 1.25);
    let late = confirm(&[]);
    assert_eq!(late.status.code(), Some(4), "nobody is there any more: {}", text(&late.stderr));
}

#[test]
fn enter_confirms_in_the_runs_own_terminal_and_the_amount_is_typed() {
    let rig = Rig::start();
    let instance = instance("keys");
    let mut line = env!("CARGO_BIN_EXE_bench").to_owned();
    rig.run("b.mcap", &instance).iter().for_each(|arg| line.push_str(&format!(" {arg}")));
    // `script` (Debian: bsdutils, always there) gives the run a terminal.
    let mut command = Command::new("script");
    command.args(["-qec", &line, "/dev/null"]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut script = Running(command.spawn().expect("script starts"));
    let mut keys = script.0.stdin.take().expect("piped");
    let mut screen = script.0.stdout.take().expect("piped");
    let (shown, lines) = std::sync::mpsc::channel();
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = screen.read(&mut bytes) {
            let _ = shown.send(text(&bytes[..count]));
        }
    });
    let mut seen = String::new();
    let mut wait_for = |what: &str| {
        let begun = Instant::now();
        while !seen.contains(what) {
            assert!(begun.elapsed() < PATIENCE, "{what:?} is not on the screen: {seen}");
            seen.extend(lines.recv_timeout(Duration::from_millis(100)).ok());
        }
        seen.clear();
        // People read before they press a key; what comes at once is not taken.
        thread::sleep(Duration::from_millis(700));
    };
    for (what, pressed) in [
        ("ASKED: prepare the rig", &b"\n"[..]),
        ("ASKED: clamp the lever at 0 deg", b"\n"),
        ("ASKED: Weigh what came out", b"\n"),
        ("not taken: expected the amount", b"2,57\x7f\n"),
    ] {
        wait_for(what);
        keys.write_all(pressed).and_then(|()| keys.flush()).expect("the terminal is there");
    }
    assert_eq!(script.0.wait().expect("a child").code(), Some(0));
    assert_recorded(&rig.file("b.mcap"), 2.5);
}

#[test]
fn a_wait_is_ended_by_a_stop_and_by_the_emergency_stop_in_the_preparation_and_in_the_run() {
    let rig = Rig::start();
    for (prepared, stop, code) in [
        (false, &["stop"][..], 130),
        (false, &["stop", "--emergency"], 5),
        (true, &["stop"], 130),
        (true, &["stop", "--emergency"], 5),
    ] {
        let name = format!("{prepared}-{code}");
        let instance = instance(&name);
        let out = format!("{name}.mcap");
        let args = rig.run(&out, &instance);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let mut run =
            Running(bench(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"));
        let show = ["confirm", "--show", "--instance", &instance];
        until(&show, &mut run.0, |said| text(&said.stdout).contains("prepare the rig"));
        if prepared {
            assert!(output(&["confirm", "--instance", &instance]).status.success());
            until(&show, &mut run.0, |said| text(&said.stdout).contains("clamp the lever"));
        }
        let stopped = output(&[stop, &["--instance", &instance]].concat());
        assert!(stopped.status.success(), "{}", text(&stopped.stderr));
        assert_eq!(run.0.wait().expect("a child").code(), Some(code));
        let recording = PathBuf::from(rig.file(&out));
        assert_eq!(recording.exists(), prepared, "what was not begun leaves no recording");
        if prepared {
            let (samples, _) = recorded(&recording);
            let last = samples.last().expect("samples");
            assert!(last.tripped() == (code == 5) && !last.waiting() && last.voltage_v == 0.0);
            let replay = output(&["replay", &recording.display().to_string()]);
            assert!(replay.status.success(), "{}{}", text(&replay.stdout), text(&replay.stderr));
        }
    }
}

#[test]
fn where_nobody_is_a_profile_that_needs_people_is_refused_before_anything_moves() {
    let rig = Rig::start();
    let args = rig.run("c.mcap", &instance("nobody"));
    let mut args: Vec<&str> = args.iter().map(String::as_str).collect();
    args.push("--no-operator");
    let refused = output(&args);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    let said = text(&refused.stderr);
    assert!(
        said.contains("--no-operator") && said.contains("the first at line 12: clamp the lever at 0 deg"),
        "{said}"
    );
    assert!(!Path::new(&rig.file("c.mcap")).exists());
    // The emulated rig does it itself.
    let out = rig.file("d.mcap");
    let alone = output(&["run", &rig.profile(), "--no-operator", "--out", &out, "--instance", &instance("alone")]);
    assert!(alone.status.success(), "{}", text(&alone.stderr));
    let (samples, events) = recorded(Path::new(&out));
    assert!(samples.len() == 301 && samples.iter().all(|s| !s.waiting() && !s.confirmed()));
    assert!(events.iter().all(|event| event.source != "operator"));
}
