//! What a recording says of samples that are missing: certificates, ticks passed over, a logger that is killed.

use super::common::{assert_says, metadata, sample, skipping, write_mcap};
use super::{folder, read, samples};
use recordings::{AmplifierReport, CampaignError, Item, McapReader, McapWriter};
use rt_core::{LossCertificate, LossTracker, Sample, flags};

#[test]
fn lost_samples_are_certified_and_refused_as_data() {
    let (dir, path) = folder();
    let mut kept = samples(1_000);
    kept.drain(300..310);
    kept.remove(0);
    kept.pop();
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    for sample in &kept {
        writer.write(sample).unwrap();
    }
    let certificate = writer.certificate(1_000);
    let gaps = vec![(0, 0), (300, 309), (999, 999)];
    assert_eq!(certificate, LossCertificate { run: 3, expected: 1_000, received: 988, gaps, end_seen: true });
    writer.finish(&certificate).unwrap();
    assert_says(read(&path), &["tick 0", "988 of 1000 samples", "300..=309", "record it again"]);

    let none = dir.path().join("none.mcap");
    write_mcap(&none, &[], 0);
    assert_says(read(&none), &["none.mcap", "at least one sample"]);
}

#[test]
fn the_subscribers_certificate_is_the_one_that_is_kept() {
    let (_dir, path) = folder();
    let mut tracker = LossTracker::default();
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    let mut kept = samples(100);
    kept.drain(40..42);
    kept.last_mut().unwrap().flags |= flags::LAST;
    for sample in &kept {
        tracker.received(0, sample).unwrap();
        writer.write(sample).unwrap();
    }
    let certificate = tracker.take().unwrap();
    writer.finish(&certificate).unwrap();
    let mut reader = McapReader::open(&path).unwrap();
    assert_eq!(reader.by_ref().count(), 98);
    assert_eq!(reader.certificate(), Some(&certificate));
}

#[test]
fn a_run_whose_end_did_not_arrive_is_refused_as_data() {
    let (_dir, path) = folder();
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    samples(50).iter().for_each(|sample| writer.write(sample).unwrap());
    let certificate = LossCertificate { end_seen: false, ..writer.certificate(50) };
    writer.finish(&certificate).unwrap();
    assert_says(read(&path), &["run.mcap", "without loss", "50 of at least 50", "end of the run"]);
}

#[test]
fn nothing_false_is_signed() {
    let honest = LossCertificate { run: 3, expected: 4, received: 2, gaps: vec![(1, 1), (3, 3)], end_seen: true };
    let claims = [
        LossCertificate { expected: 2, gaps: vec![], ..honest.clone() },
        LossCertificate { received: 4, ..honest.clone() },
        LossCertificate { gaps: vec![(3, 3)], ..honest.clone() },
        LossCertificate { expected: 3, ..honest.clone() },
        LossCertificate { run: 4, ..honest.clone() },
        honest.clone(),
    ];
    for claimed in claims {
        let (dir, path) = folder();
        let mut writer = McapWriter::create(&path, &metadata()).unwrap();
        writer.write(&sample(0)).unwrap();
        writer.write(&sample(2)).unwrap();
        if claimed == honest {
            assert_eq!(writer.finish(&claimed).unwrap(), path);
        } else {
            assert_says(writer.finish(&claimed), &["run.mcap.part", "agrees with what was written", "run 3: 2 of"]);
            assert!(!path.exists() && dir.path().join("run.mcap.part").exists());
        }
    }
}

#[test]
fn ticks_that_the_loop_passed_over_are_no_loss() {
    let (_dir, path) = folder();
    let run: Vec<Sample> = (0..1_000).map(skipping).collect();
    assert!(run[999].skipped > 0 && run[999].tick == 999 + run[999].skipped);
    write_mcap(&path, &run, 1_000);
    let mut reader = McapReader::open(&path).unwrap();
    assert_eq!(reader.by_ref().filter(Result::is_ok).count(), 1_000);
    assert_eq!(reader.certificate().unwrap().to_string(), "1000 of 1000 samples");
    // As columns: the command held until the next row, which is where the loop went on.
    let recording = read(&path).unwrap();
    let times: Vec<f64> = run.iter().map(Sample::time_s).collect();
    assert_eq!(recording.time_s, times);
    assert!(recording.time_s.windows(2).any(|pair| pair[1] - pair[0] > 0.0035), "several ticks at once");
}

#[test]
fn a_lost_sample_is_seen_beside_ticks_that_were_passed_over() {
    let (_dir, path) = folder();
    let mut run: Vec<Sample> = (0..500).map(skipping).collect();
    run.remove(200); // the first after a jump: the next one tells of the jump, and its number of the loss
    write_mcap(&path, &run, 500);
    let mut reader = McapReader::open(&path).unwrap();
    assert_eq!(reader.by_ref().filter(Result::is_ok).count(), 499);
    assert_eq!(reader.certificate().unwrap().gaps, [(200, 200)]);
    assert_says(read(&path), &["499 of 500 samples", "200..=200"]);
}

#[test]
fn ticks_passed_over_never_become_fewer() {
    let (_dir, path) = folder();
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    let at = |tick: u64, skipped: u64| Sample { skipped, ..sample(tick) };
    writer.write(&at(9, 4)).unwrap();
    assert_says(writer.write(&at(12, 3)), &["tick 12", "skipped", "4 to 6 ticks", "got 3"]);
    assert_says(writer.write(&at(12, 7)), &["tick 12", "skipped", "4 to 6 ticks", "got 7"]);
    writer.write(&at(12, 6)).unwrap();
    assert_eq!(writer.certificate(7).gaps, [(0, 4)], "sample 5 stood at tick 9, sample 6 at tick 12");
}

#[test]
fn a_logger_that_is_killed_loses_half_a_second_at_most() {
    let (dir, path) = folder();
    let part = dir.path().join("run.mcap.part");
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    for (written, sample) in samples(3_000).iter().enumerate() {
        writer.write(sample).unwrap();
        if written % 97 == 0 {
            // What the system has of the file at this moment outlives the process.
            let is_sample = |item: &Result<Item, CampaignError>| matches!(item, Ok(Item::Sample(_)));
            let outlives = McapReader::open(&part).unwrap().filter(is_sample).count();
            assert!(written + 1 - outlives <= 500, "{outlives} of {} samples", written + 1);
        }
        // Reports do not put it off, whatever time they tell.
        if written % 250 == 0 {
            writer.write_amplifier(&AmplifierReport { arrived_ns: u64::MAX, ..AmplifierReport::BLANK }).unwrap();
        }
    }
}
