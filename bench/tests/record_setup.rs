//! What a recording says of rig, machine and program, and that a recorder in another process says the same: its file can be replayed, too.

mod recorder;

use recorder::{Recorder, folder, instance};
use recordings::{McapReader, RunMetadata};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn bench(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(args).stdin(Stdio::null()).env_remove("RUST_LOG").output().expect("the program starts")
}

#[track_caller]
fn succeeds(args: &[&str]) -> String {
    let output = bench(args);
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert_eq!(output.status.code(), Some(0), "bench {}: {said}", args.join(" "));
    said
}

fn metadata(path: &Path) -> RunMetadata {
    McapReader::open(path).expect("a recording").run().clone()
}

/// A profile of one second, with a target that needs the model.
fn profile(dir: &Path) -> String {
    let text = "name = \"short\"\nprotocol = \"constant-flow\"\nrole = \"identify\"\nplane = \"vertical\"\n\
                [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
                [[step]]\nflow_ml_s = 3.0\nfor_s = 0.5\n[[step]]\nvoltage_v = -4.0\nfor_s = 0.5\n";
    let path = dir.join("short.toml");
    std::fs::write(&path, text).expect("a temporary folder");
    text_of(path)
}

fn text_of(path: PathBuf) -> String {
    path.into_os_string().into_string().expect("a path of plain letters")
}

#[test]
fn a_recorder_in_another_process_knows_what_it_records_and_its_file_can_be_replayed() {
    for (name, time) in [("virtual", vec![]), ("real", vec!["--realtime"])] {
        let (dir, out) = folder();
        let (profile, instance) = (profile(dir.path()), instance(&format!("setup-{name}")));
        let own = text_of(dir.path().join("own.mcap"));
        // What the command line says is for services that say nothing.
        let recorder = Recorder::start(&out, &instance, &["--protocol", "pump-map", "--role", "validate"], None);
        let run = [&["run", &profile, "--instance", &instance, "--seed", "7", "--out", &own], time.as_slice()].concat();
        succeeds(&run);
        let (code, stdout, stderr) = recorder.end();
        assert_eq!(code, 0, "{stdout}{stderr}");
        let (own_run, mut run) = (metadata(Path::new(&own)), metadata(&out));
        assert_eq!(run.notes.remove("recorder").as_deref(), Some("bench record"));
        assert!(run.notes.remove("recorded_from_utc").is_some());
        assert_eq!(run, own_run, "{name}");
        assert_eq!((run.name.as_str(), &*run.profile), ("short", &*std::fs::read_to_string(&profile).expect("text")));
        assert_eq!(run.notes.keys().any(|key| key.starts_with("realtime")), name == "real", "{:?}", run.notes);
        let said = succeeds(&["replay", &own, &text_of(out)]);
        assert_eq!(said.matches("ticks agree bit for bit").count(), 2, "{said}");
    }
}

#[test]
fn a_recorder_that_joins_a_run_under_way_knows_what_it_records() {
    let (dir, out) = folder();
    let instance = instance("setup-late");
    let text = std::fs::read_to_string(profile(dir.path())).expect("text").replace("for_s = 0.5", "for_s = 600");
    let profile = dir.path().join("long.toml");
    std::fs::write(&profile, &text).expect("writable");
    let own = text_of(dir.path().join("own.mcap"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(["run", &text_of(profile), "--instance", &instance, "--out", &own, "--realtime"]);
    let mut run = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    let part = PathBuf::from(format!("{own}.part"));
    while !part.exists() {
        assert!(run.try_wait().expect("our own child").is_none(), "it ended before it recorded");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let mut recorder = Recorder::start(&out, &instance, &[], None);
    recorder.wait_for("recording to");
    succeeds(&["stop", "--instance", &instance]);
    assert_eq!(run.wait().expect("our own child").code(), Some(130));
    let (_, stdout, stderr) = recorder.end();
    let (own_run, run) = (metadata(Path::new(&own)), metadata(&out));
    assert_eq!((&run.profile, &run.files, &run.host), (&text, &own_run.files, &own_run.host), "{stdout}{stderr}");
    assert!(!stderr.contains("expected its service to say"), "{stderr}");
}

#[test]
fn a_recording_says_rig_machine_and_program_and_stays_the_same_bytes() {
    let (dir, _) = folder();
    let profile = profile(dir.path());
    let rig = dir.path().join("rig.toml");
    let text = "# a rig of ours, \u{e4}\nname = \"bench 3\"\n[limits]\npressure_max_bar = 8.0\n";
    std::fs::write(&rig, text).expect("writable");
    let recorded = |name: &str| {
        let out = dir.path().join(name);
        let instance = instance("setup-same");
        succeeds(&[
            "run",
            &profile,
            "--rig",
            &text_of(rig.clone()),
            "--instance",
            &instance,
            "--out",
            &text_of(out.clone()),
        ]);
        out
    };
    let (first, second) = (recorded("a.mcap"), recorded("b.mcap"));
    let bytes = |path: &Path| std::fs::read(path).expect("a file");
    assert_eq!(bytes(&first), bytes(&second));
    let run = metadata(&first);
    assert_eq!(run.files["rig.toml"], text);
    let model = model::ModelFile::parse(&run.files["model.toml"], "model.toml").expect("the controller's model");
    assert_eq!(model, model::ModelFile::plain(model::Parameters::example()));
    assert_eq!(run.calibration, "", "the emulated rig in this process has none");
    assert_eq!(run.host, bench::machine::host());
    assert_eq!(run.program, bench::machine::program());
    let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").expect("Linux");
    assert!(run.host["kernel"].contains(kernel.trim()), "{:?}", run.host);
}
