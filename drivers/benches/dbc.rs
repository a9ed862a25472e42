//! What decoding and encoding of a CAN frame costs, with all its signals.
//!
//! ```text
//! cargo bench -p drivers --bench dbc                  # ns of a frame, median of the rounds
//! cargo bench -p drivers --bench dbc -- --check       # ends with 3 where a frame takes more than 100 ns
//! ```
//!
//! A round is 4,096 frames with other data each, short enough to lie between two interruptions; the fastest round is that of an
//! undisturbed processor. Decoding begins with the identifier (`by_id`), as the loop does.

use drivers::can::FrameId;
use drivers::dbc::{Database, Message};
use std::hint::black_box;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

const FRAMES: usize = 4_096;
/// Different frames, used in turn: a power of two, so that choosing one costs nothing.
const DIFFERENT: usize = 1024;
const ROUNDS: usize = 1_001;
/// Most that a frame may take, ns.
const TARGET_NS: f64 = 100.0;

/// File and message, what is special about it.
const CASES: [(&str, &str); 10] = [
    ("kinds.dbc", "LITTLE"),
    ("kinds.dbc", "BIG"),
    ("kinds.dbc", "FLOATS"),
    ("kinds.dbc", "DOUBLE_BIG"),
    ("kinds.dbc", "SHORT"),
    ("kinds.dbc", "EXTENDED"),
    ("multiplexed.dbc", "SIMPLE"),
    ("multiplexed.dbc", "NESTED"),
    ("cantools/signed.dbc", "Message378910"),
    ("cantools/multiplex_2.dbc", "Extended"),
];

/// Random bytes, the same in every run.
fn frames(message: &Message) -> Vec<(FrameId, [u8; 8])> {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()
    };
    (0..DIFFERENT).map(|_| (message.id, next())).collect()
}

/// What a frame costs, ns: median and minimum of the rounds.
fn rounds(mut round: impl FnMut()) -> (f64, f64) {
    round();
    let mut ns: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            round();
            start.elapsed().as_nanos() as f64 / FRAMES as f64
        })
        .collect();
    ns.sort_by(f64::total_cmp);
    (ns[ROUNDS / 2], ns[0])
}

fn decoding(database: &Database, message: &Message) -> (f64, f64) {
    let frames = frames(message);
    rounds(|| {
        for k in 0..FRAMES {
            let (id, data) = black_box(&frames[k % DIFFERENT]);
            let Some(message) = database.by_id(*id) else { continue };
            for signal in message.signals() {
                black_box(signal.codec.decode(&data[..message.length]));
            }
        }
    })
}

fn encoding(message: &Message) -> (f64, f64) {
    // Values that fit, other ones in each frame.
    let values: Vec<Vec<f64>> = frames(message)
        .iter()
        .map(|(_, data)| {
            let part = f64::from(u32::from_le_bytes([data[0], data[1], data[2], 0])) / f64::from(1 << 24);
            let between = |(low, high): (f64, f64)| if high > 1e30 { 100.0 * part } else { low + (high - low) * part };
            message.signals().iter().map(|s| between(s.codec.range())).collect()
        })
        .collect();
    rounds(|| {
        for k in 0..FRAMES {
            let mut data = [0; 8];
            for (signal, value) in message.signals().iter().zip(black_box(&values[k % DIFFERENT])) {
                black_box(signal.codec.encode(*value, &mut data[..message.length]).is_ok());
            }
            black_box(data);
        }
    })
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let check = match arguments.as_slice() {
        [] => false,
        [only] if only == "--check" => true,
        other => {
            eprintln!("expected --check or nothing, got {other:?}");
            return ExitCode::from(2);
        }
    };
    let mut worst: f64 = 0.0;
    println!(
        "{:14} {:>7} {:>10} {:>8} {:>10} {:>8}",
        "message", "signals", "decode ns", "fastest", "encode ns", "fastest"
    );
    for (file, name) in CASES {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/dbc").join(file);
        let database = match Database::read(&path) {
            Ok(database) => database,
            Err(e) => {
                eprintln!("{e}");
                return ExitCode::from(2);
            }
        };
        let Some(message) = database.message(name) else {
            eprintln!("{}: expected a message {name}", path.display());
            return ExitCode::from(2);
        };
        let (decode, decode_fastest) = decoding(&database, message);
        let (encode, encode_fastest) = encoding(message);
        worst = worst.max(decode).max(encode);
        let signals = message.signals().len();
        println!("{name:14} {signals:>7} {decode:>10.1} {decode_fastest:>8.1} {encode:>10.1} {encode_fastest:>8.1}");
    }
    println!("worst median {worst:.1} ns a frame, target {TARGET_NS:.0} ns");
    if check && worst > TARGET_NS { ExitCode::from(3) } else { ExitCode::SUCCESS }
}
