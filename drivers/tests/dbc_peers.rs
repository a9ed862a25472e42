//! The codec against cantools and python-can, which nobody here wrote: random frames of several databases, in both directions.
//!
//! ```text
//! REC_BENCH_PEERS=required cargo test --release -p drivers --test dbc_peers    # fails where Python can't be had
//! ```
#![allow(clippy::unwrap_used, reason = "a test")]

mod peers;

use drivers::can::{Frame, FrameId};
use drivers::dbc::{Database, Message, Signal};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

const PACKAGES: [&str; 2] = ["cantools==45.1.0", "python-can==4.6.1"];
/// Frames of each database in each direction.
const FRAMES: usize = 2_000;

/// Ours, with that of the rig; then those out of cantools' own tests.
const DATABASES: [&str; 7] = [
    "../../../bench/rigs/rec.dbc",
    "kinds.dbc",
    "multiplexed.dbc",
    "cantools/signed.dbc",
    "cantools/motohawk.dbc",
    "cantools/floating_point.dbc",
    "cantools/multiplex_2.dbc",
];

/// What a peer says of a frame: the message's name, and the value of each signal that is in it.
type Values = (String, BTreeMap<String, f64>);

fn at(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/dbc").join(path)
}

fn peer(python: &Path, arguments: &[&str]) -> Vec<Values> {
    let output = Command::new(python).arg(at("peer.py")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(values).collect()
}

fn values(line: &str) -> Values {
    let mut words = line.split(' ');
    let message = words.next().unwrap().to_owned();
    let value = |word: &str| {
        let (name, bits) = word.split_once('=').unwrap();
        (name.to_owned(), f64::from_bits(u64::from_str_radix(bits, 16).unwrap()))
    };
    (message, words.map(value).collect())
}

/// A line of candump's log: `(1.000000) vcan0 200#7002987FFF000000 R`.
fn frame(line: &str) -> Frame {
    let (id, data) = line.split(' ').nth(2).unwrap().split_once('#').unwrap();
    let number = u32::from_str_radix(id, 16).unwrap();
    let id = if id.len() == 3 { FrameId::standard(number as u16) } else { FrameId::extended(number) };
    let bytes: Vec<u8> =
        (0..data.len() / 2).map(|i| u8::from_str_radix(&data[2 * i..2 * i + 2], 16).unwrap()).collect();
    Frame::new(id.unwrap(), &bytes).unwrap()
}

fn log_line(k: usize, frame: &Frame) -> String {
    let mut line = format!("({}.{:06}) vcan0 {}#", k / 1000, k % 1000 * 1000, frame.id);
    for byte in frame.data() {
        write!(line, "{byte:02X}").unwrap();
    }
    line
}

/// Two doubles that differ by rounding alone.
fn agree(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs()).max(1e-300)
}

fn signals_in<'a>(message: &'a Message, data: &[u8]) -> Vec<&'a Signal> {
    message.signals().iter().filter(|s| s.codec.is_in(data)).collect()
}

/// What the peer encoded is what we decode, from the same signals; and we encode the same bytes.
fn their_frames(python: &Path, file: &str, dir: &Path) -> BTreeSet<String> {
    let database = Database::read(&at(file)).unwrap();
    let log = dir.join("theirs.log");
    let (path, count) = (at(file), FRAMES.to_string());
    let told = peer(python, &["encode", path.to_str().unwrap(), &count, "1", log.to_str().unwrap()]);
    let text = std::fs::read_to_string(&log).unwrap();
    let frames: Vec<Frame> = text.lines().map(frame).collect();
    assert_eq!((told.len(), frames.len()), (FRAMES, FRAMES));
    let mut seen = BTreeSet::new();
    for (frame, (name, expected)) in frames.iter().zip(&told) {
        let message = database.by_id(frame.id).unwrap();
        assert_eq!((&message.name, message.length), (name, frame.data().len()), "{frame:?}");
        let there: BTreeSet<&str> = signals_in(message, frame.data()).iter().map(|s| s.name.as_str()).collect();
        assert_eq!(there, expected.keys().map(String::as_str).collect(), "{name} {frame:?}");
        let mut again = vec![0; message.length];
        let mut exact = true;
        for signal in message.signals() {
            let decoded = signal.codec.decode(frame.data());
            let Some(value) = expected.get(&signal.name) else {
                assert_eq!(decoded, None, "{name}.{} {frame:?}", signal.name);
                continue;
            };
            let decoded = decoded.unwrap();
            assert!(
                agree(decoded, *value),
                "{name}.{}: cantools encoded {value}, got {decoded}: {frame:?}",
                signal.name
            );
            let (minimum, maximum) = signal.codec.range();
            signal.codec.encode(*value, &mut again).unwrap();
            // Beyond 2^53 steps a double does not say which integer it was.
            exact &=
                (maximum - minimum) / signal.codec.resolution() <= 2f64.powi(53) || signal.codec.resolution() < 1e-6;
            seen.insert(format!("{name}.{}", signal.name));
        }
        assert!(
            !exact || again == frame.data(),
            "{name} {expected:?}: cantools {:02X?}, got {again:02X?}",
            frame.data()
        );
    }
    seen
}

/// A frame with random values of signals that can stand together, and the values.
fn random_frame(message: &Message, rng: &mut ChaCha8Rng) -> (Frame, BTreeMap<String, f64>) {
    let mut data = vec![0; message.length];
    let mut order: Vec<&Signal> = message.signals().iter().collect();
    order.shuffle(rng);
    let mut switched = BTreeSet::new();
    for signal in order.iter().filter(|s| s.multiplexor.is_some()) {
        if switched.insert(&signal.multiplexor) {
            signal.codec.select(&mut data).unwrap();
        }
    }
    let switches: BTreeSet<&String> = message.signals().iter().filter_map(|s| s.multiplexor.as_ref()).collect();
    let mut values = BTreeMap::new();
    for signal in signals_in(message, &data) {
        if switches.contains(&signal.name) {
            values.insert(signal.name.clone(), signal.codec.decode(&data).unwrap());
            continue;
        }
        let (minimum, maximum) = signal.codec.range();
        let value = match rng.random_range(0..8) {
            0 => minimum,
            1 if maximum < 1e30 => maximum,
            // The whole range of a float is nearly all of one exponent, and twice it is no double.
            _ if maximum > 1e30 => rng.random_range(-1.0..1.0) * 10f64.powi(rng.random_range(-30..30)),
            _ => minimum + (maximum - minimum) * rng.random_range(0.0..1.0),
        };
        signal.codec.encode(value, &mut data).unwrap();
        values.insert(signal.name.clone(), value);
    }
    (Frame::new(message.id, &data).unwrap(), values)
}

/// What we encoded is what the peer decodes, to half a step.
fn our_frames(python: &Path, file: &str, dir: &Path) -> BTreeSet<String> {
    let database = Database::read(&at(file)).unwrap();
    let messages: Vec<&Message> = database.messages().iter().filter(|m| !m.signals().is_empty()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut sent, mut text) = (Vec::new(), String::new());
    for k in 0..FRAMES {
        let message = messages[k % messages.len()];
        let (frame, values) = random_frame(message, &mut rng);
        writeln!(text, "{}", log_line(k, &frame)).unwrap();
        sent.push((message, values, frame));
    }
    let (path, log) = (at(file), dir.join("ours.log"));
    std::fs::write(&log, text).unwrap();
    let told = peer(python, &["decode", path.to_str().unwrap(), log.to_str().unwrap()]);
    assert_eq!(told.len(), FRAMES);
    let mut seen = BTreeSet::new();
    for ((message, values, frame), (name, decoded)) in sent.iter().zip(&told) {
        assert_eq!(&message.name, name);
        assert!(values.keys().eq(decoded.keys()), "{name} {frame:?}: {values:?}, cantools {decoded:?}");
        for (signal, value) in values {
            let codec = message.signal(signal).unwrap().codec;
            // Half a step, and what the double itself has lost.
            let at_zero = codec.decode(&[0; 8][..message.length]).unwrap_or(0.0);
            let size = value.abs() + at_zero.abs();
            let step = match codec.range().1 {
                1e30..1e40 => f64::from(f32::EPSILON) * size + f64::from(f32::MIN_POSITIVE),
                1e40.. => f64::EPSILON * size,
                _ => codec.resolution(),
            };
            let slack = 0.5 * step * (1.0 + 1e-6) + 1e-15 * size;
            let got = decoded[signal];
            assert!(
                (got - value).abs() <= slack,
                "{name}.{signal}: encoded {value}, cantools decoded {got}: {frame:?}"
            );
            assert!(agree(got, codec.decode(frame.data()).unwrap()), "{name}.{signal} {frame:?}");
            seen.insert(format!("{name}.{signal}"));
        }
    }
    seen
}

#[test]
fn cantools_and_we_read_one_another() {
    let Some(python) = peers::python(&PACKAGES) else { return };
    let dir = tempfile::tempdir().unwrap();
    for file in DATABASES {
        let database = Database::read(&at(file)).unwrap();
        let all: BTreeSet<String> = database
            .messages()
            .iter()
            .flat_map(|m| m.signals().iter().map(|s| format!("{}.{}", m.name, s.name)))
            .collect();
        assert!(!all.is_empty());
        assert_eq!(their_frames(&python, file, dir.path()), all, "{file}: every signal was in a frame");
        assert_eq!(our_frames(&python, file, dir.path()), all, "{file}: every signal was in a frame");
        println!("{file}: {FRAMES} frames each way, {} signals", all.len());
    }
}
