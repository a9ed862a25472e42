//! One tracked recording of each version of the format and of the sample, every value compared. None of them is ever written anew.

#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use std::path::{Path, PathBuf};

use common::{golden, metadata, sample, sample_bits, skipping};
use recordings::{Event, Item, McapReader, Recording, RunMetadata, Severity};
use rt_core::{Input, LossCertificate, Sample, flags};

struct Read {
    run: RunMetadata,
    samples: Vec<Sample>,
    others: Vec<Item>,
    certificate: LossCertificate,
}

fn tracked(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn read(name: &str) -> Read {
    let mut reader = McapReader::open(&tracked(name)).unwrap();
    let (mut samples, mut others) = (Vec::new(), Vec::new());
    for item in reader.by_ref() {
        match item.unwrap() {
            Item::Sample(sample) => samples.push(sample),
            other @ (Item::Event(_) | Item::Amplifier(_)) => others.push(other),
        }
    }
    Read { run: reader.run().clone(), samples, others, certificate: reader.certificate().unwrap().clone() }
}

/// Every value, those of the made-up run's sine to 1e-9: it may round otherwise on another machine.
fn assert_same(read: &[Sample], written: &[Sample]) {
    assert_eq!(read.len(), written.len());
    for (read, written) in read.iter().zip(written) {
        let rounded = |sample: &Sample| {
            let zero = |value: f64| if value.is_nan() { f64::NAN } else { 0.0 };
            let [angle_deg, pressure1_bar, pressure2_bar, torque_nm] =
                [sample.angle_deg, sample.pressure1_bar, sample.pressure2_bar, sample.torque_nm].map(zero);
            Sample { angle_deg, pressure1_bar, pressure2_bar, torque_nm, ..*sample }
        };
        assert_eq!(sample_bits(&rounded(read)), sample_bits(&rounded(written)), "tick {}", written.tick);
        for (read, written) in [
            (read.angle_deg, written.angle_deg),
            (read.pressure1_bar, written.pressure1_bar),
            (read.pressure2_bar, written.pressure2_bar),
            (read.torque_nm, written.torque_nm),
        ] {
            assert!(written.is_nan() || (read - written).abs() < 1e-9, "{read} instead of {written}");
        }
    }
}

/// Written by the first version of format 1, with samples of version 1.
#[test]
fn format_1_with_samples_of_version_1() {
    let Read { run, samples, others, certificate } = read("format_1.mcap");
    assert_eq!((run, others), (metadata(), vec![]));
    let known = |tick: u64| {
        let mut known = sample(tick);
        let Sample { run, tick, scheduled_ns, lateness_ns, segment, voltage_v, flags, .. } = known;
        let Sample { angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, .. } = known;
        known = Sample { run, tick, scheduled_ns, lateness_ns, segment, voltage_v, flags, ..Sample::BLANK };
        known = Sample { angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, ..known };
        // The rest version 1 did not know; these follow from what it did.
        Sample { quality: known.measurement().valid(), ..known }
    };
    assert_same(&samples, &(0..20).map(known).collect::<Vec<_>>());
    assert_eq!(certificate, LossCertificate { run: 3, expected: 20, received: 20, gaps: vec![], end_seen: true });
}

/// Written when samples of version 2 came: ticks that were passed over, a slew limit, a trip and its aftermath.
#[test]
fn format_1_with_samples_of_version_2() {
    let Read { run, samples, others, certificate } = read("sample_2.mcap");
    assert_eq!(run, metadata());
    let event = Event {
        tick: 219,
        scheduled_ns: 219_000_000,
        severity: Severity::Error,
        source: "test".to_owned(),
        text: "the golden run is over".to_owned(),
    };
    assert_eq!(others, [Item::Event(event)]);
    let written = |number: u64| {
        let mut sample = skipping(number);
        let small = |factor: u64| (sample.tick * factor % 1009) as u32;
        sample.age_ns = [small(3), small(5), 0, small(7), 5_000_000];
        sample.quality |= Input::Pressure1.bit() << 8;
        if number >= 210 {
            sample.flags = flags::BYPASS_OPEN | flags::TRIPPED | flags::OVERRUN;
            (sample.voltage_v, sample.trip) = (0.0, 2 << 8 | 3);
        } else if number % 10 == 7 {
            sample.flags |= flags::SLEW_LIMITED;
        }
        if number == 219 {
            sample.flags |= flags::LAST | flags::STOPPED;
        }
        sample
    };
    assert_same(&samples, &(0..220).map(written).collect::<Vec<_>>());
    assert_eq!(certificate, LossCertificate { run: 3, expected: 220, received: 220, gaps: vec![], end_seen: true });
}

/// Written when format 2 came.
#[test]
fn format_2() {
    assert_is_golden("format_2.mcap", &golden::samples(400));
}

/// Written when samples of version 3 came: targets of every kind.
#[test]
fn format_2_with_samples_of_version_3() {
    assert_is_golden("sample_3.mcap", &golden::samples_3(400));
}

fn assert_is_golden(name: &str, written: &[Sample]) {
    let Read { run, samples, others, certificate } = read(name);
    assert_eq!(run, golden::metadata());
    assert_eq!(samples.len(), written.len());
    for (read, written) in samples.iter().zip(written) {
        assert_eq!(sample_bits(read), sample_bits(written), "tick {}", written.tick);
    }
    let written = golden::written();
    assert_eq!(others.len(), written.len());
    for (read, written) in others.iter().zip(&written) {
        // As text, where NaN is NaN.
        assert_eq!(format!("{read:?}"), format!("{written:?}"));
    }
    assert_eq!(
        certificate,
        LossCertificate { run: 70_000, expected: 400, received: 400, gaps: vec![], end_seen: true }
    );
    assert_eq!(Recording::read(&tracked(name), run.protocol).unwrap().len(), 400);
}
