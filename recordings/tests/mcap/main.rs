//! MCAP: what is written is what is read, the same run gives the same bytes, and a recording that is not whole is refused.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../common/mod.rs"]
mod common;
mod loss;

use std::fs;
use std::path::{Path, PathBuf};

use common::{assert_says, bits, metadata, sample, sample_bits, write_mcap};
use mcap::records::Metadata;
use proptest::prelude::*;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use recordings::{CampaignError, Event, Item, McapReader, McapWriter, Protocol, Recording, Severity};
use rt_core::{LossCertificate, Sample};

fn folder() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.mcap");
    (dir, path)
}

fn samples(count: u64) -> Vec<Sample> {
    (0..count).map(sample).collect()
}

fn read(path: &Path) -> Result<Recording, CampaignError> {
    Recording::read(path, Protocol::SquareWave)
}

#[test]
fn a_run_of_many_chunks_comes_back_whole() {
    let (_dir, path) = folder();
    let written = samples(20_000);
    write_mcap(&path, &written, 20_000);

    let mut reader = McapReader::open(&path).unwrap();
    assert_eq!(*reader.run(), metadata());
    assert_eq!(reader.certificate(), None, "not before the end");
    let items: Vec<Item> = reader.by_ref().collect::<Result<_, _>>().unwrap();
    assert_eq!(items.len(), written.len());
    for (item, sample) in items.iter().zip(&written) {
        let Item::Sample(read) = item else { panic!("no events were written") };
        assert_eq!(sample_bits(read), sample_bits(sample));
    }
    let certificate = LossCertificate { run: 3, expected: 20_000, received: 20_000, gaps: vec![], end_seen: true };
    assert_eq!(reader.certificate(), Some(&certificate));
    assert_eq!(certificate.to_string(), "20000 of 20000 samples");
}

#[test]
fn columns_are_those_of_the_samples() {
    let (_dir, path) = folder();
    write_mcap(&path, &samples(2_000), 2_000);
    let recording = read(&path).unwrap();
    assert_eq!(recording.len(), 2_000);
    for (row, sample) in samples(2_000).iter().enumerate() {
        assert_eq!(recording.time_s[row], sample.time_s());
        assert_eq!(recording.voltage_v[row], sample.voltage_v);
        assert_eq!(recording.angle_deg[row], sample.angle_deg);
        assert_eq!(recording.pressure1_bar[row], sample.pressure1_bar);
        assert_eq!(recording.pressure2_bar[row], sample.pressure2_bar);
        assert_eq!(recording.torque_nm[row].to_bits(), sample.torque_nm.to_bits());
        assert_eq!(recording.volume_ml[row].to_bits(), sample.volume_ml.to_bits());
        assert_eq!(recording.brake_open[row], sample.brake_open());
        assert_eq!(recording.bypass_open[row], sample.bypass_open());
        assert_eq!(recording.segment[row], i64::from(sample.segment));
    }
}

#[test]
fn mcap_to_csv_to_columns_changes_no_bit() {
    let (dir, path) = folder();
    write_mcap(&path, &samples(3_000), 3_000);
    let recording = read(&path).unwrap();
    let csv = dir.path().join("run.csv.gz");
    recording.write_csv(&csv).unwrap();
    assert_eq!(bits(&read(&csv).unwrap()), bits(&recording));
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let (dir, first) = folder();
    let second = dir.path().join("again.mcap");
    write_mcap(&first, &samples(10_000), 10_000);
    write_mcap(&second, &samples(10_000), 10_000);
    assert!(fs::read(&first).unwrap() == fs::read(&second).unwrap());
    let other = dir.path().join("other.mcap");
    let mut changed = samples(10_000);
    changed[9_999].angle_deg += 1e-12;
    write_mcap(&other, &changed, 10_000);
    assert!(fs::read(&first).unwrap() != fs::read(&other).unwrap());
}

#[test]
fn a_nan_of_any_sign_and_payload_gives_the_same_bytes() {
    let (dir, first) = folder();
    let second = dir.path().join("again.mcap");
    let mut other = samples(10);
    other.iter_mut().filter(|sample| sample.torque_nm.is_nan()).for_each(|sample| {
        sample.torque_nm = f64::from_bits(0xfff8_0000_0000_1234);
    });
    write_mcap(&first, &samples(10), 10);
    write_mcap(&second, &other, 10);
    assert!(fs::read(first).unwrap() == fs::read(second).unwrap());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn any_sample_comes_back(
        values in proptest::collection::vec(
            prop_oneof![any::<f64>().prop_filter("finite", |v| v.is_finite()), Just(-0.0), Just(f64::NAN)], 6),
        voltage in any::<f64>().prop_filter("finite", |v| v.is_finite()),
        ns in any::<[u32; 3]>(),
        small in any::<[u32; 3]>(),
        tick in 0..1_u64 << 42,
    ) {
        let mut only = sample(0);
        (only.tick, only.scheduled_ns) = (tick, u64::from(ns[0]) << 20);
        (only.lateness_ns, only.woken_ns) = (u64::from(ns[1]) << 30, u64::from(ns[2]));
        (only.run, only.segment, only.flags) = (small[0], small[1], small[2]);
        (only.age_ns, only.skipped) = ([small[0], ns[0], ns[1], 0, u32::MAX], tick / 3);
        (only.trip, only.quality, only.step) = (small[1], small[2], ns[2]);
        only.voltage_v = voltage;
        (only.angle_deg, only.pressure1_bar, only.pressure2_bar) = (values[0], values[1], values[2]);
        (only.torque_nm, only.volume_ml) = (values[3], values[4]);
        (only.target, only.target_of) = (values[5], small[0] % 7);
        let (_dir, path) = folder();
        write_mcap(&path, &[only], only.sequence() + 1);
        let item = McapReader::open(&path).unwrap().next().unwrap().unwrap();
        let Item::Sample(read) = item else { panic!("a sample was written") };
        prop_assert_eq!(sample_bits(&read), sample_bits(&only));
    }
}

#[test]
fn events_keep_their_place_among_the_samples() {
    let (_dir, path) = folder();
    let event = Event {
        tick: 1,
        scheduled_ns: 1_000_000,
        severity: Severity::Warning,
        source: "supervisor".to_owned(),
        text: "pressure near its limit".to_owned(),
    };
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    writer.write(&sample(0)).unwrap();
    writer.write_event(&event).unwrap();
    writer.write(&sample(1)).unwrap();
    let certificate = writer.certificate(2);
    assert_eq!(writer.finish(&certificate).unwrap(), path);
    let items: Vec<_> = McapReader::open(&path).unwrap().map(|item| item.unwrap()).collect();
    assert!(matches!(items[0], Item::Sample(_)) && matches!(items[2], Item::Sample(_)) && items.len() == 3);
    assert_eq!(items[1], Item::Event(event));
    assert_eq!(read(&path).unwrap().len(), 2);
}

#[test]
fn a_recording_bears_its_name_only_when_closed() {
    let (dir, path) = folder();
    let part = dir.path().join("run.mcap.part");
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    for sample in samples(5_000) {
        writer.write(&sample).unwrap();
    }
    assert!(part.exists() && !path.exists());
    drop(writer);
    assert!(part.exists() && !path.exists(), "an unfinished recording stays a part");
    assert_says(read(&part), &["run.mcap.part", "never closed"]);
    // Even under the final name it is known as unclosed: it has no certificate.
    fs::rename(&part, &path).unwrap();
    assert_says(read(&path), &["run.mcap", "loss certificate", "5000 samples without one", "again"]);
}

#[test]
fn a_measurement_is_never_overwritten() {
    let (dir, path) = folder();
    write_mcap(&path, &samples(10), 10);
    let before = fs::read(&path).unwrap();
    assert_says(McapWriter::create(&path, &metadata()).map(drop), &["run.mcap", "exists"]);
    let other = dir.path().join("other.mcap");
    drop(McapWriter::create(&other, &metadata()).unwrap());
    assert_says(McapWriter::create(&other, &metadata()).map(drop), &["other.mcap.part", "exists"]);
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn a_recording_cut_short_anywhere_is_refused_and_says_what_was_recovered() {
    let (dir, path) = folder();
    write_mcap(&path, &samples(6_000), 6_000);
    let whole = fs::read(&path).unwrap();
    let cut = dir.path().join("cut.mcap");
    let mut most = 0;
    for length in (8..whole.len()).step_by(whole.len() / 150).chain([whole.len() - 1]) {
        fs::write(&cut, &whole[..length]).unwrap();
        let message = assert_says(read(&cut), &["cut.mcap", "cut short after", "complete samples", "again"]);
        let recovered: u64 =
            message.split("cut short after ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(recovered >= most && recovered <= 6_000, "{message}");
        most = recovered;
    }
    assert_eq!(most, 6_000, "only the end was cut off");

    // A caller that wants to rescue what is there gets complete chunks of sound samples, then the error.
    fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let items: Vec<_> = McapReader::open(&cut).unwrap().collect();
    let (last, sound) = items.split_last().unwrap();
    assert!(last.is_err() && sound.len() > 1_000);
    for (index, item) in sound.iter().enumerate() {
        let Ok(Item::Sample(read)) = item else { panic!("sound samples stand before the error") };
        assert_eq!(sample_bits(read), sample_bits(&sample(index as u64)));
    }
}

#[test]
fn no_flipped_bit_goes_unnoticed() {
    let (dir, path) = folder();
    write_mcap(&path, &samples(3_000), 3_000);
    let whole = fs::read(&path).unwrap();
    let original = bits(&read(&path).unwrap());
    let bad = dir.path().join("bad.mcap");
    for at in (0..whole.len()).step_by(whole.len() / 400) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        fs::write(&bad, &bytes).unwrap();
        if let Ok(recording) = read(&bad) {
            assert_eq!(bits(&recording), original, "byte {at}: damage may only hit what is not used");
        }
    }
}

#[test]
fn other_bytes_and_foreign_mcap_files_are_refused() {
    let (_dir, path) = folder();
    fs::write(&path, common::csv_text(50)).unwrap();
    assert_says(read(&path), &["run.mcap", "does not start as one"]);
    fs::write(&path, b"").unwrap();
    assert_says(read(&path), &["run.mcap", "cut short after 0"]);
    let mut foreign = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    foreign.write_metadata(&Metadata { name: "other".to_owned(), metadata: Default::default() }).unwrap();
    foreign.finish().unwrap();
    assert_says(read(&path), &["run.mcap", "rec_bench.run", "export others to CSV"]);
    let missing = Path::new("/no/such/run.mcap");
    assert_says(read(missing), &["/no/such/run.mcap", "No such file"]);
}

#[test]
fn another_format_version_is_refused() {
    let (_dir, path) = folder();
    let mut foreign = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let fields = [("format".to_owned(), "3".to_owned())].into();
    foreign.write_metadata(&Metadata { name: "rec_bench.run".to_owned(), metadata: fields }).unwrap();
    foreign.finish().unwrap();
    assert_says(read(&path), &["run.mcap, format", "expected 1 or 2", "got \"3\""]);
}

#[test]
fn samples_that_can_not_be_recorded_are_refused_one_by_one() {
    let (_dir, path) = folder();
    let mut writer = McapWriter::create(&path, &metadata()).unwrap();
    writer.write(&sample(5)).unwrap();
    let spoilt = |spoil: fn(&mut Sample)| {
        let mut next = sample(6);
        spoil(&mut next);
        next
    };
    let cases: [(Sample, &[&str]); 10] = [
        (spoilt(|s| s.tick = u64::MAX), &["tick 18446744073709551615", "below 4398046511104"]),
        (spoilt(|s| s.version = 9), &["tick 6", "version", "got 9"]),
        (spoilt(|s| s.run = 4), &["tick 6", "run", "run 3", "got 4"]),
        (spoilt(|s| s.tick = 5), &["tick 5", "after 5"]),
        (spoilt(|s| s.scheduled_ns = 1), &["tick 6", "scheduled_ns", "1 ns"]),
        (spoilt(|s| s.skipped = 1), &["tick 6", "skipped", "0 to 0 ticks", "got 1"]),
        (spoilt(|s| s.voltage_v = f64::NAN), &["tick 6", "voltage_v", "NaN"]),
        (spoilt(|s| s.angle_deg = f64::INFINITY), &["tick 6", "angle_deg", "inf"]),
        (spoilt(|s| s.volume_ml = f64::NEG_INFINITY), &["tick 6", "volume_ml", "-inf"]),
        (spoilt(|s| s.target = f64::INFINITY), &["tick 6", "target", "inf"]),
    ];
    for (bad, parts) in cases {
        assert_says(writer.write(&bad), parts);
    }
    writer.write(&sample(6)).unwrap();
    let certificate = writer.certificate(7);
    assert_eq!(certificate.received, 2, "what was refused is not counted");
}

#[test]
fn the_protocol_of_the_recording_must_be_the_campaigns() {
    let (_dir, path) = folder();
    write_mcap(&path, &samples(10), 10);
    let result = Recording::read(&path, Protocol::PumpMap);
    assert_says(result, &["run.mcap, protocol", "pump-map", "square-wave", "campaign.toml"]);
}

/// The schema in the file alone is enough for a reader that knows nothing of this project.
#[test]
fn the_schema_in_the_file_explains_the_messages() {
    let (_dir, path) = folder();
    write_mcap(&path, &samples(10), 10);
    let bytes = fs::read(&path).unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().collect::<Result<_, _>>().unwrap();
    assert_eq!(messages.len(), 10);
    for (message, sample) in messages.iter().zip(samples(10)) {
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!((message.channel.topic.as_str(), schema.encoding.as_str()), ("/rig/sample", "protobuf"));
        assert_eq!((message.log_time, message.publish_time), (sample.scheduled_ns, sample.scheduled_ns));
        let pool = DescriptorPool::decode(schema.data.as_ref()).unwrap();
        let kind = pool.get_message_by_name(&schema.name).unwrap();
        let fields = DynamicMessage::decode(kind, message.data.as_ref()).unwrap();
        let field = |name: &str| fields.get_field_by_name(name).unwrap().into_owned();
        assert_eq!(field("tick"), Value::U64(sample.tick));
        assert_eq!(field("voltage_v"), Value::F64(sample.voltage_v));
        assert_eq!(field("pressure2_bar"), Value::F64(sample.pressure2_bar));
        assert_eq!(field("brake_open"), Value::Bool(sample.brake_open()));
        assert_eq!(field("segment"), Value::U32(sample.segment));
        let Value::F64(torque) = field("torque_nm") else { panic!("a double") };
        assert_eq!(torque.to_bits(), sample.torque_nm.to_bits());
        assert!(fields.has_field_by_name("volume_ml"), "written also where it is NaN");
    }
}
