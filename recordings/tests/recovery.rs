//! Rescue of damaged recordings: every complete chunk comes back, nothing is invented, nothing panics.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use common::{assert_says, metadata, sample_bits, skipping, write_mcap};
use recordings::{CampaignError, Event, Item, McapReader, McapWriter, Recovered, RunMetadata, Severity, recover};
use rt_core::{LossCertificate, Sample, flags};

const SAMPLES: u64 = 3_000;

/// A made-up run with its last sample, written in several chunks.
fn run() -> Vec<Sample> {
    let mut run: Vec<Sample> = (0..SAMPLES).map(skipping).collect();
    run.last_mut().unwrap().flags |= flags::LAST;
    run
}

/// A whole recording, as bytes, and where each chunk stands with the samples in it.
struct Whole {
    bytes: Vec<u8>,
    chunks: Vec<(Range<usize>, Vec<Sample>)>,
}

fn whole() -> Whole {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.mcap");
    write_mcap(&path, &run(), SAMPLES);
    let bytes = fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunks = summary.chunk_indexes.iter().enumerate().map(|(number, chunk)| {
        let begin = usize::try_from(chunk.chunk_start_offset).unwrap();
        let within = |s: &&Sample| (chunk.message_start_time..=chunk.message_end_time).contains(&s.scheduled_ns);
        // The first chunk holds the schema alone; its time is said to be 0.
        let samples = if number == 0 { vec![] } else { run().iter().filter(within).copied().collect() };
        (begin..begin + usize::try_from(chunk.chunk_length).unwrap(), samples)
    });
    let chunks: Vec<_> = chunks.collect();
    assert_eq!(chunks.iter().map(|(_, samples)| samples.len() as u64).sum::<u64>(), SAMPLES);
    assert!(chunks.len() > 6, "{} chunks", chunks.len());
    Whole { bytes, chunks }
}

/// What is said of a run whose own words are lost.
fn unknown() -> RunMetadata {
    RunMetadata { name: "lost".to_owned(), profile: String::new(), notes: Default::default(), ..metadata() }
}

struct Bench {
    dir: tempfile::TempDir,
    number: u32,
}

impl Bench {
    fn new() -> Self {
        // In memory where there is such a folder: each recovery waits until its file is on the disk.
        let dir = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        Bench { dir, number: 0 }
    }

    /// Recovers these bytes; the new recording must be sound by the ordinary reader, and say what the rescue said.
    fn recover(&mut self, bytes: &[u8]) -> Result<(Recovered, Vec<Sample>), CampaignError> {
        self.number += 1;
        let source = self.dir.path().join(format!("{}.mcap.part", self.number));
        let target = self.dir.path().join(format!("{}.mcap", self.number));
        fs::write(&source, bytes).unwrap();
        let recovered = recover(&source, &target, &unknown())?;
        assert_eq!((&recovered.path, fs::read(&source).unwrap() == bytes), (&target, true), "the source is untouched");
        let (reader, items) = read(&target);
        assert_eq!(reader.certificate(), Some(&recovered.certificate));
        assert_eq!(*reader.run(), recovered.run);
        let samples: Vec<Sample> =
            items.iter().filter_map(|i| if let Item::Sample(s) = i { Some(*s) } else { None }).collect();
        assert_eq!(samples.len() as u64, recovered.certificate.received);
        fs::remove_file(&source).unwrap();
        fs::remove_file(&target).unwrap();
        Ok((recovered, samples))
    }
}

fn read(path: &Path) -> (McapReader, Vec<Item>) {
    let mut reader = McapReader::open(path).unwrap();
    let items = reader.by_ref().map(|item| item.unwrap()).collect();
    (reader, items)
}

fn assert_same(read: &[Sample], expected: &[Sample], case: &str) {
    assert_eq!(read.len(), expected.len(), "{case}");
    for (read, expected) in read.iter().zip(expected) {
        assert_eq!(sample_bits(read), sample_bits(expected), "{case}, tick {}", expected.tick);
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
    let ends = chunks.iter().flat_map(|(at, _)| [at.end - 1, at.end, at.end + 1]);
    let cuts: Vec<usize> = ends.chain((0..300).map(|_| dice.below(bytes.len()))).collect();
    for cut in cuts {
        let complete = chunks.iter().filter(|(at, _)| at.end <= cut);
        let expected: Vec<Sample> = complete.clone().flat_map(|(_, samples)| samples.clone()).collect();
        let case = format!("cut at {cut} of {}", bytes.len());
        match bench.recover(&bytes[..cut]) {
            Ok((recovered, samples)) => {
                assert_same(&samples, &expected, &case);
                assert_eq!(recovered.certificate.end_seen, samples.len() as u64 == SAMPLES, "{case}");
                assert_eq!(recovered.certificate.gaps, [], "{case}");
                assert!(recovered.run_known && recovered.run.name == metadata().name, "{case}");
                assert!(!recovered.ended && recovered.damage.iter().all(|d| d.bytes.end == cut as u64), "{case}");
            }
            Err(error) => assert!(cut < 500 && error.to_string().contains("nothing to recover"), "{case}: {error}"),
        }
    }
}

#[test]
fn flipped_bytes_cost_the_chunks_that_they_hit_and_no_other() {
    let Whole { bytes, chunks } = whole();
    let mut bench = Bench::new();
    let mut dice = Dice(2);
    for round in 0..300 {
        let mut damaged = bytes.clone();
        let flips: Vec<usize> = (0..1 + dice.below(4)).map(|_| dice.below(bytes.len())).collect();
        for &at in &flips {
            damaged[at] ^= 1 + dice.below(255) as u8;
        }
        check_damage(
            &mut bench,
            &damaged,
            &chunks,
            &|at| flips.iter().any(|f| at.contains(f)),
            &format!("{round}: {flips:?}"),
        );
    }
}

#[test]
fn a_hole_of_zeros_or_of_noise_costs_what_it_covers() {
    let Whole { bytes, chunks } = whole();
    let mut bench = Bench::new();
    let mut dice = Dice(3);
    for round in 0..60 {
        let begin = dice.below(bytes.len());
        let hole = begin..bytes.len().min(begin + 1 + dice.below(60_000));
        let mut damaged = bytes.clone();
        for byte in &mut damaged[hole.clone()] {
            *byte = if round % 2 == 0 { 0 } else { dice.below(256) as u8 };
        }
        let hit = |at: &Range<usize>| at.start < hole.end && hole.start < at.end;
        check_damage(&mut bench, &damaged, &chunks, &hit, &format!("{round}: {hole:?}"));
    }
}

/// Recovers `damaged`: all samples of chunks that were not hit are there, all that is there is as it was, and what is
/// missing is certified.
fn check_damage(
    bench: &mut Bench,
    damaged: &[u8],
    chunks: &[(Range<usize>, Vec<Sample>)],
    hit: &dyn Fn(&Range<usize>) -> bool,
    case: &str,
) {
    let (recovered, samples) = bench.recover(damaged).unwrap_or_else(|error| panic!("{case}: {error}"));
    let original = run();
    for sample in &samples {
        let there = &original[usize::try_from(sample.sequence()).unwrap()];
        assert_eq!(sample_bits(sample), sample_bits(there), "{case}: nothing is invented");
    }
    let numbers: Vec<u64> = samples.iter().map(Sample::sequence).collect();
    for (at, samples) in chunks.iter().filter(|(at, _)| !hit(at)) {
        let all_there = samples.iter().all(|s| numbers.binary_search(&s.sequence()).is_ok());
        assert!(all_there, "{case}: the chunk at {at:?} is whole");
    }
    let LossCertificate { expected, received, gaps, end_seen, .. } = &recovered.certificate;
    let missing: u64 = gaps.iter().map(|(first, last)| last - first + 1).sum();
    assert_eq!(received + missing, *expected, "{case}");
    assert!(*expected <= SAMPLES && (!end_seen || *expected == SAMPLES), "{case}: {}", recovered.certificate);
    assert_eq!(recovered.left_out, 0, "{case}");
    if recovered.run_known {
        assert_eq!(recovered.run.profile, metadata().profile, "{case}");
    } else {
        assert_eq!(recovered.run.name, "lost", "{case}");
        assert!(recovered.run.notes["recovered"].contains("was lost"), "{case}");
    }
}

#[test]
fn the_place_of_the_damage_is_told() {
    let Whole { mut bytes, chunks } = whole();
    let (at, _) = chunks[4].clone();
    bytes[at.start + 1000] ^= 0x40;
    let (recovered, _) = Bench::new().recover(&bytes).unwrap();
    assert_eq!(recovered.damage.len(), 1, "{:?}", recovered.damage);
    // The index behind the chunk is swallowed with it; the next chunk is sound.
    assert_eq!(recovered.damage[0].bytes, at.start as u64..chunks[5].0.start as u64);
    assert!(recovered.ended && recovered.certificate.end_seen);
    let text = &recovered.run.notes["recovered"];
    assert!(text.contains("1.mcap.part") && text.contains(&format!("from byte {} on", at.start)), "{text}");
}

#[test]
fn where_the_file_no_longer_says_what_the_run_is_the_caller_s_words_stand() {
    let Whole { mut bytes, .. } = whole();
    let name = bytes.windows(8).position(|w| w == b"protocol").unwrap();
    bytes[name + 13] ^= 1; // within the word "square-wave"
    let (recovered, samples) = Bench::new().recover(&bytes).unwrap();
    assert!(!recovered.run_known && recovered.run.name == "lost");
    assert_eq!(samples.len() as u64, SAMPLES);
    // Without a checksum such a flip would pass for another word.
    assert_eq!(recovered.damage.len(), 1);
}

#[test]
fn a_certificate_that_is_whole_tells_the_length_of_a_run_whose_end_is_damaged() {
    let Whole { mut bytes, chunks } = whole();
    let (at, lost) = chunks.last().unwrap().clone();
    bytes[at.end - 100] ^= 1;
    let (recovered, _) = Bench::new().recover(&bytes).unwrap();
    let first = SAMPLES - lost.len() as u64;
    assert_eq!(recovered.certificate.gaps, [(first, SAMPLES - 1)]);
    assert!(recovered.certificate.end_seen, "the damaged file's certificate said so, and its checksum proves it");
}

#[test]
fn events_come_back_and_a_run_without_end_stays_without() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let event = Event {
        tick: 20,
        scheduled_ns: 20_000_000,
        severity: Severity::Warning,
        source: "test".to_owned(),
        text: "seen".to_owned(),
    };
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    for sample in &run()[..2_000] {
        writer.write(sample).unwrap();
        if sample.tick == 20 {
            writer.write_event(&event).unwrap();
        }
    }
    // As a kill leaves it: what the system has, nothing more.
    let killed = dir.path().join("killed.mcap.part");
    fs::copy(dir.path().join("a.mcap.part"), &killed).unwrap();
    drop(writer);
    let target = dir.path().join("killed.mcap");
    let recovered = recover(&killed, &target, &unknown()).unwrap();
    let certificate = &recovered.certificate;
    assert!(recovered.events == 1 && !certificate.end_seen && certificate.received >= 1_500, "{certificate}");
    let (first_s, last_s) = recovered.span_s.unwrap();
    assert!(first_s == 0.0 && last_s > 1.4, "{first_s} to {last_s} s");
    assert!(read(&target).1.contains(&Item::Event(event)));
    assert_says(recover(&killed, &target, &unknown()), &["killed.mcap", "exists"]);
    assert!(recovered.damage.is_empty() && !recovered.ended, "nothing is damaged, the end is missing");
    let leftovers: Vec<PathBuf> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().path()).collect();
    assert!(leftovers.iter().all(|p| p.extension().unwrap() != "recovering"), "{leftovers:?}");
}

#[test]
fn a_file_of_samples_of_version_1_is_recovered_too() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/format_1.mcap");
    let bytes = fs::read(path).unwrap();
    let (recovered, samples) = Bench::new().recover(&bytes[..bytes.len() - 20]).unwrap();
    assert!(recovered.run_known && samples.len() == 20);
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
    let (again, _) = &chunks[3];
    let mut doubled = bytes[..chunks[6].0.start].to_vec();
    doubled.extend(&bytes[again.clone()]);
    doubled.extend(&bytes[chunks[6].0.start..]);
    let (recovered, samples) = Bench::new().recover(&doubled).unwrap();
    assert_same(&samples, &run(), "doubled");
    assert_eq!(recovered.left_out as usize, chunks[3].1.len());
}
