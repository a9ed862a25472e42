//! `bench run`, `bench stop` and `bench replay` as a person or a job uses them: processes, exit codes, files.

use recordings::{Item, McapReader, McapWriter};
use rt_core::{Sample, flags};
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

fn bench(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(args).stdin(Stdio::null());
    command
}

fn output(args: &[&str]) -> Output {
    bench(args).output().expect("the program starts")
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
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

fn samples(path: &Path) -> Vec<Sample> {
    let reader = McapReader::open(path).expect("a recording");
    let items = reader.map(|item| item.expect("a sound recording"));
    items.filter_map(|item| if let Item::Sample(sample) = item { Some(sample) } else { None }).collect()
}

/// A profile of so many seconds at 6 V and 0 V in turns.
fn profile(dir: &Path, seconds: u32, extra: &str) -> String {
    let text = format!(
        "name = \"short\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n{extra}\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nrepeat = {seconds}\n[[step.step]]\nvoltage_v = 6.0\nfor_s = 0.5\n[[step.step]]\nvoltage_v = -6.0\nfor_s = 0.5\n"
    );
    let path = dir.join("short.toml");
    std::fs::write(&path, text).expect("a temporary folder");
    path.display().to_string()
}

/// An instance of this test's own.
fn instance(name: &str) -> String {
    format!("test-{name}-{}", std::process::id())
}

#[test]
fn a_run_in_real_time_that_can_not_be_recorded_ends_and_does_not_hang() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("not_a_recording").display().to_string();
    let mut child = Running(
        bench(&["run", "square_h", "--realtime", "--out", &file, "--instance", &instance("no-recording")])
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts"),
    );
    // The profile takes 44 s: the end of patience is a hang, not a slow machine.
    let ended = (0..600).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(200));
        child.0.try_wait().expect("a child")
    });
    assert_eq!(ended.and_then(|status| status.code()), Some(2), "None: it hangs");
    let mut said = String::new();
    child.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    assert!(said.contains(".mcap"), "{said}");
}

#[test]
fn a_name_that_is_taken_is_refused_before_anything_is_begun() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for (there, what) in [("a.mcap", "never overwritten"), ("a.mcap.part", "bench recover")] {
        let there = dir.path().join(there);
        std::fs::write(&there, "a measurement").expect("a temporary folder");
        let file = dir.path().join("a.mcap").display().to_string();
        let run = output(&["run", "square_h", "--out", &file, "--instance", &instance("taken")]);
        assert_eq!(run.status.code(), Some(2), "{}", stderr(&run));
        assert!(stderr(&run).contains(what) && stderr(&run).contains("--out"), "{}", stderr(&run));
        assert_eq!(std::fs::read_to_string(&there).expect("still there"), "a measurement");
        std::fs::remove_file(&there).expect("it is there");
    }
}

#[test]
fn a_run_in_virtual_time_is_replayed_bit_for_bit_and_a_changed_bit_is_found() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let recording = dir.path().join("random_a.mcap");
    let file = recording.display().to_string();
    let run = output(&["run", "random_a", "--out", &file, "--instance", &instance("lockstep"), "--seed", "3"]);
    assert!(run.status.success(), "{}", stderr(&run));
    let ticks = samples(&recording).len();
    assert!(stdout(&run).contains(&format!("random_a: {ticks} of {ticks} samples")), "{}", stdout(&run));

    let replay = output(&["replay", &file]);
    assert!(replay.status.success(), "{}", stderr(&replay));
    assert!(stdout(&replay).contains(&format!("{ticks} ticks agree bit for bit")), "{}", stdout(&replay));

    let changed = dir.path().join("changed.mcap");
    let mut all = samples(&recording);
    all[1234].voltage_v = f64::from_bits(all[1234].voltage_v.to_bits() ^ 1);
    let mut writer = McapWriter::create(&changed, McapReader::open(&recording).expect("sound").run()).expect("new");
    all.iter().for_each(|sample| writer.write(sample).expect("sound"));
    let certificate = writer.certificate(all.len() as u64);
    writer.finish(&certificate).expect("closed");
    let replay = output(&["replay", &changed.display().to_string()]);
    assert_eq!(replay.status.code(), Some(3));
    assert!(stdout(&replay).contains("1234 ticks agree, then tick 1234, voltage_v"), "{}", stdout(&replay));
}

#[test]
fn the_same_run_twice_gives_the_same_bytes() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let record = |name: &str| {
        let path = dir.path().join(name);
        let run = output(&["run", "square_v", "--out", &path.display().to_string(), "--instance", &instance("twice")]);
        assert!(run.status.success(), "{}", stderr(&run));
        std::fs::read(path).expect("was written")
    };
    assert_eq!(record("a.mcap"), record("b.mcap"));
}

#[test]
fn a_run_in_real_time_keeps_every_sample_and_is_replayed_bit_for_bit() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("short.mcap").display().to_string();
    let instance = instance("realtime");
    let run = output(&["run", &profile(dir.path(), 2, ""), "--realtime", "--out", &file, "--instance", &instance]);
    assert!(run.status.success(), "{}", stderr(&run));
    assert!(stdout(&run).contains("wake-up late by p50"), "{}", stdout(&run));
    let all = samples(Path::new(&file));
    let last = all.last().expect("samples");
    // A loaded machine may skip ticks; none of those that were run is lost.
    assert_eq!(all.len() as u64 + last.skipped, 2000);
    assert!(all.iter().all(|s| s.woken_ns > 0 && s.voltage_v.abs() == 6.0));
    let replay = output(&["replay", &file]);
    assert!(replay.status.success(), "{}{}", stdout(&replay), stderr(&replay));
}

#[test]
fn an_emergency_stop_from_another_process_trips_the_run() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("short.mcap").display().to_string();
    let instance = instance("emergency");
    let profile = profile(dir.path(), 600, "");
    let mut command = bench(&["run", &profile, "--realtime", "--out", &file, "--instance", &instance]);
    let mut run = Running(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"));
    // Until the run listens, the demand is refused.
    let stop = loop {
        let stop = output(&["stop", "--emergency", "--instance", &instance]);
        if stop.status.success() {
            break stop;
        }
        assert_eq!(stop.status.code(), Some(4), "{}", stderr(&stop));
        assert!(run.0.try_wait().expect("a child").is_none(), "the run ended by itself");
    };
    assert!(stdout(&stop).contains("tripped at tick"), "{}", stdout(&stop));
    assert_eq!(run.0.wait().expect("a child").code(), Some(5));
    let all = samples(Path::new(&file));
    let first = all.iter().position(Sample::tripped).expect("it tripped");
    assert!(all[first..].iter().all(|s| s.tripped() && s.voltage_v == 0.0 && !s.brake_open() && s.bypass_open()));
    assert_eq!(all[first].trip, 9 | 6 << 8, "emergency stop, demanded");
    let replay = output(&["replay", &file]);
    assert!(replay.status.success(), "{}{}", stdout(&replay), stderr(&replay));
    let incident = dir.path().join(format!("short.{}-trip.json", all[first].tick));
    assert!(incident.exists(), "the flight recorder left {}", incident.display());
}

#[test]
fn the_space_bar_is_the_emergency_stop() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("short.mcap");
    let profile = profile(dir.path(), 600, "");
    // `script` (Debian: bsdutils, always there) gives the run a terminal.
    let run = [env!("CARGO_BIN_EXE_bench"), "run", &profile, "--realtime", "--out", &file.display().to_string()];
    let line = format!("{} --instance {}", run.join(" "), instance("keyboard"));
    let mut command = Command::new("script");
    command.args(["-qec", &line, "/dev/null"]).stdin(Stdio::piped()).stdout(Stdio::null());
    let mut script = Running(command.spawn().expect("script starts"));
    let mut keys = script.0.stdin.take().expect("piped");
    // The terminal is watched soon after the recording begins; until then a key is only echoed.
    let code = loop {
        if file.with_extension("mcap.part").exists() && keys.write_all(b" ").and_then(|()| keys.flush()).is_err() {
            break script.0.wait().expect("a child").code();
        }
        if let Some(status) = script.0.try_wait().expect("a child") {
            break status.code();
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
    };
    assert_eq!(code, Some(5));
    assert!(samples(&file).last().is_some_and(|last| last.trip == 9 | 6 << 8), "emergency stop, demanded");
}

#[test]
fn an_orderly_stop_is_130_and_latches_nothing() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("short.mcap").display().to_string();
    let instance = instance("stop");
    let profile = profile(dir.path(), 600, "");
    let mut command = bench(&["run", &profile, "--realtime", "--out", &file, "--instance", &instance]);
    let mut run = Running(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"));
    while !output(&["stop", "--instance", &instance]).status.success() {
        assert!(run.0.try_wait().expect("a child").is_none(), "the run ended by itself");
    }
    assert_eq!(run.0.wait().expect("a child").code(), Some(130));
    let last = samples(Path::new(&file)).pop().expect("samples");
    assert!(last.last() && last.flags & flags::STOPPED != 0 && !last.tripped() && last.voltage_v == 0.0);
}

#[test]
fn a_killed_service_leaves_a_readable_part_and_nothing_that_blocks_the_next_start() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| dir.path().join(name).display().to_string();
    let instance = instance("killed");
    let long = profile(dir.path(), 600, "");
    let mut command = bench(&["run", &long, "--realtime", "--out", &file("killed.mcap"), "--instance", &instance]);
    let mut run = Running(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"));
    let part = dir.path().join("killed.mcap.part");
    while !part.metadata().is_ok_and(|m| m.len() > 40_000) {
        assert!(run.0.try_wait().expect("a child").is_none(), "the run ended by itself");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    run.0.kill().expect("it is ours");
    run.0.wait().expect("a child");
    // What is there can be read up to the cut, and the cut is told.
    let items: Vec<_> = McapReader::open(&part).expect("a recording").collect();
    let sound = items.iter().filter(|item| matches!(item, Ok(Item::Sample(_)))).count();
    // The first chunk, half a second; fewer where the machine made the loop pass over ticks.
    assert!(sound >= 250, "{sound} samples");
    assert!(items.last().is_some_and(Result::is_err), "an unfinished recording says so");

    let short = profile(dir.path(), 1, "");
    let again = output(&["run", &short, "--realtime", "--out", &file("again.mcap"), "--instance", &instance]);
    assert!(again.status.success(), "{}", stderr(&again));
}

/// Fills the disk of a run once it has begun to record into this file. A limit of file sizes stands for the disk. Not before: shared memory is
/// files too.
fn fill_disk(run: &mut Running, part: &Path) {
    while !part.exists() {
        assert!(run.0.try_wait().expect("a child").is_none(), "the run ended by itself");
    }
    let pid = rustix::process::Pid::from_child(&run.0);
    let full = rustix::process::Rlimit { current: Some(100_000), maximum: Some(100_000) };
    rustix::process::prlimit(Some(pid), rustix::process::Resource::Fsize, full).expect("it is ours");
}

#[test]
fn a_full_disk_is_told_and_leaves_a_readable_recording() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for on_full in ["go-on", "stop"] {
        let file = dir.path().join(format!("{on_full}.mcap"));
        let profile = profile(dir.path(), 6, "");
        let instance = instance(&format!("full-{on_full}"));
        let args = ["run", &profile, "--realtime", "--out", &file.display().to_string(), "--instance", &instance];
        let mut command = bench(&[&args[..], &["--on-full", on_full]].concat());
        let mut run =
            Running(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"));
        fill_disk(&mut run, &file.with_extension("mcap.part"));
        let mut said = String::new();
        run.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
        let follows = if on_full == "stop" { "the run is stopped" } else { "the run goes on unrecorded" };
        assert!(said.contains(follows), "{said}");
        assert!(said.contains("on the emulated rig (no --rig)"), "{said}");
        // Nobody wanted the end of the run: it is a loss, and the last words say of which disk.
        assert_eq!(run.0.wait().expect("a child").code(), Some(6), "{on_full}: {said}");
        let error = said.lines().last().expect("an error");
        assert_eq!(
            error.contains("was stopped for it") && error.contains(&file.display().to_string()),
            on_full == "stop",
            "{error}"
        );
        // What was written before is there, closed, and certified as a part of the run.
        let mut reader = McapReader::open(&file).expect("a recording");
        let sound = reader.by_ref().filter(|item| matches!(item, Ok(Item::Sample(_)))).count();
        assert!(sound > 100, "{sound} samples");
        assert!(reader.certificate().is_some_and(|certificate| !certificate.is_lossless()), "closed, and not whole");
    }
}

#[test]
fn a_full_disk_ends_a_campaign_which_goes_on_once_there_is_room() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (profile, campaign) = (profile(dir.path(), 6, ""), dir.path().join("campaign"));
    let out = campaign.display().to_string();
    let args = ["campaign", "--realtime", "--out", &out, &profile];
    let mut command = bench(&args);
    let mut run = Running(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"));
    fill_disk(&mut run, &campaign.join("short.mcap.part"));
    let mut said = String::new();
    run.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    assert_eq!(run.0.wait().expect("a child").code(), Some(6), "{said}");
    for words in ["on the emulated rig (no --rig)", "; the run is stopped", "was stopped for it", "is set aside as"] {
        assert!(said.contains(words), "{words:?} is missing in: {said}");
    }
    assert!(!campaign.join("short.mcap").exists(), "what is not whole is no run of the campaign");

    let again = output(&args);
    assert!(again.status.success(), "{}", stderr(&again));
    assert!(samples(&campaign.join("short.mcap")).len() > 5000);
}

#[test]
fn a_recording_that_can_not_even_be_closed_is_exit_code_6_though_its_timing_can_not_be_read() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("open.mcap");
    let (profile, instance) = (profile(dir.path(), 6, ""), instance("unclosed"));
    let args = ["run", &profile, "--realtime", "--out", &file.display().to_string(), "--instance", &instance];
    let mut run =
        Running(bench(&args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"));
    let part = file.with_extension("mcap.part");
    let size = || std::fs::metadata(&part).map_or(0, |there| there.len());
    // Until samples are in it: what is written at first is the description alone.
    let mut first = 0;
    while first == 0 || size() == first {
        first = if first == 0 { size() } else { first };
        assert!(run.0.try_wait().expect("a child").is_none(), "the run ended by itself");
    }
    let pid = rustix::process::Pid::from_child(&run.0);
    let full = rustix::process::Rlimit { current: Some(10), maximum: Some(10) };
    rustix::process::prlimit(Some(pid), rustix::process::Resource::Fsize, full).expect("it is ours");
    let mut said = String::new();
    run.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    assert_eq!(run.0.wait().expect("a child").code(), Some(6), "{said}");
    assert!(said.contains("could not be closed") && said.contains("no timing of this run"), "{said}");
    assert!(part.exists() && !file.exists(), "what was written stays for `bench recover`");
}

#[test]
fn nobody_to_stop_is_exit_code_4() {
    let stop = output(&["stop", "--instance", &instance("nobody")]);
    assert_eq!(stop.status.code(), Some(4));
    assert!(stderr(&stop).contains("no running service"), "{}", stderr(&stop));
}

#[test]
fn bad_usage_is_exit_code_2_and_says_what_to_do() {
    for (args, expected) in [
        (vec!["run", "squarewave"], "square_h"),
        (vec!["run", "square_h", "--require-rt"], "--realtime"),
        (vec!["run", "square_h", "--rig", "nowhere.toml"], "nowhere.toml"),
        (vec!["run", "square_h", "--instance", "a/b"], "instance name \"a/b\""),
        (vec!["stop", "--instance", "a/b"], "instance name \"a/b\""),
        (vec!["run", "."], "expected a script (*.toml), got \"Is a directory"),
        (vec!["profile", "check", "."], "name one of the scripts in this folder"),
        (vec!["run", "square_h", "--seed", "-1"], "expected a whole number from 0"),
        (vec!["replay", "nowhere.mcap"], "nowhere.mcap"),
    ] {
        let run = output(&args);
        assert_eq!(run.status.code(), Some(2), "{args:?}: {}", stderr(&run));
        assert!(stderr(&run).contains(expected), "{args:?}: {}", stderr(&run));
    }
}
