//! What is written as CSV reads back as the same bits, and nothing is written that the reader would refuse.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::{assert_says, bits};
use proptest::prelude::*;
use recordings::{CsvRows, CsvWriter, Protocol, Recording};

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

/// A run of many blocks, with values that differ in every row.
fn long(rows: usize) -> Recording {
    let number = |row: usize| row as f64;
    Recording {
        time_s: (0..rows).map(|row| number(row) * 1e-3).collect(),
        voltage_v: (0..rows).map(|row| (number(row) * 0.7).sin() * 24.0).collect(),
        angle_deg: (0..rows)
            .map(|row| if row % 7 == 3 { f64::NAN } else { (number(row) * 0.1).cos() * 40.0 })
            .collect(),
        pressure1_bar: (0..rows).map(|row| 2.8 + number(row % 11) * 0.013).collect(),
        pressure2_bar: (0..rows).map(|row| 2.8 - number(row % 13) * 0.017).collect(),
        torque_nm: vec![f64::NAN; rows],
        volume_ml: (0..rows).map(|row| if row + 1 == rows { 3.5 } else { f64::NAN }).collect(),
        brake_open: (0..rows).map(|row| row % 5 == 0).collect(),
        bypass_open: (0..rows).map(|row| row % 3 == 0).collect(),
        segment: (0..rows).map(|row| row as i64 / 1000 - 1).collect(),
    }
}

#[test]
fn blocks_are_the_run_in_pieces_written_and_read() {
    let whole = long(9_001);
    let dir = tempfile::tempdir().unwrap();
    for name in ["run.csv", "run.csv.gz"] {
        let path = dir.path().join(name);
        whole.write_csv(&path).unwrap();
        // The one value of the volume stands in the last row: only the file as a whole can tell that it is there.
        let blocks: Vec<Recording> =
            CsvRows::open(&path, Protocol::ClampSteps).unwrap().collect::<Result<_, _>>().unwrap();
        assert!(blocks.len() > 2 && blocks.iter().all(|block| !block.is_empty()));
        let mut writer = CsvWriter::new(Vec::new(), &path).unwrap();
        blocks.iter().for_each(|block| writer.write(block).unwrap());
        let text = writer.into_inner();
        let again = dir.path().join("again.csv");
        std::fs::write(&again, &text).unwrap();
        assert_eq!(bits(&Recording::read(&again, Protocol::ClampSteps).unwrap()), bits(&whole));
        if name == "run.csv" {
            assert!(text == std::fs::read(&path).unwrap(), "the same bytes as in one piece");
        }
    }
}

#[test]
fn what_is_wrong_in_a_later_block_is_found_there() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.csv");
    let mut run = long(9_001);
    run.volume_ml[9_000] = f64::NAN;
    run.write_csv(&path).unwrap();
    let last = CsvRows::open(&path, Protocol::ClampSteps).unwrap().last().unwrap();
    assert_says(last, &["run.csv", "volume_ml", "no value in any of 9001 rows"]);
    // From one block to the next, too, time must increase.
    let first = run.clone();
    let mut writer = CsvWriter::new(Vec::new(), &path).unwrap();
    writer.write(&first).unwrap();
    assert_says(writer.write(&first), &["run.csv", "line 9003", "time_s", "a time after 9 s"]);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text + "8.5,0,1,1,1,,,0,0,1\n").unwrap();
    let last = CsvRows::open(&path, Protocol::SquareWave).unwrap().last().unwrap();
    assert_says(last, &["run.csv", "line 9003", "time_s", "a time after the row before (9 s)"]);
}
