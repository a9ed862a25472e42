//! A campaign from script to folder, over shared memory, with a device whose every answer is known.

use bench::campaign::known::Known;
use bench::campaign::{Session, Settings};
use bench::devices::Devices;
use bench::failure::Kind;
use bench::progress::Progress;
use bench::setup::Knowledge;
use model::{ModelFile, Parameters};
use profiles::Script;
use recordings::{Campaign, Plane, Protocol, Recording, RigFacts, Role};
use rt_core::{Command, Device, DeviceError, Limits, Measurement, Switches, Tick};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Says its own tick and the command before it; fails or bursts when told to.
#[derive(Default)]
struct Echo {
    voltage_v: f64,
    fails_at: Option<u64>,
    bursts_at: Option<u64>,
    written: Vec<Command>,
}

impl Device for Echo {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        if self.fails_at == Some(now.index) {
            return Err(DeviceError {
                device: "echo",
                tick: now.index,
                what: "expected an answer, got none; check the cable".into(),
            });
        }
        let pressure1_bar =
            if self.bursts_at.is_some_and(|t| now.index >= t) { 50.0 } else { 2.0 + 1e-6 * now.index as f64 };
        Ok(Measurement { angle_deg: self.voltage_v, pressure1_bar, pressure2_bar: 2.5, ..Measurement::NONE })
    }

    fn write(&mut self, _now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.voltage_v = command.voltage_v;
        self.written.push(*command);
        Ok(())
    }
}

fn script(name: &str, seconds: f64) -> Script {
    let text = format!(
        "name = \"{name}\"\nprotocol = \"random-steps\"\nrole = \"validate\"\nplane = \"vertical\"\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\n\
         [[step]]\nfor_s = 0.5\n[[step]]\nvoltage_v = 6.0\nbrake = \"closed\"\nfor_s = {seconds}\n"
    );
    Script::parse(&text, name).expect("the script is written by hand above")
}

fn settings(dir: PathBuf) -> Settings {
    Settings {
        dir,
        name: "echo".into(),
        rig: RigFacts { inertia_kg_m2: 0.085, gravity_nm: 4.0, u_max_v: 24.0 },
        limits: Limits::default(),
        seed: 7,
        notes: [("device".to_owned(), "echo".to_owned())].into(),
        mode: bench::runner::Mode::Lockstep,
        on_full: bench::recorder::OnFull::GoOn,
    }
}

/// One session a process at a time: they share the process's instance name.
static ONE: std::sync::Mutex<()> = std::sync::Mutex::new(());

fn record(dir: &Path, devices: Vec<Echo>) -> Vec<Result<bench::campaign::Recorded, bench::failure::Failure>> {
    let _one = ONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let mut session =
        Session::create(settings(dir.to_owned()), &Progress::for_stderr()).expect("shared memory is there");
    let mut outcomes = Vec::new();
    for (i, mut device) in devices.into_iter().enumerate() {
        let script = script(&format!("run_{i}"), 20.0 + i as f64);
        let switches = Switches::new();
        outcomes.push(session.run(&script, &mut device, &Knowledge::Nothing, &switches, &Progress::for_stderr()));
    }
    session.finish().expect("the publication ends");
    outcomes
}

#[test]
fn every_sample_is_in_the_folder_as_the_device_said_it() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let outcomes = record(dir.path(), vec![Echo::default(), Echo::default()]);
    for (i, outcome) in outcomes.into_iter().enumerate() {
        let n = 20_500 + 1000 * i as u64;
        let recorded = outcome.expect("nothing fails");
        assert_eq!(recorded.certificate.to_string(), format!("{n} of {n} samples"));
    }

    let campaign = Campaign::open(dir.path()).expect("a campaign folder");
    assert_eq!(campaign.name, "echo");
    assert_eq!(campaign.rig, settings(PathBuf::new()).rig);
    assert_eq!(campaign.runs.len(), 2);
    for (i, entry) in campaign.runs.iter().enumerate() {
        assert_eq!((entry.protocol, entry.role, entry.plane), (Protocol::RandomSteps, Role::Validate, Plane::Vertical));
        let run: Recording = campaign.read(entry).expect("readable");
        assert_eq!(run.len(), 20_500 + 1000 * i);
        for k in 0..run.len() {
            assert_eq!(run.time_s[k], k as f64 * 1_000_000.0 * 1e-9);
            assert_eq!(run.pressure1_bar[k], 2.0 + 1e-6 * k as f64, "row {k}");
            assert_eq!(run.voltage_v[k], if k < 500 { 0.0 } else { 6.0 });
            assert_eq!(run.angle_deg[k], if k <= 500 { 0.0 } else { 6.0 }, "measured before the command of its tick");
            assert_eq!(run.brake_open[k], k < 500);
        }
        assert!(run.torque_nm.iter().all(|t| t.is_nan()));
    }
}

#[test]
fn the_same_session_leaves_the_same_bytes() {
    let bytes = || {
        let dir = tempfile::tempdir().expect("a temporary folder");
        record(dir.path(), vec![Echo::default()]).remove(0).expect("nothing fails");
        ["campaign.toml", "run_0.mcap"].map(|file| std::fs::read(dir.path().join(file)).expect("written"))
    };
    assert_eq!(bytes(), bytes());
}

#[test]
fn a_device_that_fails_is_4_and_leaves_a_closed_recording() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let device = Echo { fails_at: Some(700), ..Echo::default() };
    let failure = record(dir.path(), vec![device]).remove(0).expect_err("the device fails");
    assert_eq!(failure.kind, Kind::Device);
    assert!(failure.message.contains("echo at tick 700") && failure.message.contains("check the cable"), "{failure}");
    let run = Recording::read(&dir.path().join("run_0.mcap"), Protocol::RandomSteps).expect("closed properly");
    assert_eq!(run.len(), 701, "700 good ticks and the one of the fault");
}

#[test]
fn a_trip_is_5_and_what_followed_is_recorded() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let device = Echo { bursts_at: Some(1000), ..Echo::default() };
    let failure = record(dir.path(), vec![device]).remove(0).expect_err("50 bar trips");
    assert_eq!(failure.kind, Kind::Safety);
    assert!(failure.message.contains("run_0") && failure.message.contains("50"), "{failure}");
    let run = Recording::read(&dir.path().join("run_0.mcap"), Protocol::RandomSteps).expect("closed properly");
    assert_eq!(run.voltage_v[999], 6.0);
    assert!(run.voltage_v[1000..].iter().all(|v| *v == 0.0), "the safe state from the tick of the trip on");
    assert!(run.len() > 1001, "the aftermath is there");
}

#[test]
fn a_stop_is_130_and_zeroes_the_output() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let _one = ONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let mut session =
        Session::create(settings(dir.path().to_owned()), &Progress::for_stderr()).expect("shared memory is there");
    let script = script("run_0", 5.0);
    let mut device = Echo::default();
    let switches = Switches::new();
    switches.stop.store(true, Ordering::Relaxed);
    let outcome = session.run(&script, &mut device, &Knowledge::Nothing, &switches, &Progress::for_stderr());
    assert_eq!(outcome.expect_err("it was stopped").kind, Kind::Interrupted);
    assert_eq!(device.written.last().map(|c| (c.voltage_v, c.brake_open)), Some((0.0, false)));
}

/// Runs one script on the emulated rig as a campaign does, in a session whose folder is there already.
fn run_all(dir: &Path, switches: &Switches) -> Result<(), bench::failure::Failure> {
    let _one = ONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let progress = Progress::for_stderr();
    let mut session = Session::open(settings(dir.to_owned()), &progress).expect("shared memory is there");
    let plant = ModelFile::plain(Parameters::example());
    let mut devices = Devices::Emulated { plant: Box::new(plant) };
    let known = Known::at_first(Knowledge::Nothing, bench::controller::Settings::default());
    let outcome = session.run_all(&[script("run_0", 0.5)], &[false], &mut devices, known, switches, &progress);
    session.finish().expect("the publication ends");
    outcome
}

#[test]
fn a_stop_or_an_emergency_stop_between_runs_keeps_the_next_one_from_being_prepared() {
    for (emergency, kind) in [(true, Kind::Safety), (false, Kind::Interrupted)] {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let switches = Switches::new();
        if emergency { &switches.emergency_stop } else { &switches.stop }.store(true, Ordering::Relaxed);
        let failure = run_all(dir.path(), &switches).expect_err("nothing is begun");
        assert_eq!(failure.kind, kind, "{failure}");
        assert!(failure.message.contains("run_0") && failure.message.contains("the same command"), "{failure}");
        assert_eq!(std::fs::read_dir(dir.path()).expect("there").count(), 0, "no recording was begun");
    }
}

#[test]
fn a_whole_recording_stays_where_it_is_though_the_campaign_s_file_can_t_be_written() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    // A folder that is not empty is replaced by no file.
    std::fs::create_dir_all(dir.path().join("campaign.toml/in_the_way")).expect("a folder");
    let failure = run_all(dir.path(), &Switches::new()).expect_err("campaign.toml can't be written");
    assert_eq!(failure.kind, Kind::Input, "{failure}");
    assert!(failure.message.contains("campaign.toml"), "{failure}");
    let reader = recordings::McapReader::open(&dir.path().join("run_0.mcap")).expect("the recording is there");
    assert!(reader.certificate().is_none_or(rt_core::LossCertificate::is_lossless));
    assert!(!dir.path().join("set_aside").exists());
}

#[test]
fn a_campaign_is_never_overwritten() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    record(dir.path(), vec![Echo::default()]).remove(0).expect("nothing fails");
    let before = std::fs::read(dir.path().join("run_0.mcap")).expect("written");
    let failure =
        Session::create(settings(dir.path().to_owned()), &Progress::for_stderr()).err().expect("the folder is taken");
    assert_eq!(failure.kind, Kind::Input);
    assert!(failure.message.contains("never overwritten"), "{failure}");
    assert_eq!(std::fs::read(dir.path().join("run_0.mcap")).expect("still there"), before);
}
