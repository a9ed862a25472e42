//! What a rescue tells: where the damage is, what the run was, how long it was, whether it ended.

use std::fs;
use std::path::PathBuf;

use recordings::{Event, Item, McapWriter, Severity, recover};

use crate::common::{assert_says, golden::metadata, skipping};
use crate::{Bench, SAMPLES, Whole, WrittenChunk, read, unknown, whole};

#[test]
fn the_place_of_the_damage_is_told() {
    let Whole { mut bytes, chunks } = whole();
    let at = chunks[4].at.clone();
    bytes[at.start + 200] ^= 0x40;
    let (recovered, _) = Bench::new().recover(&bytes).unwrap();
    assert_eq!(recovered.damage.len(), 1, "{:?}", recovered.damage);
    // The index behind the chunk is swallowed with it; the next chunk is sound.
    assert_eq!(recovered.damage[0].bytes, at.start as u64..chunks[5].at.start as u64);
    assert!(recovered.ended && recovered.certificate.end_seen);
    let text = &recovered.run.notes["recovered"];
    assert!(text.contains("1.mcap.part") && text.contains(&format!("from byte {} on", at.start)), "{text}");
}

#[test]
fn where_the_file_no_longer_says_what_the_run_is_the_caller_s_words_stand() {
    let Whole { mut bytes, .. } = whole();
    let name = bytes.windows(8).position(|w| w == b"protocol").unwrap();
    bytes[name + 13] ^= 1; // within the word "clamp-steps"
    let (recovered, _) = Bench::new().recover(&bytes).unwrap();
    assert!(!recovered.run_known && recovered.run.name == "lost");
    assert_eq!(recovered.certificate.received, SAMPLES);
    // Without a checksum such a flip would pass for another word.
    assert_eq!(recovered.damage.len(), 1);
}

#[test]
fn a_certificate_that_is_whole_tells_the_length_of_a_run_whose_end_is_damaged() {
    let Whole { mut bytes, chunks } = whole();
    let WrittenChunk { at, items } = chunks.last().unwrap().clone();
    bytes[at.end - 100] ^= 1;
    let (recovered, _) = Bench::new().recover(&bytes).unwrap();
    let lost = items.iter().filter(|item| matches!(item, Item::Sample(_))).count() as u64;
    let first = SAMPLES - lost;
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
    for sample in &(0..2_000).map(skipping).collect::<Vec<_>>() {
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
