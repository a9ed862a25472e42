//! `bench foxglove` beside a real run, seen by a plain WebSocket client in Python that decodes by the schema that it is sent.
//!
//! ```text
//! REC_BENCH_PEERS=required cargo test --release -p bench --test foxglove    # fails where Python can't be had
//! ```
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../../drivers/tests/peers/mod.rs"]
mod peers;

use recordings::{Item, McapReader};
use rt_core::{PERIOD_NS, Sample, flags};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

const PACKAGES: [&str; 2] = ["websockets==15.0.1", "protobuf==7.36.2"];

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

impl Running {
    fn start(command: &mut Command) -> (Running, BufReader<std::process::ChildStdout>) {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        (Running(child), stdout)
    }
}

fn line(from: &mut impl BufRead) -> String {
    let mut line = String::new();
    assert!(from.read_line(&mut line).unwrap() > 0, "it ended by itself");
    line
}

fn samples(path: &Path) -> Vec<Sample> {
    let items = McapReader::open(path).unwrap();
    items.filter_map(|item| if let Item::Sample(sample) = item.unwrap() { Some(sample) } else { None }).collect()
}

fn double(value: f64) -> Value {
    json!(format!("{:016x}", if value.is_nan() { f64::NAN } else { value }.to_bits()))
}

/// Fields as the schema has them.
fn expected(s: &Sample) -> Vec<(&'static str, Value)> {
    vec![
        ("version", json!(s.version)),
        ("run", json!(s.run)),
        ("tick", json!(s.tick)),
        ("scheduled_ns", json!(s.scheduled_ns)),
        ("woken_ns", json!(s.woken_ns)),
        ("lateness_ns", json!(s.lateness_ns)),
        ("skipped", json!(s.skipped)),
        ("voltage_v", double(s.voltage_v)),
        ("angle_deg", double(s.angle_deg)),
        ("pressure1_bar", double(s.pressure1_bar)),
        ("pressure2_bar", double(s.pressure2_bar)),
        ("torque_nm", double(s.torque_nm)),
        ("volume_ml", double(s.volume_ml)),
        ("target", double(s.target)),
        ("target_of", json!(s.target_of)),
        ("age_ns", json!(s.age_ns)),
        ("segment", json!(s.segment)),
        ("step", json!(s.step)),
        ("quality", json!(s.quality)),
        ("trip", json!(s.trip)),
        ("brake_open", json!(s.brake_open())),
        ("bypass_open", json!(s.bypass_open())),
        ("overrun", json!(s.overrun())),
        ("slew_limited", json!(s.flags & flags::SLEW_LIMITED != 0)),
        ("last", json!(s.last())),
    ]
}

#[test]
fn a_client_gets_every_sample_with_the_schema_and_the_values_of_the_recording() {
    let Some(python) = peers::python(&PACKAGES) else { return };
    let dir = tempfile::tempdir().unwrap();
    let instance = format!("test-foxglove-{}", std::process::id());
    let (bridge, mut told) =
        Running::start(&mut bench(&["foxglove", "--instance", &instance, "--listen", "127.0.0.1:0"]));
    let said = line(&mut told);
    let address =
        said.split_whitespace().find(|word| word.starts_with("ws://")).unwrap().trim_end_matches(':').to_owned();

    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foxglove/client.py");
    let (mut client, mut seen) = Running::start(Command::new(python).arg(script).arg(&address));
    let info: Value = serde_json::from_str(&line(&mut seen)).unwrap();
    assert_eq!((&info["name"], &info["capabilities"]), (&json!(format!("rec-bench {instance}")), &json!([])));
    let channel: Value = serde_json::from_str(&line(&mut seen)).unwrap();
    let (encoding, schema) = ("protobuf", "rec_bench.v1.RigSample");
    assert_eq!(
        channel,
        json!({ "topic": "/rig/sample", "encoding": encoding, "schemaName": schema, "schemaEncoding": encoding })
    );
    // Read while the run goes on, or the pipe fills up.
    let reader = std::thread::spawn(move || seen.lines().map(Result::unwrap).collect::<Vec<String>>());

    let (profile, recording) = (dir.path().join("p.toml"), dir.path().join("p.mcap"));
    let text = "name = \"p\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
         [[step]]\nrepeat = 4\n[[step.step]]\nvoltage_v = 7.5\nfor_s = 0.5\n[[step.step]]\nvoltage_v = -7.5\nfor_s = 0.5\n";
    std::fs::write(&profile, text).unwrap();
    let (out, profile) = (recording.display().to_string(), profile.display().to_string());
    let run = bench(&["run", &profile, "--realtime", "--instance", &instance, "--out", &out]).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));

    let mut lines: Vec<Value> = reader.join().unwrap().iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(client.0.wait().unwrap().success());
    let statuses = lines.pop().unwrap();
    let texts: Vec<&str> = statuses.as_array().unwrap().iter().map(|s| s["message"].as_str().unwrap()).collect();
    assert!(texts.contains(&"run 0: p, square-wave, validate, horizontal"), "{texts:?}");
    assert!(texts.contains(&"run 0 ended: completed"), "{texts:?}");

    let recorded = samples(&recording);
    assert_eq!(lines.len(), recorded.len(), "8 s of samples find room even where the client stalls");
    let begin_ns = lines[0]["log_time"].as_u64().unwrap();
    for (line, sample) in lines.iter().zip(&recorded) {
        for (name, value) in expected(sample) {
            assert_eq!(line["fields"][name], value, "{name} of tick {}", sample.tick);
        }
        assert_eq!(line["log_time"], begin_ns + sample.scheduled_ns - recorded[0].scheduled_ns);
    }
    assert!(begin_ns > 1_700_000_000_000_000_000 && recorded.last().unwrap().scheduled_ns > 3_000 * PERIOD_NS);

    // Asked to end it does, without complaint.
    let mut bridge = bridge;
    let id = i32::try_from(bridge.0.id()).unwrap();
    // SAFETY: touches no memory; the child is ours and was not waited for.
    assert_eq!(unsafe { libc::kill(id, libc::SIGTERM) }, 0);
    assert_eq!(bridge.0.wait().unwrap().code(), Some(0));
}

#[test]
fn a_port_in_use_and_what_is_no_address_are_refused() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let instance = format!("test-foxglove-port-{}", std::process::id());
    for (listen, says) in [(format!("127.0.0.1:{port}"), "choose another port"), ("8765".to_owned(), "--listen")] {
        let output = bench(&["foxglove", "--instance", &instance, "--listen", &listen]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(says), "{said}");
    }
}
