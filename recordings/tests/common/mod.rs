//! Made-up runs for the tests. No physics: what is tested is that bytes and samples agree.
#![allow(dead_code)] // each test binary uses its part

pub mod golden;

use std::collections::BTreeMap;

use recordings::{McapWriter, Plane, Protocol, Recording, Role, RunMetadata};
use rt_core::{Sample, Tick, flags};

/// A header and rows of the contract, all values present.
pub fn csv_text(rows: usize) -> String {
    let mut text = String::from(
        "time_s,voltage_v,angle_deg,pressure1_bar,pressure2_bar,torque_nm,volume_ml,brake_open,bypass_open,segment\n",
    );
    for row in 0..rows {
        let time = row as f64 * 0.001;
        text += &format!("{time:.3},12.5,-3.25,2.5,2.75,1.5,0.25,1,0,{}\n", row / 4);
    }
    text
}

/// `csv_text` with one field (line from 1, column from 0) replaced.
pub fn csv_with(rows: usize, line: usize, column: usize, field: &str) -> String {
    let text = csv_text(rows);
    let mut lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    lines[line - 1][column] = field;
    lines.iter().map(|fields| fields.join(",") + "\n").collect()
}

/// A tick of a made-up run in real time: values that change every tick, with gaps in torque and volume.
pub fn sample(tick: u64) -> Sample {
    let now = Tick::at(tick);
    let wave = (tick as f64 * 0.013).sin();
    let noise = ((tick * 2_654_435_761) % 10_007) as f64 / 10_007.0 - 0.5;
    let small = |factor: u64| (tick * factor % 1009) as u32;
    let mut sample = Sample {
        run: 3,
        tick,
        scheduled_ns: now.scheduled_ns,
        woken_ns: 1_000_000_000_000 + now.scheduled_ns + tick % 7,
        lateness_ns: tick % 7,
        // Measured at the tick itself: the columns are then those of the samples. Ages have their own tests.
        age_ns: [0; 5],
        heartbeat_age_ns: small(11),
        behind_ns: small(13) % 5,
        read_ns: small(17),
        check_ns: small(19),
        reference_ns: small(23),
        control_ns: small(29),
        write_ns: small(31),
        publish_ns: small(37),
        step: (tick / 250) as u32,
        voltage_v: 21.6 * wave.signum(),
        angle_deg: 30.0 * wave + 0.01 * noise,
        pressure1_bar: 2.7 + wave + 0.005 * noise,
        pressure2_bar: 2.7 - wave - 0.005 * noise,
        torque_nm: if tick.is_multiple_of(3) { 5.0 * wave } else { f64::NAN },
        volume_ml: if tick.is_multiple_of(250) { 0.5 * tick as f64 } else { f64::NAN },
        segment: (tick / 500) as u32,
        flags: if wave > 0.0 { flags::BRAKE_OPEN } else { flags::BYPASS_OPEN },
        ..Sample::BLANK
    };
    sample.quality = sample.measurement().valid();
    sample
}

/// The made-up run where the loop passed over some ticks after every 100th.
pub fn skipping(number: u64) -> Sample {
    let skipped: u64 = (1..=number / 100).map(|k| k % 5).sum();
    Sample { skipped, ..sample(number + skipped) }
}

/// What the made-up run says about itself.
pub fn metadata() -> RunMetadata {
    RunMetadata {
        profile: "[profile]\nname = \"square\"\n".to_owned(),
        notes: BTreeMap::from([("rig".to_owned(), "emulated".to_owned())]),
        ..RunMetadata::new("square \"h\"", Protocol::SquareWave, Role::Validate, Plane::Vertical)
    }
}

/// Writes `samples` to `path` and closes the recording; `published` samples are said to have been sent.
pub fn write_mcap(path: &std::path::Path, samples: &[Sample], published: u64) {
    let mut writer = McapWriter::create(path, &metadata()).unwrap();
    samples.iter().for_each(|sample| writer.write(sample).unwrap());
    let certificate = writer.certificate(published);
    writer.finish(&certificate).unwrap();
}

/// The columns as bits, so that NaN equals NaN and 0.0 does not equal -0.0.
pub fn bits(recording: &Recording) -> Vec<Vec<u64>> {
    let columns = [
        &recording.time_s,
        &recording.voltage_v,
        &recording.angle_deg,
        &recording.pressure1_bar,
        &recording.pressure2_bar,
        &recording.torque_nm,
        &recording.volume_ml,
    ];
    let canonical = |value: &f64| if value.is_nan() { u64::MAX } else { value.to_bits() };
    let mut bits: Vec<Vec<u64>> = columns.iter().map(|column| column.iter().map(canonical).collect()).collect();
    bits.push(recording.brake_open.iter().map(|&open| u64::from(open)).collect());
    bits.push(recording.bypass_open.iter().map(|&open| u64::from(open)).collect());
    bits.push(recording.segment.iter().map(|&segment| segment.cast_unsigned()).collect());
    bits
}

/// A sample as bits; NaN equals NaN.
pub fn sample_bits(sample: &Sample) -> Vec<u64> {
    let bits = |value: f64| if value.is_nan() { u64::MAX } else { value.to_bits() };
    let Sample {
        version,
        run,
        tick,
        scheduled_ns,
        woken_ns,
        lateness_ns,
        skipped,
        voltage_v,
        angle_deg,
        pressure1_bar,
        pressure2_bar,
        torque_nm,
        volume_ml,
        age_ns,
        heartbeat_age_ns,
        behind_ns,
        read_ns,
        check_ns,
        reference_ns,
        control_ns,
        write_ns,
        publish_ns,
        segment,
        step,
        flags,
        quality,
        trip,
        target,
        target_of,
        reserved,
    } = *sample;
    let wide = [tick, scheduled_ns, woken_ns, lateness_ns, skipped];
    let values = [voltage_v, angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, target].map(bits);
    let stages = [read_ns, check_ns, reference_ns, control_ns, write_ns, publish_ns];
    let others = [version, run, heartbeat_age_ns, behind_ns, segment, step, flags, quality, trip, target_of, reserved];
    let small = age_ns.into_iter().chain(stages).chain(others).map(u64::from);
    wide.into_iter().chain(values).chain(small).collect()
}

/// The message of an error, which must hold each of these.
pub fn assert_says<T: std::fmt::Debug>(result: Result<T, recordings::CampaignError>, parts: &[&str]) -> String {
    let message = result.expect_err("this input is bad").to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
    message
}
