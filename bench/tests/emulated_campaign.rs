//! The demo's campaign as it is recorded: whole, reproducible, without the truth in it, and with the flows that were asked for.

use bench::emulation::{draw, drawn_effects, record};
use bench::progress::Progress;
use identify::strokes::{Steady, strokes};
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
    steady_in_every_stroke(&run, "as recorded");
    steady_in_every_stroke(&thinned(&run, 10), "at 100 Hz");
    steady_in_every_stroke(&truncated(&run, 2.5), "cut after 2.5 s");
}

/// Each of the fourteen flows has an interval of steady velocity, and more flow is a faster one.
fn steady_in_every_stroke(run: &Recording, how: &str) {
    let forward: Vec<Steady> = strokes(run)
        .into_iter()
        .filter(|stroke| run.voltage_v[stroke.rows.start] > 0.0)
        .map(|stroke| stroke.steady.unwrap_or_else(|| panic!("{how}: none in segment {}", stroke.segment)))
        .collect();
    assert_eq!(forward.len(), 14, "{how}");
    for pair in forward.windows(2) {
        assert!(pair[0].velocity_deg_s < pair[1].velocity_deg_s, "{how}: {pair:?}");
    }
    let deviation = forward.iter().map(|steady| steady.deviation).fold(0.0, f64::max);
    assert!(deviation < 0.12, "{how}: {deviation}");
}

/// Every `nth` row.
fn thinned(run: &Recording, nth: usize) -> Recording {
    kept(run, |i| i % nth == 0)
}

/// Each segment to `seconds` after its begin.
fn truncated(run: &Recording, seconds: f64) -> Recording {
    let mut begin_s = 0.0;
    let keep: Vec<bool> = (0..run.len())
        .map(|i| {
            if i == 0 || run.segment[i] != run.segment[i - 1] {
                begin_s = run.time_s[i];
            }
            run.time_s[i] < begin_s + seconds
        })
        .collect();
    kept(run, |i| keep[i])
}

fn kept(run: &Recording, keep: impl Fn(usize) -> bool) -> Recording {
    fn of<T: Copy>(column: &[T], rows: &[usize]) -> Vec<T> {
        rows.iter().map(|&i| column[i]).collect()
    }
    let rows: Vec<usize> = (0..run.len()).filter(|&i| keep(i)).collect();
    Recording {
        time_s: of(&run.time_s, &rows),
        voltage_v: of(&run.voltage_v, &rows),
        angle_deg: of(&run.angle_deg, &rows),
        pressure1_bar: of(&run.pressure1_bar, &rows),
        pressure2_bar: of(&run.pressure2_bar, &rows),
        torque_nm: of(&run.torque_nm, &rows),
        volume_ml: of(&run.volume_ml, &rows),
        brake_open: of(&run.brake_open, &rows),
        bypass_open: of(&run.bypass_open, &rows),
        segment: of(&run.segment, &rows),
    }
}
