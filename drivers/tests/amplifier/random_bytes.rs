//! Ten million inputs for each codec: random, truncated, bit-flipped, whole. No panic; no frame is taken that its checksum refuses.

use super::{settings, state};
use drivers::amplifier::tmcl::Reframer;
use drivers::amplifier::vesc::Deframer;
use drivers::amplifier::{Garbled, Outbox, PROTOCOLS, ProtocolKind};
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

const INPUTS: u64 = 10_000_000;

/// Bytes that came last: those of the frame that was just found are among them.
#[derive(Default)]
struct Stream {
    bytes: Vec<u8>,
}

impl Stream {
    fn push(&mut self, byte: u8) {
        if self.bytes.len() == 8192 {
            self.bytes.drain(..4096);
        }
        self.bytes.push(byte);
    }

    fn ends_with(&self, frame: &[u8]) -> bool {
        self.bytes.ends_with(frame)
    }
}

/// What became of the inputs.
#[derive(Default)]
struct Tally {
    whole: u64,
    truncated: u64,
    flipped: u64,
    random: u64,
}

/// Makes one input out of a sound frame: leaves it, cuts it, flips bits of it, or takes random bytes instead, often those that begin,
/// end or fill frames.
fn mangle(frame: &mut Vec<u8>, usual: &[u8], rng: &mut ChaCha8Rng, tally: &mut Tally) {
    match rng.random_range(0..8) {
        0 => tally.whole += 1,
        1 | 2 => {
            frame.truncate(rng.random_range(0..frame.len()));
            tally.truncated += 1;
        }
        3..=5 => {
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..frame.len());
                frame[at] ^= 1 << rng.random_range(0..8);
            }
            tally.flipped += 1;
        }
        _ => {
            frame.resize(rng.random_range(1..24), 0);
            rng.fill_bytes(frame);
            for byte in frame.iter_mut() {
                if *byte & 1 == 0 {
                    *byte = usual[usize::from(*byte >> 1) % usual.len()];
                }
            }
            tally.random += 1;
        }
    }
}

/// CRC-16/XMODEM as in its definition, bit by bit.
fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 })
    })
}

fn vesc_frame(payload: &[u8], frame: &mut Vec<u8>) {
    frame.clear();
    match payload.len() {
        length @ ..=255 => frame.extend([2, length as u8]),
        length => frame.extend([3, (length >> 8) as u8, length as u8]),
    }
    frame.extend(payload);
    frame.extend(crc(payload).to_be_bytes());
    frame.push(3);
}

fn report(codec: &str, tally: &Tally, counts: Garbled) {
    let Tally { whole, truncated, flipped, random } = tally;
    println!(
        "{codec}: {INPUTS} inputs ({whole} whole, {truncated} truncated, {flipped} bit-flipped, {random} random): {counts:?}"
    );
    assert_eq!(whole + truncated + flipped + random, INPUTS);
    assert!([whole, truncated, flipped, random].iter().all(|kind| **kind > INPUTS / 10));
}

#[test]
fn no_vesc_frame_is_taken_that_the_crc_refuses() {
    let (mut rng, mut tally, mut stream) = (ChaCha8Rng::seed_from_u64(11), Tally::default(), Stream::default());
    let (mut deframer, mut input, mut again, mut payload) = (Deframer::default(), vec![], vec![], [0; 512]);
    let (mut found, mut lost) = (0, 0);
    for _ in 0..INPUTS {
        // Seldom a long one, so that frames of two bytes of length come, too.
        let length = if rng.random_ratio(1, 500) { rng.random_range(200..=512) } else { rng.random_range(1..24) };
        rng.fill_bytes(&mut payload[..length]);
        vesc_frame(&payload[..length], &mut input);
        let whole_before = tally.whole;
        mangle(&mut input, &[2, 3, 1, 4, 50, 0], &mut rng, &mut tally);
        let (before, mut newest_is_input) = (found, false);
        for &byte in &input {
            stream.push(byte);
            deframer.hear(&[byte], |taken| {
                vesc_frame(taken, &mut again);
                assert!(stream.ends_with(&again), "taken: {taken:02x?}");
                newest_is_input = again == input;
                found += 1;
            });
        }
        // What was sent whole is found, whatever came before; but for one that gave bytes to another sound frame: to one whose end, a 3,
        // was cut off and that takes the 3 with which this one begins, or by accident of the CRC.
        if tally.whole > whole_before && !newest_is_input {
            assert!(found > before, "lost: {input:02x?}");
            lost += 1;
        }
    }
    assert!(lost < INPUTS / 100_000, "{lost}");
    let counts = deframer.garbled();
    assert_eq!(counts.sound, found);
    assert!(counts.refused > 1_000_000, "{counts:?}");
    report("vesc", &tally, counts);
}

#[test]
fn no_tmcl_datagram_is_taken_that_the_checksum_refuses() {
    let (mut rng, mut tally, mut stream) = (ChaCha8Rng::seed_from_u64(12), Tally::default(), Stream::default());
    let (mut reframer, mut input, mut found, mut arrived) = (Reframer::default(), vec![], 0_u64, 0_u64);
    for _ in 0..INPUTS {
        input.clear();
        input.extend([2, 1, 100, [5, 6, 15, 136][rng.random_range(0..4)]]);
        input.extend(rng.random::<[u8; 4]>());
        input.push(input.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
        let whole_before = tally.whole;
        mangle(&mut input, &[2, 1, 100, 5, 6, 0], &mut rng, &mut tally);
        let mut newest_is_input = false;
        for &byte in &input {
            stream.push(byte);
            reframer.hear(
                &[byte],
                |head| head[..3] == [2, 1, 100],
                |taken| {
                    assert!(stream.ends_with(taken));
                    assert_eq!(
                        taken[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)),
                        taken[8],
                        "{taken:02x?}"
                    );
                    newest_is_input = taken[..] == input[..];
                    found += 1;
                },
            );
        }
        arrived += u64::from(tally.whole > whole_before && newest_is_input);
    }
    let counts = reframer.garbled();
    assert_eq!(counts.sound, found);
    assert!(counts.refused > 1_000_000, "{counts:?}");
    // Behind a truncated datagram a whole one is lost where the sum over both is right by accident: one of 256.
    assert!(arrived as f64 > 0.995 * tally.whole as f64, "{arrived} of {}", tally.whole);
    report("tmcl", &tally, counts);
}

/// Both sides of a protocol hear each other's mangled frames, and each other's whole ones, in one go and in pieces.
fn both_sides_survive(kind: &ProtocolKind, inputs: u64) {
    let (mut rng, mut tally) = (ChaCha8Rng::seed_from_u64(13), Tally::default());
    let (mut client, mut drive) = ((kind.client)(&settings(kind)).unwrap(), (kind.drive)(&settings(kind)).unwrap());
    let (mut out, mut back, mut input, mut told_count) = (Outbox::new(), Outbox::new(), vec![], 0_u64);
    let state = state();
    for round in 0..inputs {
        out.clear();
        match rng.random_range(0..4) {
            0 => client.hello(&mut out),
            1 => client.keep_alive(&mut out),
            2 => client.request(&mut out),
            _ => client.command(rng.random_range(-20.0..20.0), &mut out),
        }
        input.clear();
        input.extend(out.bytes());
        mangle(&mut input, &[1, 2, 3, 5, 6, 100], &mut rng, &mut tally);
        back.clear();
        let voltage_v = drive.hear(&input, round, &state, &mut back);
        assert!(voltage_v.is_none_or(|v| v.abs() <= 12.0));
        input.clear();
        input.extend(back.bytes());
        if !input.is_empty() {
            mangle(&mut input, &[1, 2, 3, 5, 6, 100], &mut rng, &mut tally);
        }
        client.hear(&input, &mut |_| told_count += 1);
    }
    assert!(drive.garbled().sound > inputs / 10 && told_count > 0);
    println!("{}: {inputs} rounds, {told_count} tellings, client {:?}", kind.name, client.garbled());
}

#[test]
fn both_sides_survive_whatever_comes() {
    for kind in PROTOCOLS {
        both_sides_survive(kind, 1_000_000);
    }
}
