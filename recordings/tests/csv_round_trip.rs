//! What is written as CSV reads back as the same bits, and nothing is written that the reader would refuse.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::{assert_says, bits};
use proptest::prelude::*;
use recordings::{Protocol, Recording};

/// Any finite number, with the awkward ones over-represented.
fn finite() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>().prop_filter("finite", |value| value.is_finite()),
        Just(0.0),
        Just(-0.0),
        Just(f64::MIN_POSITIVE / 4.0),
        Just(f64::MAX),
        Just(0.1 + 0.2),
        -100.0..100.0f64,
    ]
}

fn measured() -> impl Strategy<Value = f64> {
    prop_oneof![3 => finite(), 1 => Just(f64::NAN)]
}

type Row = (f64, f64, [f64; 5], bool, bool, i64);

fn rows() -> impl Strategy<Value = Vec<Row>> {
    let values = [measured(), measured(), measured(), measured(), measured()];
    proptest::collection::vec((1e-9..1.0f64, finite(), values, any::<bool>(), any::<bool>(), any::<i64>()), 1..40)
}

fn recording(rows: &[Row]) -> Recording {
    let mut recording = Recording::default();
    let mut time_s = 0.0;
    for &(step, voltage, values, brake, bypass, segment) in rows {
        recording.time_s.push(time_s);
        time_s += step;
        recording.voltage_v.push(voltage);
        recording.angle_deg.push(values[0]);
        recording.pressure1_bar.push(values[1]);
        recording.pressure2_bar.push(values[2]);
        recording.torque_nm.push(values[3]);
        recording.volume_ml.push(values[4]);
        recording.brake_open.push(brake);
        recording.bypass_open.push(bypass);
        recording.segment.push(segment);
    }
    // One value in each column, so that no protocol finds a column void.
    recording.angle_deg[0] = 1.0;
    recording.pressure1_bar[0] = 1.0;
    recording.pressure2_bar[0] = 1.0;
    recording
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn csv_and_gzip_give_the_same_bits_back(rows in rows()) {
        let written = recording(&rows);
        let dir = tempfile::tempdir().unwrap();
        for name in ["run.csv", "run.csv.gz"] {
            let path = dir.path().join(name);
            written.write_csv(&path).unwrap();
            let read = Recording::read(&path, Protocol::SquareWave).unwrap();
            prop_assert_eq!(bits(&read), bits(&written));
        }
    }
}

fn small() -> Recording {
    recording(&[(0.001, 1.0, [1.0; 5], true, false, 0), (0.001, 2.0, [2.0; 5], true, false, 0)])
}

#[test]
fn the_same_recording_gives_the_same_bytes_and_no_part_is_left() {
    let dir = tempfile::tempdir().unwrap();
    let (first, second) = (dir.path().join("a.csv.gz"), dir.path().join("b.csv.gz"));
    small().write_csv(&first).unwrap();
    small().write_csv(&second).unwrap();
    small().write_csv(&second).unwrap();
    assert_eq!(std::fs::read(first).unwrap(), std::fs::read(second).unwrap());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
}

#[test]
fn nothing_is_written_that_could_not_be_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.csv");
    let spoilt = |spoil: fn(&mut Recording)| {
        let mut recording = small();
        spoil(&mut recording);
        recording
    };
    let cases: [(Recording, &[&str]); 5] = [
        (spoilt(|r| r.time_s[1] = 0.0), &["line 3", "time_s", "a time after 0 s"]),
        (spoilt(|r| r.voltage_v[1] = f64::NAN), &["line 3", "voltage_v", "NaN"]),
        (spoilt(|r| r.angle_deg[0] = f64::INFINITY), &["line 2", "angle_deg", "inf"]),
        (spoilt(|r| r.torque_nm.push(1.0)), &["torque_nm", "2 values", "got 3"]),
        (spoilt(|r| r.segment.truncate(1)), &["segment", "2 values", "got 1"]),
    ];
    for (recording, parts) in cases {
        assert_says(recording.write_csv(&path), parts);
    }
    assert_says(small().write_csv(&dir.path().join("run.mcap")), &["run.mcap", ".csv"]);
    assert_says(small().write_csv(&dir.path().join("no/such/run.csv")), &["no/such/run.csv", "check the folder"]);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "a refused recording leaves no file");
}
