//! A disk that runs full while a run is recorded. The limit on the size of files stands for it: it belongs to the whole
//! process, hence one test in a process of its own.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;

use common::{metadata, sample, sample_bits};
use recordings::{CampaignError, Item, McapReader, McapWriter, Recording, recover};

fn limit_file_size(bytes: u64) {
    let limit = libc::rlimit { rlim_cur: bytes, rlim_max: libc::RLIM_INFINITY };
    // SAFETY: plain system calls; the process has one test, whose thread expects what they do.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        assert_eq!(libc::setrlimit(libc::RLIMIT_FSIZE, &raw const limit), 0);
    }
}

const SAMPLES: u64 = 3_000;

#[test]
fn whatever_the_room_the_complete_chunks_stay_readable() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, chunk_end) = {
        let path = dir.path().join("whole.mcap");
        common::write_mcap(&path, &(0..SAMPLES).map(sample).collect::<Vec<_>>(), SAMPLES);
        let bytes = fs::read(path).unwrap();
        let chunk = &mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes[2];
        (bytes.len() as u64, chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length)
    };
    let mut seen = [false; 4];
    // Limits all over the file, where a chunk leaves no room for the shortest end, and every few bytes at the end of the file, where
    // the certificate and the index are written.
    let limits = (300..whole).step_by(whole as usize / 60).chain((whole.saturating_sub(6_000)..whole).step_by(150));
    let limits = limits.chain((chunk_end..chunk_end + 200).step_by(40));
    for limit in limits {
        let path = dir.path().join(format!("{limit}.mcap"));
        let part = dir.path().join(format!("{limit}.mcap.part"));
        limit_file_size(limit);
        let outcome = record(&path);
        limit_file_size(libc::RLIM_INFINITY);
        match outcome {
            // Not even room for the beginning: nothing is left behind.
            Err((CampaignError::Write { .. }, _)) => {
                assert!(limit < 6_000 && !path.exists() && !part.exists(), "limit {limit}");
                seen[0] = true;
            }
            // The samples found room, the index did not: the recording is whole.
            Ok(()) => {
                assert_eq!(Recording::read(&path, metadata().protocol).unwrap().len() as u64, SAMPLES, "limit {limit}");
                seen[1] = true;
            }
            Err((CampaignError::CutShort(cut), appended)) => {
                assert!(
                    appended - cut.certificate.received < 1_100,
                    "limit {limit}: {} of {appended} samples",
                    cut.certificate.received
                );
                let message = cut.to_string();
                assert!(message.contains("File too large") && message.contains("make room"), "{message}");
                assert!(message.contains(&cut.file.display().to_string()), "{message}");
                if cut.closed {
                    assert!(cut.file == path && !part.exists(), "limit {limit}");
                    seen[2] = true;
                } else {
                    assert!(cut.file == part && !path.exists(), "limit {limit}");
                    recover(&part, &path, &metadata()).unwrap();
                    seen[3] = true;
                }
                let whole_run = cut.of_run(SAMPLES);
                // Where every sample found room and not even the shortest end did, nothing is missing but the certificate.
                let first = cut.certificate.received;
                let missing = if first < SAMPLES { vec![(first, SAMPLES - 1)] } else { vec![] };
                assert!(whole_run.gaps == missing && whole_run.expected == SAMPLES && whole_run.end_seen);
                check(&path, cut.certificate.received, cut.closed);
            }
            Err((other, _)) => panic!("limit {limit}: {other}"),
        }
    }
    assert_eq!(seen, [true; 4], "each way out was met");
}

/// Records the run; on failure also how many samples had been appended. Once refused, always refused.
fn record(path: &std::path::Path) -> Result<(), (CampaignError, u64)> {
    let mut writer = McapWriter::create(path, &metadata()).map_err(|error| (error, 0))?;
    for tick in 0..SAMPLES {
        if let Err(error) = writer.write(&sample(tick)) {
            let again = writer.write(&sample(tick)).expect_err("it was refused before");
            assert_eq!(again.to_string(), error.to_string());
            let CampaignError::CutShort(cut) = &error else { panic!("{error}") };
            assert_eq!(writer.cut_short(), Some(cut));
            let certificate = writer.certificate(tick);
            let finished = writer.finish(&certificate).expect_err("it was refused before");
            assert_eq!(finished.to_string(), error.to_string());
            return Err((error, tick));
        }
    }
    let certificate = writer.certificate(SAMPLES);
    writer.finish(&certificate).map(drop).map_err(|error| (error, SAMPLES))
}

/// The first `samples` samples are there as they were, certified as the beginning of a run without end.
fn check(path: &std::path::Path, samples: u64, with_event: bool) {
    let mut reader = McapReader::open(path).unwrap();
    let items: Vec<Item> = reader.by_ref().map(|item| item.unwrap()).collect();
    let read = items.iter().filter_map(|item| if let Item::Sample(sample) = item { Some(sample) } else { None });
    let read: Vec<_> = read.collect();
    assert_eq!(read.len() as u64, samples);
    for (tick, read) in read.iter().enumerate() {
        assert_eq!(sample_bits(read), sample_bits(&sample(tick as u64)));
    }
    let said = items.iter().any(|item| matches!(item, Item::Event(event) if event.text.contains("File too large")));
    assert_eq!(said, with_event, "the recording says why it ends");
    let certificate = reader.certificate().unwrap();
    assert!(!certificate.end_seen && certificate.received == samples && certificate.gaps.is_empty(), "{certificate}");
    assert!(Recording::read(path, metadata().protocol).is_err(), "a run without end is no data");
}
