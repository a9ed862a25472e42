//! `bench export` to CSV and `bench import`: the same bits there and back, and nothing half written, nothing overwritten.
#![allow(clippy::unwrap_used, reason = "a test")]

mod exchange;

use exchange::*;
use recordings::{Campaign, Item, McapReader, Protocol, Recording};
use rt_core::Sample;
use std::fs;
use std::path::Path;

fn read(path: &Path, protocol: Protocol) -> Vec<Vec<u64>> {
    bits(&Recording::read(path, protocol).unwrap())
}

fn samples(path: &Path) -> Vec<Sample> {
    let items = McapReader::open(path).unwrap();
    items.filter_map(|item| if let Item::Sample(sample) = item.unwrap() { Some(sample) } else { None }).collect()
}

fn import<'a>(csv: &'a Path, mcap: &'a Path, protocol: &'a str) -> Vec<&'a str> {
    let words = ["--protocol", protocol, "--role", "identify", "--plane", "vertical", "--out"];
    ["import", text(csv)].into_iter().chain(words).chain([text(mcap)]).collect()
}

#[test]
fn columns_are_the_same_bits_as_csv_and_as_an_imported_recording() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (mcap, again, csv) = (at("a.mcap"), at("again.mcap"), at("a.csv"));
    record(&mcap, Protocol::SquareWave, 9_100, Flaws::default());
    let columns = read(&mcap, Protocol::SquareWave);
    done(&["export", text(&mcap), "--out", text(&csv)]);
    done(&["export", text(&mcap), "--out", text(&at("a.csv.gz"))]);
    assert!(read(&csv, Protocol::SquareWave) == columns && read(&at("a.csv.gz"), Protocol::SquareWave) == columns);
    let whole = at("whole.csv");
    Recording::read(&mcap, Protocol::SquareWave).unwrap().write_csv(&whole).unwrap();
    assert!(fs::read(&whole).unwrap() == fs::read(&csv).unwrap(), "the same bytes as written in one piece");

    let said = done(&import(&csv, &again, "square-wave"));
    assert!(said.contains("9100 of 9100 samples"), "{said}");
    assert!(read(&again, Protocol::SquareWave) == columns);
    let csv2 = at("again.csv");
    done(&["export", text(&again), "--out", text(&csv2)]);
    assert!(fs::read(&csv2).unwrap() == fs::read(&csv).unwrap());
    // An imported recording is one like any other, and says where it came from.
    let reader = McapReader::open(&again).unwrap();
    assert!(reader.run().name == "again" && reader.run().notes["imported"].contains("a.csv"));
    assert_eq!(bench(&["info", text(&again), "--no-plot"]).0, 0);
}

#[test]
fn runs_of_any_rate_keep_their_times_to_the_nanosecond() {
    let dir = tempfile::tempdir().unwrap();
    for (name, step_s, begin_s) in
        [("slow", 0.004, 0.0), ("fast", 1.0 / 3000.0, 0.0), ("late", 0.001, 12.5), ("odd", 0.0123456, 0.1)]
    {
        let rows = 500;
        let run = Recording {
            time_s: (0..rows).map(|row| begin_s + f64::from(row) * step_s).collect(),
            voltage_v: (0..rows).map(f64::from).collect(),
            angle_deg: vec![-0.0; 500],
            pressure1_bar: vec![0.1 + 0.2; 500],
            pressure2_bar: vec![f64::MIN_POSITIVE; 500],
            torque_nm: vec![f64::NAN; 500],
            volume_ml: vec![f64::NAN; 500],
            brake_open: vec![true; 500],
            bypass_open: vec![false; 500],
            segment: (0..rows).map(i64::from).collect(),
        };
        let (csv, mcap) = (dir.path().join(format!("{name}.csv.gz")), dir.path().join(format!("{name}.mcap")));
        run.write_csv(&csv).unwrap();
        done(&import(&csv, &mcap, "random-steps"));
        let (mut ours, theirs) = (bits(&run), read(&mcap, Protocol::RandomSteps));
        for (time_s, recorded) in run.time_s.iter().zip(&theirs[0]) {
            assert!((time_s - f64::from_bits(*recorded)).abs() < 0.6e-9, "{name}: {time_s}");
        }
        ours[0] = theirs[0].clone();
        assert!(ours == theirs, "{name}: every other column bit for bit");
        let all = samples(&mcap);
        assert!(
            all.iter().enumerate().all(|(row, sample)| sample.tick == row as u64 && sample.sequence() == row as u64)
        );
        assert!(all.iter().all(|sample| sample.last() == (sample.tick == 499)));
    }
}

#[test]
fn a_campaign_stays_one_there_and_back() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("campaign");
    fs::create_dir_all(from.join("sub")).unwrap();
    record(&from.join("square.mcap"), Protocol::SquareWave, 1_500, Flaws::default());
    record(&from.join("sub/clamp.mcap"), Protocol::ClampSteps, 700, Flaws::default());
    campaign(&from, &[("square.mcap", Protocol::SquareWave), ("sub/clamp.mcap", Protocol::ClampSteps)]);
    for (format, extension) in [("csv", "csv"), ("csv.gz", "csv.gz")] {
        let to = dir.path().join(extension);
        let back = dir.path().join(format!("{extension}-back"));
        done(&["export", text(&from), "--format", format, "--out", text(&to)]);
        done(&["import", text(&to), "--out", text(&back)]);
        let open = |dir: &Path| Campaign::open(dir).unwrap();
        let (ours, theirs, again) = (open(&from), open(&to), open(&back));
        assert_eq!((theirs.name.as_str(), theirs.rig), (ours.name.as_str(), ours.rig));
        assert_eq!(theirs.runs[1].file, format!("sub/clamp.{extension}"));
        assert_eq!(again.runs, ours.runs);
        for ((run, exported), imported) in ours.runs.iter().zip(&theirs.runs).zip(&again.runs) {
            let columns = bits(&ours.read(run).unwrap());
            assert!(
                bits(&theirs.read(exported).unwrap()) == columns && bits(&again.read(imported).unwrap()) == columns
            );
            assert_eq!((exported.role, exported.plane), (run.role, run.plane), "the campaign decides the role");
        }
        refused(
            &["export", text(&from), "--format", format, "--out", text(&to)],
            &["campaign.toml", "nothing is overwritten"],
        );
        refused(&["import", text(&to), "--out", text(&back)], &["campaign.toml", "nothing is overwritten"]);
    }
    let other = dir.path().join("mf4");
    done(&["export", text(&from), "--format", "mf4", "--out", text(&other)]);
    let list = fs::read_to_string(other.join("runs.toml")).unwrap();
    assert!(list.contains("file = \"sub/clamp.mf4\"") && list.contains("protocol = \"clamp-steps\""), "{list}");
    assert!(other.join("sub/clamp.mf4").exists() && !other.join("campaign.toml").exists());
}

#[test]
fn raw_samples_events_and_reports_are_written_field_by_field() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    record(&at("a.mcap"), Protocol::SquareWave, 2_500, Flaws::default());
    for (option, file) in [("--raw", "raw.csv"), ("--events", "events.csv"), ("--amplifier", "amplifier.csv")] {
        done(&["export", text(&at("a.mcap")), option, "--out", text(&at(file))]);
    }
    let raw = fs::read_to_string(at("raw.csv")).unwrap();
    let head: Vec<&str> = raw.lines().next().unwrap().split(',').collect();
    assert_eq!(raw.lines().count(), 2_501);
    let column = |name: &str| head.iter().position(|column| *column == name).unwrap_or_else(|| panic!("{name}"));
    for (line, expected) in raw.lines().skip(1).zip(samples(&at("a.mcap"))) {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |name: &str| fields[column(name)].parse::<f64>().unwrap_or(f64::NAN).to_bits();
        assert_eq!(number("angle_deg"), expected.angle_deg.to_bits());
        assert_eq!(number("torque_nm"), expected.torque_nm.to_bits());
        assert_eq!((number("target"), fields[column("target_of")]), (expected.target.to_bits(), "6"));
        assert_eq!(fields[column("woken_ns")], expected.woken_ns.to_string());
        assert_eq!(fields[column("publish_ns")], "4294967295");
        assert_eq!(fields[column("slew_limited")] == "1", expected.flags & rt_core::flags::SLEW_LIMITED != 0);
        assert_eq!(fields[column("last")] == "1", expected.last());
    }
    let events = fs::read_to_string(at("events.csv")).unwrap();
    assert!(events.contains("\n0.40700000000000003,407,error,test,\"with, comma and \"\"quotes\"\"\"\n"), "{events}");
    assert!(events.contains(",test,\"two\nlines\"\n"), "{events}");
    let amplifier = fs::read_to_string(at("amplifier.csv")).unwrap();
    assert_eq!(amplifier.lines().count(), 1 + 2_500 / 20);
    assert!(
        amplifier.lines().nth(2).unwrap().ends_with(",-1500.5,0.25,41.125,7.0,FAULT_CODE_OVER_TEMP_FET"),
        "{amplifier}"
    );
    assert!(amplifier.lines().nth(1).unwrap().contains(",24.0,,-1500.5,"), "what is not told is empty");
}

#[test]
fn lossy_damaged_unfinished_and_foreign_files_are_refused_and_leave_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let out = at("out.csv");
    let export = |name: &str, words: &[&str]| {
        for out in [at("out.csv"), at("out.csv.gz"), at("out.mf4"), at("out.parquet")] {
            refused(&["export", text(&at(name)), "--out", text(&out)], words);
            assert!(!out.exists() && !at(&format!("{}.part", out.file_name().unwrap().to_str().unwrap())).exists());
        }
    };
    record(&at("lossy.mcap"), Protocol::SquareWave, 3_000, Flaws { gap: Some((1_000, 1_009)), ..Flaws::default() });
    export("lossy.mcap", &["lossy.mcap", "without loss", "2990 of 3000"]);
    let (code, _, stderr) = bench(&["export", text(&at("lossy.mcap")), "--raw", "--out", text(&out)]);
    assert!(code == 0 && stderr.contains("warning") && stderr.contains("2990 of 3000"), "{stderr}");
    assert_eq!(fs::read_to_string(&out).unwrap().lines().count(), 2_991);
    fs::remove_file(&out).unwrap();

    record(&at("whole.mcap"), Protocol::SquareWave, 3_000, Flaws::default());
    let bytes = fs::read(at("whole.mcap")).unwrap();
    fs::write(at("cut.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    export("cut.mcap", &["cut.mcap", "bench recover"]);
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 0x10;
    fs::write(at("flipped.mcap"), &flipped).unwrap();
    export("flipped.mcap", &["flipped.mcap"]);
    fs::write(at("foreign.mcap"), "time_s,voltage_v\n0,1\n").unwrap();
    export("foreign.mcap", &["foreign.mcap"]);
    export("nothing.mcap", &["nothing.mcap", "No such file"]);
    record(&at("void.mcap"), Protocol::SquareWave, 0, Flaws { no_end: true, ..Flaws::default() });
    export("void.mcap", &["void.mcap"]);

    let whole = at("whole.mcap");
    refused(&["export", text(&whole), "--out", text(&at("a.xlsx"))], &["a.xlsx", ".csv, .csv.gz, .mf4 or .parquet"]);
    refused(&["export", text(&whole), "--format", "mf4", "--out", text(&at("a.csv"))], &["a.csv", ".mf4"]);
    refused(&["export", text(&whole), "--events", "--out", text(&at("a.mf4"))], &["a.mf4", "--events"]);
    refused(&["export", text(&whole), "--out", text(&at("none/a.csv"))], &["none/a.csv", "No such file"]);
    refused(&["export", text(&at("a.csv")), "--out", text(&at("b.csv"))], &["a.csv", "bench import"]);
    for name in ["a.csv", "a.mf4", "a.parquet"] {
        done(&["export", text(&whole), "--out", text(&at(name))]);
        let before = fs::read(at(name)).unwrap();
        refused(&["export", text(&whole), "--out", text(&at(name))], &[name, "nothing is overwritten"]);
        assert!(fs::read(at(name)).unwrap() == before);
    }
}

#[test]
fn csv_that_is_wrong_anywhere_makes_no_recording() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (csv, mcap) = (at("a.csv"), at("a.mcap"));
    const HEAD: &str =
        "time_s,voltage_v,angle_deg,pressure1_bar,pressure2_bar,torque_nm,volume_ml,brake_open,bypass_open,segment\n";
    let refuse = |rows: &str, words: &[&str]| {
        fs::write(&csv, format!("{HEAD}0,1,2,3,4,,,1,0,0\n{rows}")).unwrap();
        refused(&import(&csv, &mcap, "square-wave"), words);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "only the CSV file is there");
    };
    refuse("0.1,x,2,3,4,,,1,0,0\n", &["a.csv", "line 3", "voltage_v"]);
    refuse("0.1,1,2,3,4,,,1,0,-1\n", &["a.csv", "row 2", "segment", "-1"]);
    refuse("1e-12,1,2,3,4,,,1,0,1\n", &["a.csv", "row 2", "time_s", "1 ns"]);
    refuse("1e9,1,2,3,4,,,1,0,1\n", &["a.csv", "row 2", "time_s"]);
    fs::write(&csv, format!("{HEAD}-0.5,1,2,3,4,,,1,0,0\n")).unwrap();
    refused(&import(&csv, &mcap, "square-wave"), &["a.csv", "row 1", "time_s", "-0.5"]);
    refused(&import(&csv, &mcap, "torque-map"), &["a.csv", "torque_nm", "at least one value"]);
    fs::write(&csv, format!("{HEAD}0,1,2,3,4,,,1,0,0\n")).unwrap();
    refused(&["import", text(&csv), "--out", text(&mcap)], &["--protocol", "--role", "--plane"]);
    refused(&import(&csv, &at("a.txt"), "square-wave"), &["a.txt", ".mcap"]);
    done(&import(&csv, &mcap, "square-wave"));
    let before = fs::read(&mcap).unwrap();
    refused(&import(&csv, &mcap, "square-wave"), &["a.mcap", "exists"]);
    assert!(fs::read(&mcap).unwrap() == before);
    refused(&["import", text(dir.path()), "--out", text(&at("to"))], &["campaign.toml"]);
}
