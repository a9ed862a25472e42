//! `bench recover` as a person uses it. That every complete chunk comes back and nothing else is tested with the format, for
//! hundreds of places of damage.

use recordings::{McapReader, McapWriter, Plane, Protocol, Role, RunMetadata};
use rt_core::{PERIOD_NS, Sample, flags};
use std::fs;
use std::path::Path;
use std::process::Command;

fn write(path: &Path, samples: u64) {
    let metadata = RunMetadata {
        profile: "name = \"square_h\"".into(),
        ..RunMetadata::new("square_h", Protocol::SquareWave, Role::Identify, Plane::Vertical)
    };
    let mut writer = McapWriter::create(path, &metadata).expect("a new file");
    for tick in 0..samples {
        let flags = if tick + 1 == samples { flags::LAST } else { 0 };
        let angle_deg = (tick as f64 * 0.01).sin();
        let sample = Sample { tick, scheduled_ns: tick * PERIOD_NS, angle_deg, flags, ..Sample::BLANK };
        writer.write(&sample).expect("sound");
    }
    let certificate = writer.certificate(samples);
    writer.finish(&certificate).expect("closed");
}

/// Exit code, stdout and stderr of `bench recover`.
fn recover(arguments: &[&Path]) -> (Option<i32>, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    let output = command.arg("recover").args(arguments).env_remove("RUST_LOG").output().expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn a_truncated_recording_comes_back_under_its_name() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let whole = dir.path().join("whole.mcap");
    write(&whole, 6_000);
    let bytes = fs::read(&whole).expect("there");
    let part = dir.path().join("a.mcap.part");
    fs::write(&part, &bytes[..bytes.len() * 2 / 3]).expect("writable");
    let (code, stdout, stderr) = recover(&[&part]);
    assert_eq!(code, Some(0), "{stderr}");
    let target = dir.path().join("a.mcap");
    let mut reader = McapReader::open(&target).expect("a recording");
    let count = reader.by_ref().filter(Result::is_ok).count();
    assert!(count > 3_000 && count < 6_000, "{count}");
    assert_eq!((reader.run().name.as_str(), reader.run().profile.as_str()), ("square_h", "name = \"square_h\""));
    let certificate = reader.certificate().expect("it was closed");
    assert!(!certificate.end_seen && certificate.gaps.is_empty());
    assert!(
        stdout.contains(&format!("{count} samples, from 0.000 s to {:.3} s", (count - 1) as f64 * 1e-3)),
        "{stdout}"
    );
    assert!(stdout.contains("damage begins at byte") && stdout.contains(&certificate.to_string()), "{stdout}");
    assert!(stdout.contains(&target.display().to_string()), "{stdout}");

    let (code, _, stderr) = recover(&[&part]);
    assert!(code == Some(2) && stderr.contains("exists"), "a recording is never overwritten: {stderr}");
    let other = dir.path().join("other.mcap");
    let (code, ..) = recover(&[&part, Path::new("--out"), &other]);
    assert!(code == Some(0) && fs::read(&other).expect("there") == fs::read(&target).expect("there"));
}

#[test]
fn a_sound_recording_is_left_alone() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let whole = dir.path().join("whole.mcap");
    write(&whole, 700);
    let (code, stdout, stderr) = recover(&[&whole]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stdout.contains("sound, 700 of 700 samples; nothing to recover"), "{stdout}");
    assert_eq!(fs::read_dir(dir.path()).expect("there").count(), 1);
}

#[test]
fn a_damaged_recording_keeps_its_file_beside_the_new_one() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("b.mcap");
    write(&file, 4_000);
    let mut bytes = fs::read(&file).expect("there");
    let at = bytes.len() / 2;
    bytes[at] ^= 0x55;
    fs::write(&file, &bytes).expect("writable");
    let (code, stdout, stderr) = recover(&[&file]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stdout.contains("hold nothing sound") && stdout.contains("missing samples"), "{stdout}");
    assert!(dir.path().join("b-recovered.mcap").exists() && fs::read(&file).expect("there") == bytes);
}

#[test]
fn words_that_are_lost_are_asked_for_and_what_is_no_recording_is_refused() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let file = dir.path().join("c.mcap");
    write(&file, 1_000);
    let mut bytes = fs::read(&file).expect("there");
    let at = bytes.windows(8).position(|window| window == b"square_h").expect("the name");
    bytes[at] = b'S';
    fs::write(&file, &bytes).expect("writable");
    let option = |text: &'static str| Path::new(text);
    let (code, _, stderr) =
        recover(&[&file, option("--protocol"), option("pump-map"), option("--role"), option("identify")]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stderr.contains("is lost"), "{stderr}");
    let reader = McapReader::open(&dir.path().join("c-recovered.mcap")).expect("a recording");
    assert_eq!((reader.run().protocol, reader.run().role), (Protocol::PumpMap, Role::Identify));

    let text = dir.path().join("d.mcap.part");
    fs::write(&text, "time_s,voltage_v\n").expect("writable");
    let (code, stdout, stderr) = recover(&[&text]);
    assert!(code == Some(2) && stdout.is_empty() && stderr.contains("is it the right file?"), "{stderr}");
    let (code, _, stderr) = recover(&[&dir.path().join("none.mcap.part")]);
    assert!(code == Some(2) && stderr.contains("No such file"), "{stderr}");
}
