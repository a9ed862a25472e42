//! Rescue of damaged recordings: every complete chunk comes back, nothing is invented, nothing panics.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../common/mod.rs"]
mod common;
mod told;

use std::fs;
use std::ops::Range;
use std::path::Path;

use common::{assert_says, golden::metadata, sample, sample_bits};
use recordings::{
    AmplifierFault, AmplifierReport, CampaignError, Event, Item, McapReader, McapWriter, Recovered, RunMetadata,
    Severity, recover,
};
use rt_core::{LossCertificate, Sample, flags};

const SAMPLES: u64 = 120;
/// Damaged files of each kind.
const ROUNDS: usize = 10_000;

/// A made-up run with its last sample. It passes over most ticks, so that few samples make many chunks.
fn run() -> Vec<Sample> {
    let mut run: Vec<Sample> = (0..SAMPLES)
        .map(|number| {
            let skipped = number * 40 + number / 7;
            Sample { skipped, ..sample(number + skipped) }
        })
        .collect();
    run.last_mut().unwrap().flags |= flags::LAST;
    run
}

/// What is written besides: an event and a report of the amplifier every few samples.
fn others(number: u64, sample: &Sample) -> Vec<Item> {
    let Sample { tick, scheduled_ns, .. } = *sample;
    let (severity, source, text) = (Severity::Warning, "test".to_owned(), format!("event {number}"));
    let event = Event { tick, scheduled_ns, severity, source, text };
    let fault = Some(AmplifierFault { code: number as u32, name: "hot".to_owned() });
    let report =
        AmplifierReport { tick, arrived_ns: scheduled_ns + 7, fault, speed_rpm: 9.5, ..AmplifierReport::BLANK };
    match number % 5 {
        1 => vec![Item::Event(event)],
        3 => vec![Item::Amplifier(report)],
        4 => vec![Item::Event(event), Item::Amplifier(report)],
        _ => vec![],
    }
}

/// A chunk: where it stands, and what was written into it.
#[derive(Clone)]
struct WrittenChunk {
    at: Range<usize>,
    items: Vec<Item>,
}

/// A whole recording, as bytes, and its chunks.
struct Whole {
    bytes: Vec<u8>,
    chunks: Vec<WrittenChunk>,
}

fn whole() -> Whole {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.mcap");
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    let mut written = Vec::new();
    for (number, sample) in run().iter().enumerate() {
        writer.write(sample).unwrap();
        written.push(Item::Sample(*sample));
        for item in others(number as u64, sample) {
            match &item {
                Item::Event(event) => writer.write_event(event).unwrap(),
                Item::Amplifier(report) => writer.write_amplifier(report).unwrap(),
                Item::Sample(_) => panic!("these are the others"),
            }
            written.push(item);
        }
    }
    let certificate = writer.certificate(SAMPLES);
    writer.finish(&certificate).unwrap();
    let bytes = fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut written = written.into_iter();
    let chunks = summary.chunk_indexes.iter().map(|chunk| {
        let begin = usize::try_from(chunk.chunk_start_offset).unwrap();
        // By the index, 16 bytes a message and 15 a channel: what was written was written in this order.
        let messages = (chunk.message_index_length - 15 * chunk.message_index_offsets.len() as u64) / 16;
        let items = written.by_ref().take(messages as usize).collect();
        WrittenChunk { at: begin..begin + usize::try_from(chunk.chunk_length).unwrap(), items }
    });
    let chunks: Vec<_> = chunks.collect();
    assert_eq!(written.next(), None);
    assert!(chunks.len() > 8, "{} chunks", chunks.len());
    Whole { bytes, chunks }
}

/// What is said of a run whose own words are lost.
fn unknown() -> RunMetadata {
    RunMetadata::new("lost", metadata().protocol, metadata().role, metadata().plane)
}

struct Bench {
    dir: tempfile::TempDir,
    number: u32,
}

impl Bench {
    /// In memory where the system has such a folder: thousands of files are synchronised with the disk.
    fn new() -> Self {
        let memory = Path::new("/dev/shm");
        let dir = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
        Self { dir: dir.unwrap(), number: 0 }
    }

    /// Recovers these bytes; the new recording must be sound by the ordinary reader, and say what the rescue said.
    fn recover(&mut self, bytes: &[u8]) -> Result<(Recovered, Vec<Item>), CampaignError> {
        self.number += 1;
        let source = self.dir.path().join(format!("{}.mcap.part", self.number));
        let target = self.dir.path().join(format!("{}.mcap", self.number));
        fs::write(&source, bytes).unwrap();
        let recovered = recover(&source, &target, &unknown())?;
        assert_eq!((&recovered.path, fs::read(&source).unwrap() == bytes), (&target, true), "the source is untouched");
        let (reader, items) = read(&target);
        assert_eq!(reader.certificate(), Some(&recovered.certificate));
        assert_eq!(*reader.run(), recovered.run);
        let count = |of: fn(&Item) -> bool| items.iter().filter(|item| of(item)).count() as u64;
        let Recovered { certificate, events, amplifier_reports, .. } = &recovered;
        assert_eq!(count(|item| matches!(item, Item::Sample(_))), certificate.received);
        assert_eq!(count(|item| matches!(item, Item::Event(_))), *events);
        assert_eq!(count(|item| matches!(item, Item::Amplifier(_))), *amplifier_reports);
        fs::remove_file(&source).unwrap();
        fs::remove_file(&target).unwrap();
        Ok((recovered, items))
    }
}

/// The same bits; NaN is NaN.
fn same(one: &Item, other: &Item) -> bool {
    match (one, other) {
        (Item::Sample(one), Item::Sample(other)) => sample_bits(one) == sample_bits(other),
        (Item::Event(one), Item::Event(other)) => one == other,
        (Item::Amplifier(one), Item::Amplifier(other)) => format!("{one:?}") == format!("{other:?}"),
        _ => false,
    }
}

fn read(path: &Path) -> (McapReader, Vec<Item>) {
    let mut reader = McapReader::open(path).unwrap();
    let items = reader.by_ref().map(|item| item.unwrap()).collect();
    (reader, items)
}

fn assert_same(read: &[Item], expected: &[&Item], case: &str) {
    assert_eq!(read.len(), expected.len(), "{case}");
    for (read, expected) in read.iter().zip(expected) {
        assert!(same(read, expected), "{case}: {read:?} instead of {expected:?}");
    }
}

/// A sequence of numbers that looks like chance and is the same in every run.
struct Dice(u64);

impl Dice {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from((self.0 >> 33) % limit as u64).unwrap()
    }
}

#[test]
fn a_file_cut_anywhere_gives_all_its_complete_chunks() {
    let Whole { bytes, chunks } = whole();
    let mut bench = Bench::new();
    let mut dice = Dice(1);
    let ends = chunks.iter().flat_map(|chunk| [chunk.at.end - 1, chunk.at.end, chunk.at.end + 1]);
    let cuts: Vec<usize> = ends.chain((0..ROUNDS).map(|_| dice.below(bytes.len()))).collect();
    for cut in cuts {
        let complete = chunks.iter().filter(|chunk| chunk.at.end <= cut);
        let expected: Vec<&Item> = complete.flat_map(|chunk| &chunk.items).collect();
        let case = format!("cut at {cut} of {}", bytes.len());
        match bench.recover(&bytes[..cut]) {
            Ok((recovered, items)) => {
                assert_same(&items, &expected, &case);
                let samples = recovered.certificate.received;
                assert_eq!(recovered.certificate.end_seen, samples == SAMPLES, "{case}");
                assert_eq!(recovered.certificate.gaps, [], "{case}");
                assert!(recovered.run_known && recovered.run.files == metadata().files, "{case}");
                assert!(!recovered.ended && recovered.damage.iter().all(|d| d.bytes.end == cut as u64), "{case}");
            }
            Err(error) => assert!(cut < 700 && error.to_string().contains("nothing to recover"), "{case}: {error}"),
        }
    }
}

#[test]
fn flipped_bytes_cost_the_chunks_that_they_hit_and_no_other() {
    let Whole { bytes, chunks } = whole();
    let mut bench = Bench::new();
    let mut dice = Dice(2);
    for round in 0..ROUNDS {
        let mut damaged = bytes.clone();
        let flips: Vec<usize> = (0..1 + dice.below(6)).map(|_| dice.below(bytes.len())).collect();
        for &at in &flips {
            // A single bit in every other round, any other byte in the rest.
            damaged[at] ^= if round % 2 == 0 { 1 << dice.below(8) } else { 1 + dice.below(255) as u8 };
        }
        let hit = |at: &Range<usize>| flips.iter().any(|flip| at.contains(flip));
        check_damage(&mut bench, &damaged, &chunks, &hit, &format!("{round}: {flips:?}"));
    }
}

#[test]
fn a_file_both_cut_and_flipped_gives_the_chunks_that_neither_hit() {
    let Whole { bytes, chunks } = whole();
    let mut bench = Bench::new();
    let mut dice = Dice(5);
    for round in 0..ROUNDS / 4 {
        let cut = bytes.len() / 8 + dice.below(bytes.len() * 7 / 8);
        let mut damaged = bytes[..cut].to_vec();
        let flips: Vec<usize> = (0..1 + dice.below(4)).map(|_| dice.below(cut)).collect();
        for &at in &flips {
            damaged[at] ^= 1 << dice.below(8);
        }
        let hit = |at: &Range<usize>| at.end > cut || flips.iter().any(|flip| at.contains(flip));
        check_damage(&mut bench, &damaged, &chunks, &hit, &format!("{round}: cut at {cut}, {flips:?}"));
    }
}

#[test]
fn a_hole_of_zeros_or_of_noise_costs_what_it_covers() {
    let Whole { bytes, chunks } = whole();
    let mut bench = Bench::new();
    let mut dice = Dice(3);
    for round in 0..ROUNDS / 10 {
        let begin = dice.below(bytes.len());
        let hole = begin..bytes.len().min(begin + 1 + dice.below(bytes.len() / 2));
        let mut damaged = bytes.clone();
        for byte in &mut damaged[hole.clone()] {
            *byte = if round % 2 == 0 { 0 } else { dice.below(256) as u8 };
        }
        let hit = |at: &Range<usize>| at.start < hole.end && hole.start < at.end;
        check_damage(&mut bench, &damaged, &chunks, &hit, &format!("{round}: {hole:?}"));
    }
}

/// Recovers `damaged`: everything that stands in chunks that were not hit is there, all that is there is as it was, in its order, and
/// what is missing is certified.
fn check_damage(
    bench: &mut Bench,
    damaged: &[u8],
    chunks: &[WrittenChunk],
    hit: &dyn Fn(&Range<usize>) -> bool,
    case: &str,
) {
    let (recovered, items) = match bench.recover(damaged) {
        Ok(recovered) => recovered,
        Err(error) => {
            let nothing = error.to_string().contains("nothing to recover") && chunks.iter().all(|chunk| hit(&chunk.at));
            assert!(nothing, "{case}: {error}");
            return;
        }
    };
    // What was written is walked along: each recovered item must be one of it, and those between two of them were hit.
    let mut items = items.iter().peekable();
    for chunk in chunks {
        let (mut there, mut missing) = (0, 0);
        for written in &chunk.items {
            match items.next_if(|item| same(item, written)) {
                Some(_) => there += 1,
                None => missing += 1,
            }
        }
        assert!(there == 0 || missing == 0, "{case}: a chunk comes back whole or not at all");
        assert!(missing == 0 || hit(&chunk.at), "{case}: the chunk at {:?} is whole", chunk.at);
    }
    assert_eq!(items.next(), None, "{case}: nothing is invented");
    let LossCertificate { expected, received, gaps, end_seen, .. } = &recovered.certificate;
    let missing: u64 = gaps.iter().map(|(first, last)| last - first + 1).sum();
    assert_eq!(received + missing, *expected, "{case}");
    assert!(*expected <= SAMPLES && (!end_seen || *expected == SAMPLES), "{case}: {}", recovered.certificate);
    assert_eq!(recovered.left_out, 0, "{case}");
    if recovered.run_known {
        let RunMetadata { mut notes, .. } = recovered.run.clone();
        notes.remove("recovered");
        assert_eq!(RunMetadata { notes, ..recovered.run.clone() }, metadata(), "{case}");
    } else {
        assert_eq!(recovered.run.name, "lost", "{case}");
        assert!(recovered.run.notes["recovered"].contains("was lost"), "{case}");
    }
}

#[test]
fn a_file_of_samples_of_version_1_is_recovered_too() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/format_1.mcap");
    let bytes = fs::read(path).unwrap();
    let (recovered, items) = Bench::new().recover(&bytes[..bytes.len() - 20]).unwrap();
    assert!(recovered.run_known && items.len() == 20);
}

#[test]
fn what_holds_nothing_of_a_recording_is_refused() {
    let mut bench = Bench::new();
    let mut foreign = Vec::new();
    let mut writer = mcap::Writer::new(std::io::Cursor::new(&mut foreign)).unwrap();
    let schema = writer.add_schema("s", "protobuf", b"x").unwrap();
    writer.add_channel(schema, "/other", "protobuf", &Default::default()).unwrap();
    writer.finish().unwrap();
    drop(writer);
    let mut dice = Dice(4);
    let noise: Vec<u8> = (0..100_000).map(|_| dice.below(256) as u8).collect();
    for bytes in [b"".as_slice(), b"hello", &noise, &foreign, &[0; 5_000]] {
        assert_says(bench.recover(bytes), &[".mcap.part", "a recording of this project", "is it the right file?"]);
    }
}

#[test]
fn samples_that_stand_twice_are_taken_once() {
    let Whole { bytes, chunks } = whole();
    let again = &chunks[3];
    let mut doubled = bytes[..chunks[6].at.start].to_vec();
    doubled.extend(&bytes[again.at.clone()]);
    doubled.extend(&bytes[chunks[6].at.start..]);
    let (recovered, items) = Bench::new().recover(&doubled).unwrap();
    let samples: Vec<Item> = items.into_iter().filter(|item| matches!(item, Item::Sample(_))).collect();
    let expected: Vec<Item> = run().into_iter().map(Item::Sample).collect();
    assert_same(&samples, &expected.iter().collect::<Vec<_>>(), "doubled");
    assert_eq!(recovered.left_out as usize, again.items.iter().filter(|item| matches!(item, Item::Sample(_))).count());
}
