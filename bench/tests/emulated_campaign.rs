//! The demo's campaign as it is recorded: whole, reproducible, without the truth in it, and with the flows that were asked for.

use bench::emulation::{draw, drawn_effects, record};
use bench::progress::Progress;
use model::ModelFile;
use model::rec::pump_flow;
use profiles::BUILTIN;
use recordings::{Campaign, Protocol, Recording, Role};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;

/// One session a process at a time: they share the process's instance name.
static ONE: Mutex<()> = Mutex::new(());

const SEED: u64 = 5;

fn recorded(dir: &Path) -> (ModelFile, Campaign) {
    let _one = ONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let truth = draw(SEED, drawn_effects());
    let campaign = record(dir, &truth, SEED, &Progress::for_stderr()).expect("the scripts run on this rig");
    (truth, campaign)
}

fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(dir).expect("a folder").map(|entry| entry.expect("readable"));
    entries
        .map(|entry| (entry.file_name().to_string_lossy().into_owned(), std::fs::read(entry.path()).expect("a file")))
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_nothing_of_the_truth() {
    let (a, b) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let (truth, campaign) = recorded(a.path());
    recorded(b.path());
    let files = [files(a.path()), files(b.path())];
    assert_eq!(files[0].len(), BUILTIN.len() + 1, "{:?}", files[0].keys());
    assert!(files[0] == files[1], "the same seed gave other bytes");

    assert_eq!(Campaign::open(a.path()).expect("a campaign"), campaign);
    for role in [Role::Identify, Role::Validate] {
        assert!(campaign.runs.iter().any(|run| run.role == role));
    }
    for protocol in Protocol::ALL {
        assert!(campaign.runs.iter().any(|run| run.protocol == *protocol), "no {protocol}");
    }
    // Texts stand uncompressed in campaign.toml and in the recordings' metadata.
    let secrets = [truth.effect[0].id.clone(), truth.parameters.torque.m3.to_string()];
    for (name, bytes) in &files[0] {
        for secret in &secrets {
            assert!(!bytes.windows(secret.len()).any(|w| w == secret.as_bytes()), "{name} holds {secret}");
        }
    }
}

#[test]
fn the_commanded_flow_is_what_the_rig_s_pump_delivers() {
    let dir = tempfile::tempdir().expect("a folder");
    let (truth, campaign) = recorded(dir.path());
    let entry = campaign.runs.iter().find(|run| run.protocol == Protocol::ConstantFlow).expect("it is built in");
    let run: Recording = campaign.read(entry).expect("readable");
    let k = truth.parameters.to_vector();
    // Mean flow of each stroke by the true pump, unless the voltage was at its limit.
    let mut strokes: BTreeMap<i64, Vec<f64>> = BTreeMap::new();
    for i in (0..run.len()).filter(|&i| run.voltage_v[i] > 0.0) {
        let dp = run.pressure1_bar[i] - run.pressure2_bar[i];
        let (flow, _) = pump_flow(&k, run.voltage_v[i], dp);
        let limited = run.voltage_v[i] >= campaign.rig.u_max_v;
        strokes.entry(run.segment[i]).or_default().push(if limited { f64::NAN } else { flow });
    }
    let means: Vec<f64> = strokes.values().map(|flow| flow.iter().sum::<f64>() / flow.len() as f64).collect();
    assert_eq!(means.len(), 14, "a stroke for each flow of the script");
    let reached = means.iter().filter(|mean| mean.is_finite()).count();
    assert!(reached >= 8, "most strokes are within the voltage: {means:?}");
    for (stroke, mean) in means.iter().enumerate().filter(|(_, mean)| mean.is_finite()) {
        let wanted = (stroke + 1) as f64;
        assert!((mean - wanted).abs() < 0.05 * wanted + 0.1, "asked for {wanted} ml/s, got {mean}");
    }
}
