//! The Python client beside a real run: it gets every sample, and every field as the recording has it.
//!
//! ```text
//! REC_BENCH_PEERS=required cargo test --release -p bench --test python_client    # fails where Python can't be had
//! ```
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../../drivers/tests/peers/mod.rs"]
mod peers;

use recordings::{Item, McapReader};
use rt_core::{Channel, Input, Sample, TargetKind};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read};
use std::mem::{align_of, offset_of, size_of, size_of_val};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

const PACKAGES: [&str; 2] = ["iceoryx2==0.10.0", "setuptools==80.9.0"];
/// Of the run, s: more than the subscriber's buffer holds.
const LASTS_S: u32 = 12;

/// A field as the client prints it: a double by its bits, one NaN for all.
trait Said {
    fn said(&self) -> Value;
}

impl Said for u32 {
    fn said(&self) -> Value {
        json!(self)
    }
}

impl Said for u64 {
    fn said(&self) -> Value {
        json!(self)
    }
}

impl Said for [u32; 5] {
    fn said(&self) -> Value {
        json!(self)
    }
}

impl Said for f64 {
    fn said(&self) -> Value {
        let bits = if self.is_nan() { f64::NAN } else { *self }.to_bits();
        json!(format!("{bits:016x}"))
    }
}

/// Every field of a sample: name, offset, size, value. A field that is missing here does not compile.
macro_rules! fields_of {
    ($sample:expr, $($name:ident),* $(,)?) => {{
        let Sample { $($name),* } = $sample;
        vec![$((stringify!($name), offset_of!(Sample, $name), size_of_val(&$name), $name.said())),*]
    }};
}

#[rustfmt::skip]
fn fields(sample: Sample) -> Vec<(&'static str, usize, usize, Value)> {
    fields_of!(
        sample, version, run, tick, scheduled_ns, woken_ns, lateness_ns, skipped, voltage_v, angle_deg, pressure1_bar, pressure2_bar,
        torque_nm, volume_ml, age_ns, heartbeat_age_ns, behind_ns, read_ns, check_ns, reference_ns, control_ns, write_ns, publish_ns,
        segment, step, flags, quality, trip, target, target_of, reserved,
    )
}

/// An interpreter, and a folder with the client as pip installs it.
struct Client {
    python: PathBuf,
    dir: tempfile::TempDir,
}

impl Client {
    fn install() -> Option<Client> {
        let python = peers::python(&PACKAGES)?;
        let dir = tempfile::tempdir().unwrap();
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("clients/python");
        // From a copy: a build leaves its folders beside what it builds.
        let copy = dir.path().join("source");
        let copied = Command::new("cp").arg("-r").arg(&source).arg(&copy).status().unwrap();
        assert!(copied.success());
        let output = Command::new(&python)
            .args([
                "-m",
                "pip",
                "install",
                "--quiet",
                "--disable-pip-version-check",
                "--no-build-isolation",
                "--no-deps",
                "--target",
            ])
            .arg(dir.path().join("site"))
            .arg(&copy)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Some(Client { python, dir })
    }

    fn command(&self) -> Command {
        let mut command = Command::new(&self.python);
        command
            .env("PYTHONPATH", self.dir.path().join("site"))
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .stdin(Stdio::null());
        command
    }

    fn example(&self, name: &str) -> Command {
        let mut command = self.command();
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("clients/python/examples").join(name));
        command
    }
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
    let items = McapReader::open(path).unwrap();
    items.filter_map(|item| if let Item::Sample(sample) = item.unwrap() { Some(sample) } else { None }).collect()
}

/// A run in real time on the emulated rig, as long as it lasts; the path of its recording.
fn run(dir: &Path, instance: &str) -> PathBuf {
    let (profile, recording) = (dir.join("p.toml"), dir.join("p.mcap"));
    let text = format!(
        "name = \"p\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nrepeat = {LASTS_S}\n[[step.step]]\nvoltage_v = 7.5\nfor_s = 0.5\n[[step.step]]\nvoltage_v = -7.5\nfor_s = 0.5\n"
    );
    std::fs::write(&profile, text).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_bench"))
        .args(["run", "--realtime", "--instance", instance, "--out"])
        .args([&recording, &profile])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    recording
}

#[test]
fn the_layout_in_python_is_that_of_the_service() {
    let Some(client) = Client::install() else { return };
    let output = client.command().args(["-m", "rec_bench", "layout"]).output().unwrap();
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&told["size"], &told["alignment"]), (&json!(size_of::<Sample>()), &json!(align_of::<Sample>())));
    // The service's name for it; a test of rt-core holds it. Under another one the run below would not be heard.
    assert_eq!(told["type_name"], "RecBenchSample");
    assert_eq!(told["version"], rt_core::SAMPLE_VERSION);
    let ours: serde_json::Map<String, Value> = fields(Sample::BLANK)
        .into_iter()
        .map(|(name, offset, size, _)| (name.to_owned(), json!({ "offset": offset, "size": size })))
        .collect();
    assert_eq!(told["fields"], Value::Object(ours));
    let flags: serde_json::Map<String, Value> =
        bench::monitor::snapshot::FLAGS.iter().map(|(bit, name)| ((*name).to_owned(), json!(bit))).collect();
    assert_eq!(told["flags"], Value::Object(flags));
    assert_eq!(told["inputs"], json!(Input::ALL.map(Input::column)));
    assert_eq!(told["targets"], json!(TargetKind::LIST.map(|(kind, name, unit)| json!([kind.code(), name, unit]))));
    assert_eq!(told["trip_channels"], json!(Channel::ALL.map(|channel| json!([channel as u32, channel.name()]))));
}

#[test]
fn the_documented_layout_is_that_of_the_service() {
    let document = include_str!("../../docs/CLIENTS.md");
    let (_, table) = document.split_once("\n## The sample\n").unwrap();
    let mut end = 0;
    for (name, offset, size, value) in fields(Sample::BLANK) {
        let kind = match (size, value) {
            (20, _) => "u32 x 5",
            (4, _) => "u32",
            (8, Value::Number(_)) => "u64",
            _ => "f64",
        };
        let row = format!("\n| {offset} | {kind} | `{name}` |");
        assert_eq!(table.matches(&row).count(), 1, "docs/CLIENTS.md lacks: {row}");
        end = offset + size;
    }
    assert_eq!(end, size_of::<Sample>());
    assert!(table.contains(&format!(
        "version {}, {end} bytes, alignment {}",
        rt_core::SAMPLE_VERSION,
        align_of::<Sample>()
    )));
    for (kind, name, unit) in TargetKind::LIST {
        assert!(table.contains(&format!("{} {name}, {unit}", kind.code())), "{name}");
    }
}

#[test]
fn it_gets_every_sample_of_a_run_without_a_gap_and_every_field_as_recorded() {
    let Some(client) = Client::install() else { return };
    let dir = tempfile::tempdir().unwrap();
    let instance = format!("test-python-client-{}", std::process::id());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python_client/follow.py");
    let mut follows = Running(
        client.command().arg(script).arg(&instance).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap(),
    );
    let mut told = BufReader::new(follows.0.stdout.take().unwrap());
    let mut line = String::new();
    told.read_line(&mut line).unwrap();
    if line.trim() != "ready" {
        let mut why = String::new();
        follows.0.stderr.take().unwrap().read_to_string(&mut why).unwrap();
        panic!("{line}{why}");
    }
    // The examples beside it, as a person starts them.
    let csv = dir.path().join("run.csv");
    let examples = [
        client
            .example("print_values.py")
            .args(["--instance", &instance, "--timeout-s", "120"])
            .stdout(Stdio::piped())
            .spawn(),
        client.example("to_csv.py").args(["--instance", &instance, "--timeout-s", "120", "--out"]).arg(&csv).spawn(),
    ];
    // Read while the run goes on, or the pipe fills up.
    let reader = std::thread::spawn(move || told.lines().map(Result::unwrap).collect::<Vec<String>>());
    let recording = run(dir.path(), &instance);
    let mut lines: Vec<Value> = reader.join().unwrap().iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    let end = lines.pop().unwrap();

    let recorded = samples(&recording);
    assert!(recorded.len() as u64 + recorded.last().unwrap().skipped >= u64::from(LASTS_S) * 1000);
    let count = recorded.len();
    assert_eq!((&end["gaps"], &end["joined_at"], &end["received"]), (&json!([]), &json!(0), &json!(count)));
    assert_eq!(end["certificate"], format!("{count} of {count} samples"));
    assert_eq!(lines.len(), count);
    let names: Vec<&str> = fields(Sample::BLANK).iter().map(|(name, ..)| *name).collect();
    assert_eq!(end["fields"], json!(names));
    for (line, sample) in lines.iter().zip(&recorded) {
        for (name, _, _, value) in fields(*sample) {
            assert_eq!(line[name], value, "{name} of tick {}", sample.tick);
        }
    }
    assert!(recorded.iter().any(|s| s.woken_ns > 0 && s.target_of == TargetKind::Voltage.code()));

    for example in examples {
        let output = example.unwrap().wait_with_output().unwrap();
        // They may have come after the first samples; then they say so.
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            text.is_empty() || (text.contains("asked for 7.500 V (voltage)") && text.contains(" samples")),
            "{text}"
        );
    }
    let csv = std::fs::read_to_string(csv).unwrap();
    let last: Vec<&str> = csv.lines().last().unwrap().split(',').collect();
    let sample = recorded.last().unwrap();
    assert_eq!(last[1].parse(), Ok(sample.voltage_v));
    assert_eq!(last[2].parse(), Ok(sample.angle_deg));
}

#[test]
fn silence_and_a_bad_instance_are_errors_that_say_what_to_do() {
    let Some(client) = Client::install() else { return };
    let instance = format!("test-python-silence-{}", std::process::id());
    let fails = |instance: &str| {
        let output =
            client.example("print_values.py").args(["--instance", instance, "--timeout-s", "0.2"]).output().unwrap();
        assert!(!output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let said = fails(&instance);
    assert!(said.contains("Silence") && said.contains("no sample for 0.2 s; does it run?"), "{said}");
    let said = fails(&"x".repeat(300));
    assert!(said.contains("LinkError") && said.contains("can't subscribe"), "{said}");
}

/// Whoever asks for more than the service has is refused, whoever comes first makes it: both have the same numbers.
#[test]
fn the_client_asks_for_what_the_service_has() {
    let service = include_str!("../../rt-core/src/link.rs");
    let client = include_str!("../clients/python/rec_bench/subscriber.py");
    let number = |text: &str, name: &str| {
        let lines = text.lines().map(|line| line.trim_start_matches("pub ").trim_start_matches("const "));
        let value =
            lines.filter_map(|line| line.strip_prefix(name)?.split_once("= ")).map(|(_, value)| value.to_owned());
        value.map(|value| value.trim_end_matches(';').to_owned()).next().unwrap()
    };
    for name in ["BUFFER_SAMPLES", "MAX_SUBSCRIBERS", "MAX_PUBLISHERS", "MAX_NODES"] {
        assert_eq!(number(client, name), number(service, name), "{name}");
    }
}
