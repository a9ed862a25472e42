//! A recording read by programs that nobody here wrote: Python's `mcap` and `mcap-protobuf-support` give every field of every message as
//! it was written.

#![allow(clippy::unwrap_used, reason = "a test")]

mod common;
#[path = "../../drivers/tests/peers/mod.rs"]
mod peers;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use common::golden;
use recordings::{AmplifierReport, Event, Item, Severity};
use rt_core::{Sample, flags};
use serde_json::{Map, Value, json};

const PACKAGES: [&str; 3] = ["mcap==1.6.0", "mcap-protobuf-support==0.6.0", "protobuf==7.36.2"];

/// Several chunks.
const SAMPLES: u64 = 3_000;

#[test]
fn python_reads_every_field_of_every_message_as_it_was_written() {
    let Some(python) = peers::python(&PACKAGES) else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.mcap");
    golden::write(&path, SAMPLES);
    let mut others = golden::written().into_iter().peekable();
    let mut written = Vec::new();
    for sample in golden::samples_3(SAMPLES) {
        let due = |tick: u64| tick <= sample.tick;
        while let Some(item) = others.next_if(|item| match item {
            Item::Event(event) => due(event.tick),
            Item::Amplifier(report) => due(report.tick),
            Item::Sample(_) => false,
        }) {
            written.push(match item {
                Item::Event(event) => message("/events", "Event", event.tick, event.scheduled_ns, event_fields(&event)),
                Item::Amplifier(report) => {
                    let fields = amplifier_fields(&report);
                    message("/amplifier", "AmplifierReport", report.tick, report.arrived_ns, fields)
                }
                Item::Sample(_) => continue,
            });
        }
        let fields = sample_fields(&sample);
        written.push(message("/rig/sample", "RigSample", sample.tick, sample.scheduled_ns, fields));
    }

    let lines = read_back(&python, &path);
    let of = |way: &str| lines.iter().filter(|line| line["way"] == way).collect::<Vec<_>>();
    assert_eq!(*of("header")[0], json!({ "way": "header", "profile": "rec-bench", "library": "rec-bench" }));
    check_metadata(&of("metadata"));
    let counts = json!({ "1": SAMPLES, "2": golden::events().len(), "3": golden::amplifier().len() });
    assert_eq!(*of("summary")[0], json!({ "way": "summary", "counts": counts, "packing": ["zstd"] }));

    // As they stand in the file.
    let stream = of("stream");
    assert_eq!(stream.len(), written.len());
    for (read, written) in stream.iter().zip(&written) {
        assert_same(read, written);
    }
    // By the index: in the order of their times.
    let index = of("index");
    assert_eq!(index.len(), written.len());
    let mut sorted = written;
    sorted.sort_by_key(|message| message["log_time"].as_u64());
    for (read, written) in index.iter().zip(&sorted) {
        assert_same(read, written);
    }
}

fn read_back(python: &Path, recording: &Path) -> Vec<Value> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/read_back.py");
    let output = Command::new(python).arg(script).arg(recording).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn assert_same(read: &Value, written: &Value) {
    let (mut read, mut written) = (read.as_object().unwrap().clone(), written.as_object().unwrap().clone());
    read.remove("way");
    assert_eq!(read.keys().collect::<Vec<_>>(), written.keys().collect::<Vec<_>>());
    let take = |map: &mut Map<String, Value>| map.remove("fields").unwrap().as_object().unwrap().clone();
    let (read_fields, written_fields) = (take(&mut read), take(&mut written));
    assert_eq!(read, written);
    let names = |fields: &Map<String, Value>| fields.keys().cloned().collect::<std::collections::BTreeSet<_>>();
    assert_eq!(names(&read_fields), names(&written_fields), "{written:?}");
    for (name, value) in &written_fields {
        assert_eq!(read_fields[name], *value, "{name} of {written:?}");
    }
}

fn message(topic: &str, schema: &str, tick: u64, time_ns: u64, fields: Value) -> Value {
    json!({
        "topic": topic,
        "encoding": "protobuf",
        "schema": format!("rec_bench.v1.{schema}"),
        "sequence": tick as u32,
        "log_time": time_ns,
        "publish_time": time_ns,
        "fields": fields,
    })
}

fn double(value: f64) -> Value {
    let bits = if value.is_nan() { f64::NAN } else { value }.to_bits();
    Value::String(format!("{bits:016x}"))
}

fn sample_fields(sample: &Sample) -> Value {
    let set = |bit: u32| sample.flags & bit != 0;
    let mut fields = json!({
        "version": sample.version,
        "run": sample.run,
        "tick": sample.tick,
        "scheduled_ns": sample.scheduled_ns,
        "lateness_ns": sample.lateness_ns,
        "input_age_ns": 0,
        "segment": sample.segment,
        "voltage_v": double(sample.voltage_v),
        "angle_deg": double(sample.angle_deg),
        "pressure1_bar": double(sample.pressure1_bar),
        "pressure2_bar": double(sample.pressure2_bar),
        "torque_nm": double(sample.torque_nm),
        "volume_ml": double(sample.volume_ml),
        "brake_open": set(flags::BRAKE_OPEN),
        "bypass_open": set(flags::BYPASS_OPEN),
        "tripped": set(flags::TRIPPED),
        "last": set(flags::LAST),
        "fault": set(flags::FAULT),
        "other_flags": sample.flags >> 10 << 10,
        "woken_ns": sample.woken_ns,
        "skipped": sample.skipped,
        "age_ns": sample.age_ns,
        "heartbeat_age_ns": sample.heartbeat_age_ns,
        "behind_ns": sample.behind_ns,
        "read_ns": sample.read_ns,
        "check_ns": sample.check_ns,
        "reference_ns": sample.reference_ns,
        "control_ns": sample.control_ns,
        "write_ns": sample.write_ns,
        "publish_ns": sample.publish_ns,
        "step": sample.step,
        "quality": sample.quality,
        "trip": sample.trip,
        "overrun": set(flags::OVERRUN),
        "stopped": set(flags::STOPPED),
        "slew_limited": set(flags::SLEW_LIMITED),
        "waiting": set(flags::WAITING),
        "confirmed": set(flags::CONFIRMED),
        "target_of": sample.target_of,
    });
    // Where there is none the field is absent.
    if !sample.target.is_nan() {
        fields["target"] = double(sample.target);
    }
    fields
}

fn event_fields(event: &Event) -> Value {
    let severity = match event.severity {
        Severity::Info => 0,
        Severity::Warning => 1,
        Severity::Error => 2,
    };
    json!({
        "tick": event.tick,
        "scheduled_ns": event.scheduled_ns,
        "severity": severity,
        "source": event.source,
        "text": event.text,
    })
}

fn amplifier_fields(report: &AmplifierReport) -> Value {
    let mut fields = json!({ "tick": report.tick, "arrived_ns": report.arrived_ns, "fault_name": "" });
    let values = [
        ("supply_v", report.supply_v),
        ("motor_current_a", report.motor_current_a),
        ("speed_rpm", report.speed_rpm),
        ("duty", report.duty),
        ("temperature_c", report.temperature_c),
    ];
    for (name, value) in values {
        if !value.is_nan() {
            fields[name] = double(value);
        }
    }
    if let Some(fault) = &report.fault {
        fields["fault_code"] = json!(fault.code);
        fields["fault_name"] = json!(fault.name);
    }
    fields
}

fn check_metadata(records: &[&Value]) {
    let names: Vec<&str> = records.iter().map(|record| record["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["rec_bench.run", "rec_bench.loss"]);
    let run = golden::metadata();
    let mut expected = BTreeMap::from([
        ("format".to_owned(), "2".to_owned()),
        ("name".to_owned(), run.name),
        ("protocol".to_owned(), run.protocol.to_string()),
        ("role".to_owned(), run.role.to_string()),
        ("plane".to_owned(), run.plane.to_string()),
        ("profile".to_owned(), run.profile),
        ("calibration".to_owned(), run.calibration),
        ("program".to_owned(), run.program),
    ]);
    for (kind, texts) in [("file", run.files), ("host", run.host), ("note", run.notes)] {
        assert!(!texts.is_empty());
        expected.extend(texts.into_iter().map(|(name, text)| (format!("{kind}.{name}"), text)));
    }
    let mut said: BTreeMap<String, String> = serde_json::from_value(records[0]["fields"].clone()).unwrap();
    assert_eq!(said.remove("crc32").map(|sum| sum.len()), Some(8));
    assert_eq!(said, expected);
    assert_eq!(records[1]["fields"]["received"], SAMPLES.to_string());
}
