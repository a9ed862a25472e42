//! Inputs that nobody means well with: never a panic, and what is accepted keeps the rules.
//!
//! Frames: 10 million random, truncated and bit-flipped ones to decoding and encoding. Databases: 20,000 mutated texts to the parser; the
//! variable `REC_BENCH_DBC_MUTATIONS` says another number:
//!
//! ```text
//! REC_BENCH_DBC_MUTATIONS=5000000 cargo test --release -p drivers --test dbc_hostile -- databases
//! ```
#![allow(clippy::unwrap_used, reason = "a test")]

use drivers::dbc::{Database, DbcError, OutOfRange, Signal};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

const FRAMES: u32 = 10_000_000;
const TEXTS: u32 = 20_000;
const FILES: [&str; 6] = [
    "kinds.dbc",
    "multiplexed.dbc",
    "cantools/signed.dbc",
    "cantools/motohawk.dbc",
    "cantools/floating_point.dbc",
    "cantools/multiplex_2.dbc",
];

fn path(file: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/dbc").join(file)
}

#[test]
fn ten_million_frames_to_the_codecs() {
    let databases: Vec<Database> = FILES.iter().map(|f| Database::read(&path(f)).unwrap()).collect();
    let signals: Vec<(usize, &Signal)> = databases
        .iter()
        .flat_map(|d| d.messages().iter().flat_map(|m| m.signals().iter().map(|s| (m.length, s))))
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut decoded, mut refused, mut short) = (0u32, 0u32, 0u32);
    for k in 0..FRAMES {
        let (length, signal) = signals.choose(&mut rng).unwrap();
        let codec = &signal.codec;
        let mut data: [u8; 12] = [0; 12];
        // Sound frames with a bit flipped or the end cut off, and noise of any length up to beyond a frame.
        let bytes = match k % 3 {
            0 => rng.random_range(0..=12),
            1 => rng.random_range(0..=*length),
            _ => *length,
        };
        if k % 3 == 0 {
            rng.fill(&mut data);
        } else {
            let (minimum, maximum) = codec.range();
            let value = if maximum > 1e30 { 12.5 } else { minimum + (maximum - minimum) * rng.random_range(0.0..1.0) };
            codec.encode(value, &mut data[..8]).unwrap();
            codec.select(&mut data[..8]).unwrap();
            let bit = rng.random_range(0..64);
            data[bit / 8] ^= 1 << (bit % 8);
        }
        let frame = &mut data[..bytes];
        match codec.decode(frame) {
            Some(value) => {
                decoded += 1;
                assert!(bytes >= codec.bytes_needed());
                let (minimum, maximum) = codec.range();
                assert!((minimum..=maximum).contains(&value) || maximum > 1e30, "{}: {value}", signal.name);
            }
            None => assert!(bytes < codec.bytes_needed() || codec.is_multiplexed(), "{}", signal.name),
        }
        let value = f64::from_bits(rng.random());
        let before = data;
        match codec.encode(value, &mut data[..bytes]) {
            Ok(()) => {}
            Err(OutOfRange::Value { .. }) => {
                refused += 1;
                assert_eq!(data, before);
            }
            Err(OutOfRange::Frame { .. }) => {
                short += 1;
                assert_eq!(data, before);
            }
        }
    }
    assert!(decoded > FRAMES / 4 && refused > FRAMES / 20 && short > FRAMES / 20, "{decoded} {refused} {short}");
    println!("{FRAMES} frames: {decoded} decoded, {refused} values refused, {short} frames too short");
}

/// Pieces that mean something in a database.
const PIECES: [&str; 26] = [
    "BO_ ",
    "SG_ ",
    "SIG_VALTYPE_ ",
    "SG_MUL_VAL_ ",
    "BA_ \"GenMsgCycleTime\" BO_ ",
    " M ",
    " m0 ",
    " m3M ",
    " m99999999999999999999 ",
    "\n",
    ";",
    ":",
    "|",
    "@",
    "\"",
    "0",
    "-1",
    "18446744073709551616",
    "4294967296",
    "1e999",
    "0.5",
    "(0,0)",
    "[5|1]",
    "64",
    "°",
    "\u{0}",
];

fn mutate(text: &str, other: &str, rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..rng.random_range(1..=3) {
        let at = rng.random_range(0..=bytes.len());
        let end = (at + rng.random_range(0..40)).min(bytes.len());
        match rng.random_range(0..10) {
            0 if at < bytes.len() => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => drop(bytes.drain(at..end)),
            2 => bytes.truncate(at),
            3 => drop(bytes.splice(at..at, PIECES.choose(rng).unwrap().bytes())),
            4 => {
                let copy = bytes[at..end].to_vec();
                let to = rng.random_range(0..=bytes.len());
                drop(bytes.splice(to..to, copy));
            }
            5..8 => {
                // A number by another one, where most of the checks are.
                let digits: Vec<usize> = (0..bytes.len()).filter(|i| bytes[*i].is_ascii_digit()).collect();
                match digits.choose(rng) {
                    Some(i) if rng.random_bool(0.7) => bytes[*i] = rng.random_range(b'0'..=b'9'),
                    Some(i) => drop(bytes.splice(*i..=*i, PIECES[14..].choose(rng).unwrap().bytes())),
                    None => {}
                }
            }
            _ => {
                let lines: Vec<&str> = other.lines().collect();
                let line = format!("{}\n", lines.choose(rng).unwrap());
                let to = bytes[..at].iter().rposition(|b| *b == b'\n').map_or(0, |i| i + 1);
                drop(bytes.splice(to..to, line.into_bytes()));
            }
        }
    }
    bytes
}

#[test]
fn mutated_databases_to_the_parser() {
    let texts: Vec<String> = FILES
        .iter()
        .map(|f| std::fs::read(path(f)).unwrap())
        .map(|bytes| bytes.iter().map(|b| char::from(*b)).collect())
        .collect();
    let count = std::env::var("REC_BENCH_DBC_MUTATIONS").map_or(TEXTS, |n| n.parse().unwrap());
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut accepted, mut syntax, mut checks) = (0u32, 0u32, 0u32);
    let dir = tempfile::tempdir().unwrap();
    let scratch = dir.path().join("mutated.dbc");
    for k in 0..count {
        let (text, other) = (texts.choose(&mut rng).unwrap(), texts.choose(&mut rng).unwrap());
        let bytes = mutate(text, other, &mut rng);
        // Through a file now and then: it decodes whatever bytes come.
        let read = if k % 16 == 0 {
            std::fs::write(&scratch, &bytes).unwrap();
            Database::read(&scratch)
        } else {
            Database::parse(&String::from_utf8_lossy(&bytes), "mutated.dbc")
        };
        match read {
            Ok(database) => {
                accepted += 1;
                sound(&database);
            }
            Err(DbcError::File { line, problem, .. }) => {
                let lines = 1 + bytes.iter().filter(|b| matches!(b, b'\n' | b'\r')).count();
                assert!((1..=lines).contains(&line), "line {line} of {lines}: {problem}");
                let is_syntax = matches!(problem, drivers::dbc::Problem::Syntax { .. });
                *(if is_syntax { &mut syntax } else { &mut checks }) += 1;
            }
            Err(e) => panic!("expected an error of the file, got {e}"),
        }
    }
    let told = format!("{count} databases: {accepted} accepted, {syntax} syntax errors, {checks} refused by checks");
    assert!(count < 1_000 || (accepted > count / 50 && syntax > count / 10 && checks > count / 50), "{told}");
    println!("{told}");
}

/// What was accepted can be used: every codec works on frames of the message's length, and no bit is two signals' in one frame.
fn sound(database: &Database) {
    for message in database.messages() {
        let mut data = vec![0u8; message.length.min(8)];
        for signal in message.signals() {
            assert!(signal.codec.bytes_needed() <= message.length);
            signal.codec.select(&mut data).unwrap();
            let (minimum, maximum) = signal.codec.range();
            assert!(minimum <= maximum && signal.minimum <= signal.maximum, "{signal:?}");
            assert!(signal.codec.decode(&data).is_some(), "{signal:?}");
            let _ = signal.codec.encode(signal.minimum, &mut data);
            assert!(database.signal(&format!("{}.{}", message.name, signal.name)).is_ok());
        }
        assert_eq!(database.by_id(message.id).map(|m| &m.name), Some(&message.name));
    }
}
