//! Exported MDF and Parquet files, read by programs that nobody here wrote: Python's asammdf and pyarrow.
//!
//! ```text
//! REC_BENCH_PEERS=required cargo test --release -p bench --test exchange_peers    # fails where Python can't be had
//! ```
#![allow(clippy::unwrap_used, reason = "a test")]

mod exchange;
#[path = "../../drivers/tests/peers/mod.rs"]
mod peers;

use exchange::*;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use recordings::Protocol;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

const PACKAGES: [&str; 2] = ["asammdf==8.8.28", "pyarrow==26.0.1"];
/// More than one piece of an MDF file and more than one row group of a Parquet file.
const SAMPLES: u64 = 70_000;

/// The tables of a recording as CSV, which has tests of its own, and in another format.
fn exported(dir: &Path, extension: &str) -> Vec<(&'static str, PathBuf, PathBuf)> {
    let mcap = dir.join("a.mcap");
    record(&mcap, Protocol::SquareWave, SAMPLES, Flaws::default());
    let tables =
        [("rows", None), ("samples", Some("--raw")), ("events", Some("--events")), ("amplifier", Some("--amplifier"))];
    let mut files = Vec::new();
    for (name, option) in tables {
        let (csv, other) = (dir.join(format!("{name}.csv")), dir.join(format!("{name}.{extension}")));
        let export = |out: &Path| {
            let arguments = ["export", text(&mcap), "--out", text(out)].into_iter().chain(option);
            done(&arguments.collect::<Vec<_>>());
        };
        export(&csv);
        // An MDF file holds events and reports beside either kind of samples.
        if extension != "mf4" || matches!(name, "rows" | "samples") {
            export(&other);
        }
        files.push((name, csv, other));
    }
    files
}

fn compare(script: &str, arguments: &[&str]) {
    let Some(python) = peers::python(&PACKAGES) else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/exchange").join(script);
    let output = Command::new(python).arg(script).args(arguments).output().unwrap();
    let (told, complained) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{told}{complained}");
    assert!(told.contains("all values agree"), "{told}{complained}");
}

#[test]
fn asammdf_reads_every_value_unit_and_event() {
    let dir = tempfile::tempdir().unwrap();
    exported(dir.path(), "mf4");
    compare("read_mdf.py", &[text(dir.path())]);
}

#[test]
fn pyarrow_reads_every_value_and_unit() {
    let dir = tempfile::tempdir().unwrap();
    exported(dir.path(), "parquet");
    compare("read_parquet.py", &[text(dir.path())]);
}

#[test]
fn parquet_files_read_back_by_the_crate_are_the_csv() {
    let dir = tempfile::tempdir().unwrap();
    for (name, csv, other) in exported(dir.path(), "parquet") {
        let reader = SerializedFileReader::new(File::open(other).unwrap()).unwrap();
        if name == "rows" {
            assert!(reader.num_row_groups() > 1, "the file was written in pieces");
            let facts = reader.metadata().file_metadata().key_value_metadata().unwrap().clone();
            let fact = |key: &str| facts.iter().find(|fact| fact.key == key).unwrap().value.clone().unwrap();
            assert_eq!((fact("unit.pressure1_bar"), fact("protocol")), ("bar".to_owned(), "square-wave".to_owned()));
            assert_eq!(fact("profile"), "name = \"a\" # <&> \"quoted\"\n");
        }
        if name == "events" {
            let texts: Vec<String> =
                reader.get_row_iter(None).unwrap().map(|row| text_of(&row.unwrap(), "text")).collect();
            assert_eq!(&texts[..5], TEXTS);
            continue;
        }
        let written = fs::read_to_string(csv).unwrap();
        let head: Vec<&str> = written.lines().next().unwrap().split(',').collect();
        let mut lines = written.lines().skip(1);
        for row in reader.get_row_iter(None).unwrap() {
            let row = row.unwrap();
            let fields: Vec<&str> = lines.next().unwrap().split(',').collect();
            for (index, (column, value)) in row.get_column_iter().enumerate() {
                assert_eq!(column, head[index]);
                let same = match value {
                    Field::Null => fields[index].is_empty(),
                    Field::Double(value) => fields[index].parse().is_ok_and(|f: f64| f.to_bits() == value.to_bits()),
                    Field::Bool(value) => fields[index] == if *value { "1" } else { "0" },
                    Field::Long(value) => fields[index] == value.to_string(),
                    Field::ULong(value) => fields[index] == value.to_string(),
                    Field::Str(value) => fields[index] == value,
                    _ => false,
                };
                assert!(same, "{name}, {column}: {value} instead of {}", fields[index]);
            }
        }
        assert!(lines.next().is_none(), "{name}: all rows");
    }
}

fn text_of(row: &parquet::record::Row, column: &str) -> String {
    let found = row.get_column_iter().find(|(name, _)| *name == column).unwrap().1;
    if let Field::Str(text) = found { text.clone() } else { panic!("{found:?}") }
}
