//! The words of an MCAP recording: topics, schemas, metadata records, and messages to and from the boundary types.
//! Normative text: `FORMAT.md`.

use std::collections::BTreeMap;
use std::str::FromStr;

use prost::Message;
use rt_core::{LossCertificate, SAMPLE_VERSION, Sample, flags};

use crate::run_metadata::{AmplifierFault, AmplifierReport, Event, RunMetadata, Severity};
use crate::sample_message::{self, FLAG_FIELDS};
use crate::vocabulary::UnknownWord;

mod proto {
    include!(concat!(env!("OUT_DIR"), "/rec_bench.v1.rs"));
}

/// The descriptor set of `proto/`, which is the schema of both topics.
pub(crate) const SCHEMA: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/rec_bench.fds"));
pub(crate) const ENCODING: &str = "protobuf";
pub(crate) const SAMPLE_TOPIC: &str = "/rig/sample";
pub(crate) const SAMPLE_SCHEMA: &str = "rec_bench.v1.RigSample";
pub(crate) const EVENT_TOPIC: &str = "/events";
pub(crate) const EVENT_SCHEMA: &str = "rec_bench.v1.Event";
pub(crate) const AMPLIFIER_TOPIC: &str = "/amplifier";
pub(crate) const AMPLIFIER_SCHEMA: &str = "rec_bench.v1.AmplifierReport";
/// Numbers of the channels, for a file whose own list is damaged.
pub(crate) const SAMPLE_CHANNEL: u16 = 1;
pub(crate) const EVENT_CHANNEL: u16 = 2;
pub(crate) const AMPLIFIER_CHANNEL: u16 = 3;

/// Names of the metadata records.
pub(crate) const RUN_RECORD: &str = "rec_bench.run";
pub(crate) const LOSS_RECORD: &str = "rec_bench.loss";

/// Version of the recording format: what `rec_bench.run` says under `format`.
pub(crate) const FORMAT: &str = "2";
/// The versions that are read.
const READ_FORMATS: [&str; 2] = ["1", FORMAT];

/// Field of both metadata records that proves the others: they stand outside of the chunks and their checksums.
const CHECK: &str = "crc32";

/// Notes stand in `rec_bench.run` under their name with this before it.
const NOTE: &str = "note.";
/// Texts of files, likewise.
const FILE: &str = "file.";
/// Facts of the machine, likewise.
const HOST: &str = "host.";

/// Layouts of the sample that are read. The first knew no skipped ticks, one age for all values, and no reason of a trip; the second
/// no target.
const READ_VERSIONS: std::ops::RangeInclusive<u32> = 1..=SAMPLE_VERSION;

/// Replaces `bytes` by the message of this sample.
pub(crate) fn encode_sample(sample: &Sample, bytes: &mut Vec<u8>) {
    let message = proto::RigSample {
        version: sample.version,
        run: sample.run,
        tick: sample.tick,
        scheduled_ns: sample.scheduled_ns,
        lateness_ns: sample.lateness_ns,
        input_age_ns: 0,
        segment: sample.segment,
        voltage_v: Some(sample.voltage_v),
        angle_deg: Some(plain(sample.angle_deg)),
        pressure1_bar: Some(plain(sample.pressure1_bar)),
        pressure2_bar: Some(plain(sample.pressure2_bar)),
        torque_nm: Some(plain(sample.torque_nm)),
        volume_ml: Some(plain(sample.volume_ml)),
        brake_open: sample.brake_open(),
        bypass_open: sample.bypass_open(),
        tripped: sample.tripped(),
        last: sample.last(),
        fault: sample.fault(),
        other_flags: sample.flags & !FLAG_FIELDS,
        woken_ns: sample.woken_ns,
        skipped: sample.skipped,
        age_ns: sample.age_ns.to_vec(),
        heartbeat_age_ns: sample.heartbeat_age_ns,
        behind_ns: sample.behind_ns,
        read_ns: sample.read_ns,
        check_ns: sample.check_ns,
        reference_ns: sample.reference_ns,
        control_ns: sample.control_ns,
        write_ns: sample.write_ns,
        publish_ns: sample.publish_ns,
        step: sample.step,
        quality: sample.quality,
        trip: sample.trip,
        overrun: sample.overrun(),
        stopped: sample.flags & flags::STOPPED != 0,
        slew_limited: sample.flags & flags::SLEW_LIMITED != 0,
        waiting: sample.flags & flags::WAITING != 0,
        confirmed: sample.flags & flags::CONFIRMED != 0,
        target: (!sample.target.is_nan()).then_some(sample.target),
        target_of: sample.target_of,
    };
    bytes.clear();
    message.encode(bytes).expect("a Vec grows as far as a message needs");
}

/// One NaN for all: its sign and payload depend on the machine, and the same run must give the same bytes.
fn plain(value: f64) -> f64 {
    if value.is_nan() { f64::NAN } else { value }
}

/// As [`decode_sample`] of the first `length` bytes of `window`, but as fast as the message allows.
#[inline]
pub(crate) fn decode_sample_in(window: &[u8], length: usize, sample: &mut Sample) -> Result<(), String> {
    if !sample_message::decode(window, length, sample) {
        *sample = decode_sample(window.get(..length).unwrap_or_default())?;
    }
    Ok(())
}

/// The sample of a message, or what is wrong with it.
pub(crate) fn decode_sample(bytes: &[u8]) -> Result<Sample, String> {
    let message = proto::RigSample::decode(bytes).map_err(|error| error.to_string())?;
    if !READ_VERSIONS.contains(&message.version) {
        return Err(format!("a sample of version {}", message.version));
    }
    let age_ns = match (message.version, message.age_ns.as_slice()) {
        (1, _) => [u32::try_from(message.input_age_ns).unwrap_or(u32::MAX); 5],
        (_, ages) => ages.try_into().map_err(|_| format!("{} ages of the inputs, expected 5", ages.len()))?,
    };
    let bit = |set: bool, bit: u32| if set { bit } else { 0 };
    let mut sample = Sample {
        version: SAMPLE_VERSION,
        run: message.run,
        tick: message.tick,
        scheduled_ns: message.scheduled_ns,
        lateness_ns: message.lateness_ns,
        woken_ns: message.woken_ns,
        skipped: message.skipped,
        age_ns,
        heartbeat_age_ns: message.heartbeat_age_ns,
        behind_ns: message.behind_ns,
        read_ns: message.read_ns,
        check_ns: message.check_ns,
        reference_ns: message.reference_ns,
        control_ns: message.control_ns,
        write_ns: message.write_ns,
        publish_ns: message.publish_ns,
        step: message.step,
        quality: message.quality,
        trip: message.trip,
        voltage_v: message.voltage_v.unwrap_or(f64::NAN),
        angle_deg: message.angle_deg.unwrap_or(f64::NAN),
        pressure1_bar: message.pressure1_bar.unwrap_or(f64::NAN),
        pressure2_bar: message.pressure2_bar.unwrap_or(f64::NAN),
        torque_nm: message.torque_nm.unwrap_or(f64::NAN),
        volume_ml: message.volume_ml.unwrap_or(f64::NAN),
        target: message.target.unwrap_or(f64::NAN),
        target_of: message.target_of,
        reserved: 0,
        segment: message.segment,
        flags: (message.other_flags & !FLAG_FIELDS)
            | bit(message.brake_open, flags::BRAKE_OPEN)
            | bit(message.bypass_open, flags::BYPASS_OPEN)
            | bit(message.tripped, flags::TRIPPED)
            | bit(message.last, flags::LAST)
            | bit(message.fault, flags::FAULT)
            | bit(message.overrun, flags::OVERRUN)
            | bit(message.stopped, flags::STOPPED)
            | bit(message.slew_limited, flags::SLEW_LIMITED)
            | bit(message.waiting, flags::WAITING)
            | bit(message.confirmed, flags::CONFIRMED),
    };
    if message.version == 1 {
        sample.quality = sample.measurement().valid();
    }
    sample.in_range().map_err(|beyond| beyond.to_string())?;
    Ok(sample)
}

/// The message of this event.
pub(crate) fn encode_event(event: &Event) -> Vec<u8> {
    let severity = match event.severity {
        Severity::Info => proto::event::Severity::Info,
        Severity::Warning => proto::event::Severity::Warning,
        Severity::Error => proto::event::Severity::Error,
    };
    proto::Event {
        tick: event.tick,
        scheduled_ns: event.scheduled_ns,
        severity: severity.into(),
        source: event.source.clone(),
        text: event.text.clone(),
    }
    .encode_to_vec()
}

/// The event of a message, or what is wrong with it.
pub(crate) fn decode_event(bytes: &[u8]) -> Result<Event, String> {
    let message = proto::Event::decode(bytes).map_err(|error| error.to_string())?;
    let severity = match proto::event::Severity::try_from(message.severity) {
        Ok(proto::event::Severity::Info) => Severity::Info,
        Ok(proto::event::Severity::Warning) => Severity::Warning,
        Ok(proto::event::Severity::Error) => Severity::Error,
        Err(_) => return Err(format!("an event of severity {}", message.severity)),
    };
    let proto::Event { tick, scheduled_ns, source, text, .. } = message;
    Ok(Event { tick, scheduled_ns, severity, source, text })
}

/// The message of this report.
pub(crate) fn encode_amplifier(report: &AmplifierReport) -> Vec<u8> {
    let told = |value: f64| (!value.is_nan()).then_some(value);
    proto::AmplifierReport {
        tick: report.tick,
        arrived_ns: report.arrived_ns,
        supply_v: told(report.supply_v),
        motor_current_a: told(report.motor_current_a),
        speed_rpm: told(report.speed_rpm),
        duty: told(report.duty),
        temperature_c: told(report.temperature_c),
        fault_code: report.fault.as_ref().map(|fault| fault.code),
        fault_name: report.fault.as_ref().map_or_else(String::new, |fault| fault.name.clone()),
    }
    .encode_to_vec()
}

/// The report of a message, or what is wrong with it.
pub(crate) fn decode_amplifier(bytes: &[u8]) -> Result<AmplifierReport, String> {
    let message = proto::AmplifierReport::decode(bytes).map_err(|error| error.to_string())?;
    let told = |value: Option<f64>| value.unwrap_or(f64::NAN);
    Ok(AmplifierReport {
        tick: message.tick,
        arrived_ns: message.arrived_ns,
        supply_v: told(message.supply_v),
        motor_current_a: told(message.motor_current_a),
        speed_rpm: told(message.speed_rpm),
        duty: told(message.duty),
        temperature_c: told(message.temperature_c),
        fault: message.fault_code.map(|code| AmplifierFault { code, name: message.fault_name }),
    })
}

/// The fields of the record `rec_bench.run`.
pub(crate) fn run_fields(run: &RunMetadata) -> BTreeMap<String, String> {
    let fields = [
        ("format", FORMAT),
        ("name", run.name.as_str()),
        ("protocol", run.protocol.as_str()),
        ("role", run.role.as_str()),
        ("plane", run.plane.as_str()),
        ("profile", run.profile.as_str()),
        ("calibration", run.calibration.as_str()),
        ("program", run.program.as_str()),
    ];
    let named = [(FILE, &run.files), (HOST, &run.host), (NOTE, &run.notes)];
    let named = named
        .into_iter()
        .flat_map(|(kind, texts)| texts.iter().map(move |(name, text)| (format!("{kind}{name}"), text.clone())));
    let fields = fields.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned()));
    proven(fields.chain(named).collect())
}

/// The fields with the checksum that proves them.
fn proven(mut fields: BTreeMap<String, String>) -> BTreeMap<String, String> {
    fields.insert(CHECK.to_owned(), checksum(&fields));
    fields
}

/// CRC-32 of keys and values, each ended by a zero byte, in the order of the keys; hexadecimal.
fn checksum(fields: &BTreeMap<String, String>) -> String {
    let mut crc = crc32fast::Hasher::new();
    for text in fields.iter().filter(|(key, _)| *key != CHECK).flat_map(|(key, value)| [key, value]) {
        crc.update(text.as_bytes());
        crc.update(&[0]);
    }
    format!("{:08x}", crc.finalize())
}

/// Whether the fields carry a checksum at all (files of the first version do not); one that does not fit is an error.
pub(crate) fn is_proven(fields: &BTreeMap<String, String>) -> Result<bool, BadField> {
    let Some(said) = fields.get(CHECK) else { return Ok(false) };
    let found = checksum(fields);
    if *said == found {
        return Ok(true);
    }
    Err(BadField { key: CHECK, expected: format!("the checksum of the fields, {found}"), got: format!("{said:?}") })
}

/// A metadata record that does not say what it has to: the key, what is expected, what came.
pub(crate) struct BadField {
    pub key: &'static str,
    pub expected: String,
    pub got: String,
}

fn field<'f>(fields: &'f BTreeMap<String, String>, key: &'static str) -> Result<&'f str, BadField> {
    fields.get(key).map(String::as_str).ok_or_else(|| BadField {
        key,
        expected: format!("the metadata field \"{key}\""),
        got: "none".to_owned(),
    })
}

/// The run that the record `rec_bench.run` describes.
pub(crate) fn run_of(fields: &BTreeMap<String, String>) -> Result<RunMetadata, BadField> {
    is_proven(fields)?;
    let format = field(fields, "format")?;
    if !READ_FORMATS.contains(&format) {
        return Err(BadField { key: "format", expected: READ_FORMATS.join(" or "), got: format!("{format:?}") });
    }
    // The first version knew neither.
    let since_2 = |key: &'static str| if format == "1" { Ok("") } else { field(fields, key) };
    let named = |kind: &str| {
        let name = |(key, text): (&String, &String)| Some((key.strip_prefix(kind)?.to_owned(), text.clone()));
        fields.iter().filter_map(name).collect()
    };
    let bad = |key: &'static str| {
        move |word: UnknownWord| BadField { key, expected: word.allowed, got: format!("{:?}", word.got) }
    };
    Ok(RunMetadata {
        name: field(fields, "name")?.to_owned(),
        protocol: field(fields, "protocol")?.parse().map_err(bad("protocol"))?,
        role: field(fields, "role")?.parse().map_err(bad("role"))?,
        plane: field(fields, "plane")?.parse().map_err(bad("plane"))?,
        profile: field(fields, "profile")?.to_owned(),
        files: named(FILE),
        calibration: since_2("calibration")?.to_owned(),
        host: named(HOST),
        program: since_2("program")?.to_owned(),
        notes: named(NOTE),
    })
}

/// The fields of the record `rec_bench.loss`; gaps as `FIRST-LAST`, separated by blanks.
pub(crate) fn loss_fields(certificate: &LossCertificate) -> BTreeMap<String, String> {
    let gaps: Vec<_> = certificate.gaps.iter().map(|(first, last)| format!("{first}-{last}")).collect();
    proven(BTreeMap::from([
        ("run".to_owned(), certificate.run.to_string()),
        ("expected".to_owned(), certificate.expected.to_string()),
        ("received".to_owned(), certificate.received.to_string()),
        ("gaps".to_owned(), gaps.join(" ")),
        ("end_seen".to_owned(), certificate.end_seen.to_string()),
    ]))
}

/// The certificate that the record `rec_bench.loss` holds.
pub(crate) fn loss_of(fields: &BTreeMap<String, String>) -> Result<LossCertificate, BadField> {
    fn parsed<T: FromStr>(fields: &BTreeMap<String, String>, key: &'static str, what: &str) -> Result<T, BadField> {
        let text = field(fields, key)?;
        text.parse().map_err(|_| BadField { key, expected: what.to_owned(), got: format!("{text:?}") })
    }
    let gap = |text: &str| {
        let ends = text.split_once('-').and_then(|(first, last)| Some((first.parse().ok()?, last.parse().ok()?)));
        ends.filter(|(first, last)| first <= last).ok_or_else(|| BadField {
            key: "gaps",
            expected: "gaps as FIRST-LAST".to_owned(),
            got: format!("{text:?}"),
        })
    };
    is_proven(fields)?;
    Ok(LossCertificate {
        run: parsed(fields, "run", "a whole number")?,
        expected: parsed(fields, "expected", "a whole number")?,
        received: parsed(fields, "received", "a whole number")?,
        gaps: field(fields, "gaps")?.split_ascii_whitespace().map(gap).collect::<Result<_, _>>()?,
        end_seen: parsed(fields, "end_seen", "true or false")?,
    })
}
