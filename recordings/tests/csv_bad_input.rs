//! Every way in which a CSV run can be wrong is an error that names file, line and column, and says what to do.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::io::Write;

use common::{assert_says, csv_text, csv_with};
use flate2::Compression;
use flate2::write::GzEncoder;
use recordings::{CampaignError, Protocol, Recording};

fn read(text: impl AsRef<[u8]>, protocol: Protocol) -> Result<Recording, CampaignError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.csv");
    fs::write(&path, text).unwrap();
    Recording::read(&path, protocol)
}

fn gz(text: &str) -> Vec<u8> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::default());
    packer.write_all(text.as_bytes()).unwrap();
    packer.finish().unwrap()
}

fn read_gz(bytes: &[u8]) -> Result<Recording, CampaignError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.csv.gz");
    fs::write(&path, bytes).unwrap();
    Recording::read(&path, Protocol::SquareWave)
}

const NAMES: [&str; 10] = [
    "time_s",
    "voltage_v",
    "angle_deg",
    "pressure1_bar",
    "pressure2_bar",
    "torque_nm",
    "volume_ml",
    "brake_open",
    "bypass_open",
    "segment",
];

#[test]
fn the_unspoilt_text_is_read() {
    let recording = read(csv_text(6), Protocol::ClampSteps).unwrap();
    assert_eq!(recording.len(), 6);
    assert_eq!(recording.time_s[5], 0.005);
    assert_eq!(recording.voltage_v[5], 12.5);
    assert_eq!(recording.angle_deg[5], -3.25);
    assert_eq!(recording.pressure1_bar[5], 2.5);
    assert_eq!(recording.pressure2_bar[5], 2.75);
    assert_eq!(recording.torque_nm[5], 1.5);
    assert_eq!(recording.volume_ml[5], 0.25);
    assert!(recording.brake_open[5] && !recording.bypass_open[5]);
    assert_eq!(recording.segment, [0, 0, 0, 0, 1, 1]);
}

#[test]
fn a_non_number_in_any_column_names_line_and_column() {
    for (column, name) in NAMES.iter().enumerate() {
        for field in ["abc", "1.5.2", "NaN", "inf", "-Infinity", "1e999", "0x10"] {
            let result = read(csv_with(9, 7, column, field), Protocol::SquareWave);
            let quoted = format!("{field:?}");
            assert_says(result, &["run.csv, line 7", name, "expected", "got", &quoted, ";"]);
        }
    }
}

#[test]
fn an_empty_field_is_missing_where_the_contract_allows_it_and_an_error_elsewhere() {
    for (column, name) in NAMES.iter().enumerate() {
        for blank in ["", "  "] {
            let result = read(csv_with(9, 7, column, blank), Protocol::TorqueMap);
            let measured = matches!(column, 2..=6);
            if measured {
                let recording = result.unwrap();
                let values = [
                    &recording.angle_deg,
                    &recording.pressure1_bar,
                    &recording.pressure2_bar,
                    &recording.torque_nm,
                    &recording.volume_ml,
                ][column - 2];
                assert!(values[5].is_nan(), "{name}");
                assert_eq!(values.iter().filter(|value| value.is_nan()).count(), 1, "{name}");
            } else {
                assert_says(result, &["line 7", name, "an empty field"]);
            }
        }
    }
}

#[test]
fn a_column_that_is_empty_throughout_is_an_error_where_the_protocol_measures_it() {
    let cases = [
        (2, Protocol::SquareWave, false),
        (2, Protocol::PumpMap, true),
        (3, Protocol::PumpMap, false),
        (4, Protocol::RandomSteps, false),
        (5, Protocol::TorqueMap, false),
        (5, Protocol::SquareWave, true),
        (6, Protocol::PumpMap, false),
        (6, Protocol::VolumeMap, false),
        (6, Protocol::ClampSteps, false),
        (6, Protocol::ConstantFlow, true),
    ];
    for (column, protocol, allowed) in cases {
        let text = csv_text(5);
        let emptied: String = text
            .lines()
            .enumerate()
            .map(|(line, fields)| {
                let mut fields: Vec<_> = fields.split(',').collect();
                if line > 0 {
                    fields[column] = "";
                }
                fields.join(",") + "\n"
            })
            .collect();
        let result = read(emptied, protocol);
        if allowed {
            assert_eq!(result.unwrap().len(), 5);
        } else {
            assert_says(result, &["run.csv", "line 2", NAMES[column], "5 rows", protocol.as_str()]);
        }
    }
}

#[test]
fn a_missing_column_names_itself_and_what_is_there() {
    for name in NAMES {
        let text = csv_text(3).replace(name, "other");
        assert_says(read(text, Protocol::SquareWave), &["run.csv, line 1", name, "other"]);
    }
}

#[test]
fn a_column_given_twice_is_an_error() {
    let text = csv_text(3).replace("segment", "angle_deg");
    assert_says(read(text, Protocol::SquareWave), &["line 1", "angle_deg", "fields 3 and 10"]);
}

#[test]
fn time_must_increase() {
    assert_says(
        read(csv_with(9, 7, 0, "0.001"), Protocol::SquareWave),
        &["line 7", "time_s", "0.004 s", "0.001 s", "sort"],
    );
    assert_says(read(csv_with(9, 7, 0, "0.004"), Protocol::SquareWave), &["line 7", "time_s"]);
}

#[test]
fn valves_are_0_or_1_and_segments_whole() {
    for field in ["2", "-1", "0.5", "true", "open"] {
        for column in [7, 8] {
            assert_says(read(csv_with(9, 4, column, field), Protocol::SquareWave), &["line 4", NAMES[column], field]);
        }
    }
    for field in ["1.5", "1e300", "one"] {
        assert_says(read(csv_with(9, 4, 9, field), Protocol::SquareWave), &["line 4", "segment", field]);
    }
    let spelled = read(csv_with(9, 4, 9, "-3.0").replace(",1,0,", ", 1.0,0e0,"), Protocol::SquareWave).unwrap();
    assert_eq!(spelled.segment[2], -3);
    assert!(spelled.brake_open.iter().all(|&open| open) && !spelled.bypass_open.iter().any(|&open| open));
}

#[test]
fn no_rows_no_header_no_file() {
    assert_says(read(csv_text(0), Protocol::SquareWave), &["run.csv, line 2", "at least one", "none"]);
    assert_says(read("", Protocol::SquareWave), &["run.csv, line 1", "header", "empty file"]);
    let missing = Recording::read(std::path::Path::new("/no/such/run.csv"), Protocol::SquareWave);
    assert_says(missing, &["/no/such/run.csv", "expected", "No such file", "check the path"]);
    let other = Recording::read(std::path::Path::new("run.txt"), Protocol::SquareWave);
    assert_says(other, &["run.txt", ".mcap, .csv or .csv.gz"]);
}

#[test]
fn a_row_of_another_length_is_an_error() {
    let text = csv_text(5).replace("0.003,12.5,", "0.003,");
    assert_says(read(text, Protocol::SquareWave), &["line 5", "10 fields", "got 9"]);
    let cut = csv_text(5);
    assert_says(read(&cut[..cut.len() - 12], Protocol::SquareWave), &["line 6", "10 fields"]);
}

#[test]
fn bytes_that_are_not_utf8_are_an_error() {
    let mut text = csv_with(5, 3, 2, "?").into_bytes();
    let at = text.iter().position(|&byte| byte == b'?').unwrap();
    text[at] = 0xff;
    assert_says(read(text, Protocol::SquareWave), &["line 3", "angle_deg", "UTF-8"]);
    let utf16: Vec<u8> = [0xff, 0xfe].into_iter().chain(csv_text(2).bytes().flat_map(|byte| [byte, 0])).collect();
    assert_says(read(utf16, Protocol::SquareWave), &["line 1", "UTF-8"]);
}

#[test]
fn the_line_is_right_with_crlf_empty_lines_and_byte_order_mark() {
    let bad = csv_with(9, 7, 3, "x");
    assert_says(read(bad.replace('\n', "\r\n"), Protocol::SquareWave), &["line 7,", "pressure1_bar"]);
    assert_says(read(bad.replace('\n', "\n\n"), Protocol::SquareWave), &["line 13,", "pressure1_bar"]);
    assert_says(read(bad.replace('\n', "\r\n\r\n"), Protocol::SquareWave), &["line 13,", "pressure1_bar"]);
    assert_says(read(format!("\u{feff}{bad}"), Protocol::SquareWave), &["line 7,", "pressure1_bar"]);
    assert_says(read(format!("\n\n{bad}"), Protocol::SquareWave), &["line 9,", "pressure1_bar"]);
    assert_says(read(format!("\u{feff}{}", csv_with(9, 2, 3, "x")), Protocol::SquareWave), &["line 2,"]);
    assert_says(read_gz(&gz(&bad)), &["run.csv.gz, line 7, pressure1_bar"]);
}

#[test]
fn a_gzip_stream_that_is_cut_or_damaged_anywhere_is_an_error() {
    let whole = gz(&csv_text(3000));
    assert_eq!(read_gz(&whole).unwrap().len(), 3000);
    for length in (0..whole.len()).step_by(97).chain([whole.len() - 1, whole.len() - 8]) {
        let message = assert_says(read_gz(&whole[..length]), &["run.csv.gz, line ", "complete gzip stream", "again"]);
        assert!(message.contains("cut short after"), "{message}");
    }
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x55;
    assert!(read_gz(&damaged).is_err());
    assert_says(read_gz(csv_text(3).as_bytes()), &["run.csv.gz", "gzip"]);
}

#[test]
fn columns_may_stand_in_any_order_among_others() {
    let text: String = csv_text(6)
        .lines()
        .enumerate()
        .map(|(line, fields)| {
            let mut fields: Vec<_> = fields.split(',').collect();
            fields.reverse();
            let other = if line == 0 { "note" } else { "\"free, text\"" };
            format!("{other}, {}\n", fields.join(" ,"))
        })
        .collect();
    let plain = read(csv_text(6), Protocol::ClampSteps).unwrap();
    assert_eq!(common::bits(&read(text, Protocol::ClampSteps).unwrap()), common::bits(&plain));
}

#[test]
fn gzip_members_may_follow_one_another() {
    let text = csv_text(100);
    let (first, second) = text.split_at(text.len() / 2);
    let both = [gz(first), gz(second)].concat();
    assert_eq!(read_gz(&both).unwrap().len(), 100);
}
