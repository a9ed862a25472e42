//! The runs in `data/format_2.mcap` and `data/sample_3.mcap`, which hold something of everything that format 2 knows. No sines: every value is the same on every
//! machine.

use std::collections::BTreeMap;
use std::path::Path;

use recordings::{
    AmplifierFault, AmplifierReport, Event, Item, McapWriter, Plane, Protocol, Role, RunMetadata, Severity,
};
use rt_core::{Input, PERIOD_NS, Sample, flags};

/// What the run says about itself.
pub fn metadata() -> RunMetadata {
    let named = |texts: &[(&str, &str)]| -> BTreeMap<String, String> {
        texts.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
    };
    RunMetadata {
        profile: "name = \"golden\"\n".to_owned(),
        files: named(&[("rig.toml", "[rig]\nname = \"golden\"\n"), ("rig.dbc", "VERSION \"ä\"\r\n"), ("empty", "")]),
        calibration: "[angle_deg]\nzero = 0.25\n".to_owned(),
        host: named(&[("hostname", "bench-1"), ("cpus", "4")]),
        program: "rec-bench 0.1.0 (0123abcd)".to_owned(),
        notes: named(&[("rig", "emulated"), ("instance", "golden")]),
        ..RunMetadata::new("golden \"2\"", Protocol::ClampSteps, Role::Identify, Plane::Horizontal)
    }
}

/// A run that passes over ticks, waits for a person, is held by its slew limit, trips and is stopped.
pub fn samples(count: u64) -> Vec<Sample> {
    (0..count)
        .map(|number| {
            let skipped: u64 = (1..=number / 50).map(|k| k % 3).sum();
            let tick = number + skipped;
            let scheduled_ns = tick * PERIOD_NS;
            let small = |factor: u64| (tick * factor % 1009) as u32;
            // Eighths: exact.
            let value = |factor: u64| (tick * factor % 769) as f64 / 8.0 - 40.0;
            let mut sample = Sample {
                run: 70_000,
                tick,
                scheduled_ns,
                woken_ns: 5_000_000_000_000 + scheduled_ns + u64::from(small(3)),
                lateness_ns: small(3).into(),
                skipped,
                voltage_v: value(5),
                angle_deg: value(7),
                pressure1_bar: value(11) + 40.5,
                pressure2_bar: if number % 17 == 3 { f64::NAN } else { value(13) + 40.5 },
                torque_nm: f64::NAN,
                volume_ml: if number % 40 == 39 { value(17) } else { f64::NAN },
                age_ns: [small(19) * 1_000, small(23), 0, u32::MAX, 20_000_000],
                heartbeat_age_ns: small(29),
                behind_ns: small(31),
                read_ns: small(37) * 40,
                check_ns: small(41),
                reference_ns: small(43),
                control_ns: small(47),
                write_ns: small(53),
                publish_ns: u32::MAX - small(59),
                segment: (number / 60) as u32,
                step: (number / 30) as u32,
                flags: if number % 90 < 45 { flags::BRAKE_OPEN } else { flags::BYPASS_OPEN },
                ..Sample::BLANK
            };
            sample.quality = sample.measurement().valid();
            if number % 7 == 0 {
                sample.quality |= Input::Pressure1.bit() << 8;
            }
            match number % 80 {
                20..30 => sample.flags |= flags::WAITING,
                30 => sample.flags |= flags::CONFIRMED,
                31..=40 => sample.flags |= flags::SLEW_LIMITED,
                41 => sample.flags |= flags::OVERRUN,
                43 => sample.flags |= flags::FAULT | 1 << 30,
                _ => {}
            }
            if number + 10 >= count {
                (sample.flags, sample.trip) = (flags::TRIPPED | flags::STOPPED, 2 << 8 | 3);
            }
            if number + 1 == count {
                sample.flags |= flags::LAST;
            }
            sample
        })
        .collect()
}

/// The same run with samples of version 3: every kind of target, and ticks without one.
pub fn samples_3(count: u64) -> Vec<Sample> {
    let mut samples = samples(count);
    for (number, sample) in samples.iter_mut().enumerate() {
        sample.target_of = (number / 25 % 7) as u32;
        if sample.target_of != 0 {
            // Eighths: exact; 0 and both signs occur.
            sample.target = ((number * 7) % 400) as f64 / 8.0 - 25.0;
        }
    }
    samples
}

/// Events before samples of the run.
pub fn events() -> Vec<Event> {
    let event = |tick: u64, severity, source: &str, text: &str| Event {
        tick,
        scheduled_ns: tick * PERIOD_NS,
        severity,
        source: source.to_owned(),
        text: text.to_owned(),
    };
    vec![
        event(0, Severity::Info, "loop", ""),
        event(20, Severity::Warning, "operator", "asked: \"release 1 ml\""),
        event(20, Severity::Error, "device", "gone; 20 °C"),
    ]
}

/// Reports of the amplifier before samples of the run.
pub fn amplifier() -> Vec<AmplifierReport> {
    let at = |tick: u64| AmplifierReport { tick, arrived_ns: tick * PERIOD_NS + 123, ..AmplifierReport::BLANK };
    let fault = |code, name: &str| Some(AmplifierFault { code, name: name.to_owned() });
    vec![
        AmplifierReport {
            supply_v: 24.125,
            motor_current_a: -3.5,
            speed_rpm: 1_250.0,
            duty: -0.25,
            temperature_c: 41.5,
            ..at(10)
        },
        AmplifierReport { supply_v: 0.0, fault: fault(2, "under voltage"), ..at(20) },
        AmplifierReport { fault: fault(0, ""), ..at(30) },
        at(40),
    ]
}

/// Events and reports in the order in which they are written.
pub fn written() -> Vec<Item> {
    let mut items: Vec<(u64, Item)> = events().into_iter().map(|event| (event.tick, Item::Event(event))).collect();
    items.extend(amplifier().into_iter().map(|report| (report.tick, Item::Amplifier(report))));
    items.sort_by_key(|(tick, _)| *tick); // a stable sort: events come first
    items.into_iter().map(|(_, item)| item).collect()
}

/// Writes the run with samples of version 3: events and reports before the first sample that is not earlier.
pub fn write(path: &Path, count: u64) {
    let mut writer = McapWriter::create(path, &metadata()).unwrap();
    let mut others = written().into_iter().peekable();
    for sample in samples_3(count) {
        let due = |item: &Item| match item {
            Item::Event(event) => event.tick <= sample.tick,
            Item::Amplifier(report) => report.tick <= sample.tick,
            Item::Sample(_) => false,
        };
        while let Some(item) = others.next_if(due) {
            match item {
                Item::Event(event) => writer.write_event(&event).unwrap(),
                Item::Amplifier(report) => writer.write_amplifier(&report).unwrap(),
                Item::Sample(_) => {}
            }
        }
        writer.write(&sample).unwrap();
    }
    let certificate = writer.certificate(count);
    writer.finish(&certificate).unwrap();
}
