//! Small recordings, and the program that reads them.
#![allow(dead_code, reason = "each test binary uses its part")]

use recordings::{
    AmplifierFault, AmplifierReport, Event, McapWriter, Plane, Protocol, Recording, Role, RunMetadata, Severity,
};
use rt_core::{PERIOD_NS, Sample, flags};
use std::path::Path;
use std::process::{Command, Output};

/// Runs the program; exit code, stdout, stderr.
pub fn bench(arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    let Output { status, stdout, stderr } = command.args(arguments).env_remove("RUST_LOG").output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (status.code().unwrap(), text(stdout), text(stderr))
}

/// Runs the program where it must succeed; stdout.
#[track_caller]
pub fn done(arguments: &[&str]) -> String {
    let (code, stdout, stderr) = bench(arguments);
    assert_eq!(code, 0, "{arguments:?}: {stderr}");
    stdout
}

/// Runs the program where it must end with 2 and one message that holds every word.
#[track_caller]
pub fn refused(arguments: &[&str], words: &[&str]) {
    let (code, _, stderr) = bench(arguments);
    assert_eq!(code, 2, "{arguments:?}: {stderr}");
    assert!(stderr.matches("error: ").count() == 1 && !stderr.contains("panicked"), "{stderr}");
    for word in words {
        assert!(stderr.contains(word), "{word:?} is missing in: {stderr}");
    }
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A tick whose values differ from those of every other; torque and volume are missing now and then.
pub fn sample(tick: u64) -> Sample {
    let t = tick as f64 * 1e-3;
    Sample {
        run: 2,
        tick,
        scheduled_ns: tick * PERIOD_NS,
        woken_ns: 5_000_000_000_000 + tick * PERIOD_NS + tick % 11,
        lateness_ns: tick % 11 * 1000,
        voltage_v: 21.6 * (t * 3.0).sin().signum(),
        angle_deg: 30.0 * (t * 2.0).sin(),
        pressure1_bar: 2.8 + (t * 2.1).cos(),
        pressure2_bar: 2.8 - (t * 2.1).cos() / 3.0,
        torque_nm: if tick.is_multiple_of(3) { t / 7.0 } else { f64::NAN },
        volume_ml: if tick.is_multiple_of(100) { t * 10.0 } else { f64::NAN },
        read_ns: (tick % 1009) as u32,
        publish_ns: u32::MAX,
        segment: (tick / 500) as u32,
        step: (tick / 250) as u32,
        quality: 31,
        target: 30.0 * (t * 2.1).sin(),
        target_of: 6,
        flags: if tick % 700 < 350 { flags::BRAKE_OPEN } else { flags::BYPASS_OPEN | flags::SLEW_LIMITED },
        ..Sample::BLANK
    }
}

pub fn event(tick: u64, text: &str) -> Event {
    let severity = [Severity::Info, Severity::Warning, Severity::Error][(tick % 3) as usize];
    Event { tick, scheduled_ns: tick * PERIOD_NS, severity, source: "test".into(), text: text.into() }
}

pub fn report(tick: u64) -> AmplifierReport {
    AmplifierReport {
        tick,
        arrived_ns: tick * PERIOD_NS + 312,
        supply_v: 24.0 + tick as f64 * 1e-4,
        motor_current_a: if tick.is_multiple_of(40) { f64::NAN } else { tick as f64 / 3.0 },
        speed_rpm: -1500.5,
        duty: 0.25,
        temperature_c: 41.125,
        fault: (tick == 20).then(|| AmplifierFault { code: 7, name: "FAULT_CODE_OVER_TEMP_FET".into() }),
    }
}

pub fn metadata(name: &str, protocol: Protocol) -> RunMetadata {
    let mut run = RunMetadata::new(name, protocol, Role::Identify, Plane::Vertical);
    run.profile = "name = \"a\" # <&> \"quoted\"\n".into();
    run.program = "bench 0.1.0 (abc)".into();
    run.host.insert("kernel".into(), "6.18".into());
    run.files.insert("rig.toml".into(), "[rig]\n".into());
    run.notes.insert("device".into(), "emulated & small".into());
    run
}

/// Texts that other formats must get right: commas, quotes, line breaks, letters of two to four bytes, none at all.
pub const TEXTS: [&str; 5] = ["plain", "with, comma and \"quotes\"", "two\nlines", "φ = 20°, 𝜔 < 1 & more", ""];

/// What is left out or changed of a recording.
#[derive(Clone, Copy, Default)]
pub struct Flaws {
    /// Samples that are missing.
    pub gap: Option<(u64, u64)>,
    /// The last sample does not say that it is the last.
    pub no_end: bool,
    /// The supervisor trips here.
    pub trip: Option<u64>,
}

/// Writes a recording with events and the amplifier's reports.
pub fn record(path: &Path, protocol: Protocol, samples: u64, flaws: Flaws) {
    let name = path.file_stem().unwrap().to_str().unwrap();
    let mut writer = McapWriter::create(path, &metadata(name, protocol)).unwrap();
    for tick in 0..samples {
        let lost = flaws.gap.is_some_and(|(first, last)| (first..=last).contains(&tick));
        let mut sample = sample(tick);
        if tick + 1 == samples && !flaws.no_end {
            sample.flags |= flags::LAST;
        }
        if flaws.trip.is_some_and(|trip| trip <= tick) {
            // Pressure 1, above its limit.
            (sample.flags, sample.trip) = (sample.flags | flags::TRIPPED, 1 + 256 * 2);
        }
        if !lost {
            writer.write(&sample).unwrap();
        }
        if tick % 20 == 0 {
            writer.write_amplifier(&report(tick)).unwrap();
        }
        if tick % 400 == 7 {
            writer.write_event(&event(tick, TEXTS[(tick / 400) as usize % TEXTS.len()])).unwrap();
        }
    }
    let mut certificate = writer.certificate(samples);
    certificate.end_seen = !flaws.no_end;
    writer.finish(&certificate).unwrap();
}

/// The bits of every value, so that NaN and -0 count.
pub fn bits(recording: &Recording) -> Vec<Vec<u64>> {
    let Recording { time_s, voltage_v, angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, .. } = recording;
    let numbers = [time_s, voltage_v, angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml];
    let numbers = numbers.map(|column| column.iter().map(|value| value.to_bits()).collect::<Vec<_>>());
    let flags = [&recording.brake_open, &recording.bypass_open];
    let flags = flags.map(|column| column.iter().map(|open| u64::from(*open)).collect::<Vec<_>>());
    let segment = recording.segment.iter().map(|segment| segment.cast_unsigned()).collect::<Vec<_>>();
    numbers.into_iter().chain(flags).chain([segment]).collect()
}

/// campaign.toml of these files.
pub fn campaign(dir: &Path, runs: &[(&str, Protocol)]) {
    let mut toml = "format = 1\nname = \"small\"\n[rig]\nJ = 0.085\nG = 4.0\nu_max = 24.0\n".to_owned();
    for (file, protocol) in runs {
        toml += &format!(
            "[[run]]\nfile = {file:?}\nprotocol = \"{protocol}\"\nrole = \"validate\"\nplane = \"vertical\"\n"
        );
    }
    std::fs::write(dir.join("campaign.toml"), toml).unwrap();
}
