//! Recordings that can't be what their columns say: drawn campaigns pass, and each way of spoiling them is named.

#![allow(clippy::unwrap_used, reason = "a test that can't go on fails")]

use bench::blind::rig::{Truth, draw};
use bench::blind::runs::record;
use identify::plausible::{Fault, Sensor, SetAside, examine};
use model::effects::find;
use recordings::{Campaign, Plane, Protocol, Recording, Role};

/// The campaign of a drawn rig with these effects.
fn drawn(case: usize, effects: &[(&str, &[f64])]) -> (Campaign, Vec<Recording>) {
    for attempt in 0..8 {
        let rig = draw(11, case, attempt);
        let effects = effects.iter().map(|(id, values)| (find(id).unwrap(), values.to_vec())).collect();
        if let Ok(recorded) = record(&Truth { parameters: rig.parameters, effects }, &rig, 11, case) {
            let loaded = recorded.loaded;
            return (loaded.campaign, loaded.runs.into_iter().map(|r| r.recording).collect());
        }
    }
    panic!("no rig of case {case} runs");
}

fn at(campaign: &Campaign, protocol: Protocol) -> usize {
    campaign.runs.iter().position(|r| r.protocol == protocol).unwrap()
}

#[test]
fn drawn_campaigns_pass_whatever_acts_in_them() {
    let effects: [&[(&str, &[f64])]; 8] = [
        &[],
        &[("end_stop", &[20.0, 20.0, 28.0])],
        &[("backlash", &[1.0, 1.0])],
        &[("stribeck_friction", &[1.0, 0.1])],
        &[("pressure_friction", &[0.3])],
        &[("line_inertance", &[0.1])],
        &[("pressure_drift", &[0.2, 0.1, 0.0, 0.0, 40.0])],
        &[("angle_offset", &[3.0])],
    ];
    for (case, effects) in effects.into_iter().enumerate() {
        let known = effects.iter().all(|(id, v)| find(id).unwrap().header().parameters.len() == v.len());
        let effects = if known { effects } else { &[] };
        let (mut campaign, mut recordings) = drawn(case, effects);
        let found = examine(&mut campaign, &mut recordings).unwrap_or_else(|e| panic!("case {case}: {e}"));
        assert!(found.is_empty(), "case {case}: {found:?}");
        assert_eq!(recordings.len(), 11);
    }
}

type Spoil = fn(&mut Campaign, &mut Vec<Recording>);

fn scale(values: &mut [f64], factor: f64) {
    values.iter_mut().for_each(|v| *v *= factor);
}

fn scale_all(recordings: &mut [Recording], column: fn(&mut Recording) -> &mut Vec<f64>, factor: f64) {
    recordings.iter_mut().for_each(|r| scale(column(r), factor));
}

#[test]
fn wrong_units_and_signs_are_named_with_file_column_and_likely_cause() {
    let spoilt: &[(&str, Spoil, &[&str])] = &[
        ("Pa", |_, r| scale_all(r, |r| &mut r.pressure1_bar, 1e5), &["pressure1_bar", "in Pa", "1e-5"]),
        ("kPa in one run", |_, r| scale(&mut r[6].pressure2_bar, 100.0), &["pressure2_bar", "kPa", "square_a"]),
        (
            "psi",
            |_, r| {
                scale_all(r, |r| &mut r.pressure1_bar, 14.5038);
                scale_all(r, |r| &mut r.pressure2_bar, 14.5038);
            },
            &["pressure1_bar", "psi"],
        ),
        (
            "MPa",
            |_, r| {
                scale_all(r, |r| &mut r.pressure1_bar, 0.1);
                scale_all(r, |r| &mut r.pressure2_bar, 0.1);
            },
            &["pressure1_bar", "MPa"],
        ),
        ("one sensor in MPa", |_, r| scale_all(r, |r| &mut r.pressure2_bar, 0.1), &["pressure2_bar", "MPa"]),
        (
            "gauge of a rig near ambient",
            |_, r| r.iter_mut().for_each(|r| r.pressure1_bar.iter_mut().for_each(|v| *v -= 3.0)),
            &["pressure1_bar", "gauge"],
        ),
        ("rad", |_, r| scale_all(r, |r| &mut r.angle_deg, 0.0174533), &["angle_deg", "rad", "57.2958"]),
        ("mNm", |_, r| scale_all(r, |r| &mut r.torque_nm, 1e3), &["torque_nm", "mNm"]),
        ("l", |_, r| scale_all(r, |r| &mut r.volume_ml, 1e-3), &["volume_ml", "in l"]),
        ("mV", |_, r| scale_all(r, |r| &mut r.voltage_v, 1e3), &["voltage_v", "mV", "u_max"]),
        ("percent", |_, r| scale_all(r, |r| &mut r.voltage_v, 100.0 / 24.0), &["voltage_v", "percent"]),
        ("share", |_, r| scale_all(r, |r| &mut r.voltage_v, 1.0 / 24.0), &["voltage_v", "share of u_max"]),
        ("ms", |_, r| scale_all(r, |r| &mut r.time_s, 1e3), &["time_s", "in ms", "1e-3"]),
        (
            "exchanged pressures",
            |_, r| r.iter_mut().for_each(|r| std::mem::swap(&mut r.pressure1_bar, &mut r.pressure2_bar)),
            &["pressure1_bar, pressure2_bar", "exchanged"],
        ),
        ("inverted angle", |_, r| scale_all(r, |r| &mut r.angle_deg, -1.0), &["angle_deg", "inverted"]),
        ("inverted voltage", |_, r| scale_all(&mut r[5..], |r| &mut r.voltage_v, -1.0), &["voltage_v", "inverted"]),
        ("inverted torque", |_, r| scale_all(r, |r| &mut r.torque_nm, -1.0), &["torque_nm", "inverted"]),
    ];
    let (campaign, recordings) = drawn(3, &[]);
    assert!((campaign.rig.u_max_v - 24.0).abs() < 4.0, "{}", campaign.rig.u_max_v);
    for (what, spoil, words) in spoilt {
        let (mut campaign, mut recordings) = (campaign.clone(), recordings.clone());
        spoil(&mut campaign, &mut recordings);
        let said = match examine(&mut campaign, &mut recordings) {
            Err(error) => error.to_string(),
            Ok(found) => panic!("{what}: nothing was refused, {found:?}"),
        };
        for word in *words {
            assert!(said.contains(word), "{what}: {word:?} is missing in: {said}");
        }
    }
}

fn spoilt(protocol: Protocol, spoil: impl Fn(&mut Recording)) -> (Vec<SetAside>, usize, Recording) {
    let (mut campaign, mut recordings) = drawn(5, &[]);
    let run = at(&campaign, protocol);
    spoil(&mut recordings[run]);
    let file = campaign.runs[run].file.clone();
    let found = examine(&mut campaign, &mut recordings).unwrap();
    assert!(found.iter().all(|s| s.file == file), "{found:?}");
    let left = campaign.runs.iter().position(|r| r.file == file).map(|n| recordings[n].clone()).unwrap_or_default();
    (found, recordings.len(), left)
}

#[test]
fn a_dead_sensor_is_set_aside_and_no_quiet_one() {
    for (protocol, channel, whole) in [
        (Protocol::SquareWave, Sensor::Pressure1, true),
        (Protocol::RandomSteps, Sensor::Pressure2, true),
        (Protocol::ConstantFlow, Sensor::Angle, true),
        (Protocol::TorqueMap, Sensor::Torque, true),
        (Protocol::VolumeMap, Sensor::Pressure1, true),
        (Protocol::ClampSteps, Sensor::Torque, false),
        (Protocol::PumpMap, Sensor::Volume, true),
    ] {
        let (found, left, _) = spoilt(protocol, |r| {
            let values = match channel {
                Sensor::Angle => &mut r.angle_deg,
                Sensor::Pressure1 => &mut r.pressure1_bar,
                Sensor::Pressure2 => &mut r.pressure2_bar,
                Sensor::Torque => &mut r.torque_nm,
                Sensor::Volume => &mut r.volume_ml,
            };
            values.iter_mut().filter(|v| v.is_finite()).for_each(|v| *v = 2.5);
        });
        assert_eq!(found.len(), 1, "{protocol} {channel:?}: {found:?}");
        assert_eq!((found[0].fault, &found[0].channels[..]), (Fault::Dead, &[channel][..]), "{found:?}");
        assert_eq!((found[0].whole_run, left), (whole, if whole { 10 } else { 11 }), "{protocol} {channel:?}");
    }
}

#[test]
fn a_sensor_that_dies_on_the_way_saturates_or_repeats_its_twin_is_named() {
    // a dead one that still has noise
    let (found, _, _) = spoilt(Protocol::SquareWave, |r| {
        for (i, v) in r.pressure1_bar.iter_mut().enumerate() {
            *v = 2.8 + 0.003 * ((i as f64 * 12.9898).sin() * 43_758.545_3).fract();
        }
    });
    assert_eq!(found[0].fault, Fault::Dead, "{found:?}");

    let (found, _, left) = spoilt(Protocol::RandomSteps, |r| {
        let from = r.len() * 7 / 10;
        let held = r.angle_deg[from - 1];
        r.angle_deg[from..].fill(held);
    });
    assert_eq!((found[0].fault, found[0].whole_run), (Fault::Dead, false), "{found:?}");
    assert!(left.angle_deg[left.len() - 1].is_nan() && left.angle_deg[10].is_finite());

    let (found, _, left) = spoilt(Protocol::SquareWave, |r| {
        let mut sorted: Vec<f64> = r.pressure1_bar.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let cut = sorted[sorted.len() * 8 / 10];
        r.pressure1_bar.iter_mut().for_each(|v| *v = v.min(cut));
    });
    assert_eq!((found[0].fault, found[0].whole_run), (Fault::Saturated, false), "{found:?}");
    assert!(left.pressure1_bar.iter().filter(|v| v.is_nan()).count() > left.len() / 10);

    // most of the time, at either end; of a coarse encoder only other runs tell that this was no stop of the lever
    for step_deg in [0.001, 0.1] {
        let (found, _, _) = spoilt(Protocol::RandomSteps, |r| {
            let most = r.angle_deg.iter().filter(|v| v.is_finite()).fold(0.0_f64, |m, v| m.max(v.abs()));
            let limit = 0.15 * most;
            r.angle_deg
                .iter_mut()
                .for_each(|v| *v = (*v / step_deg).round().clamp(-limit / step_deg, limit / step_deg) * step_deg);
        });
        assert!(found.iter().any(|f| f.fault == Fault::Saturated && f.whole_run), "{step_deg}: {found:?}");
    }

    let (found, _, _) = spoilt(Protocol::RandomSteps, |r| r.pressure2_bar = r.pressure1_bar.clone());
    assert_eq!(found[0].fault, Fault::Duplicated, "{found:?}");
}

#[test]
fn where_nothing_is_left_the_sensor_is_the_error() {
    let (mut campaign, mut recordings) = drawn(5, &[]);
    let keep: Vec<usize> =
        (0..campaign.runs.len()).filter(|&n| campaign.runs[n].role == Role::Validate).take(1).collect();
    let one = at(&campaign, Protocol::SquareWave);
    campaign.runs = [one, keep[0]].iter().map(|&n| campaign.runs[n].clone()).collect();
    recordings = [one, keep[0]].iter().map(|&n| recordings[n].clone()).collect();
    recordings[0].pressure1_bar.fill(2.0);
    let said = examine(&mut campaign, &mut recordings).unwrap_err().to_string();
    for word in ["pressure1_bar", "identify", "square_a", "no effect of the plant"] {
        assert!(said.contains(word), "{word:?} is missing in: {said}");
    }
}

/// Every so many rows of a run.
fn seldom(r: &mut Recording, rows: usize) {
    let keep: Vec<bool> = (0..r.len()).map(|i| i.is_multiple_of(rows)).collect();
    let columns = [
        &mut r.time_s,
        &mut r.voltage_v,
        &mut r.angle_deg,
        &mut r.pressure1_bar,
        &mut r.pressure2_bar,
        &mut r.torque_nm,
        &mut r.volume_ml,
    ];
    let kept = || keep.iter().copied();
    for column in columns {
        let mut kept = kept();
        column.retain(|_| kept.next() == Some(true));
    }
    for valve in [&mut r.brake_open, &mut r.bypass_open] {
        let mut kept = kept();
        valve.retain(|_| kept.next() == Some(true));
    }
    let mut kept = kept();
    r.segment.retain(|_| kept.next() == Some(true));
}

#[test]
fn slow_experiments_may_be_read_twice_a_second_and_a_free_lever_may_not() {
    let (campaign, recordings) = drawn(3, &[]);
    let rows_s = |r: &Recording| (r.time_s[r.len() - 1] - r.time_s[0]) / r.len() as f64;
    let thinned = |protocol: Protocol| {
        let mut recordings = recordings.clone();
        let run = at(&campaign, protocol);
        let rows = (0.5 / rows_s(&recordings[run])).round() as usize;
        seldom(&mut recordings[run], rows);
        (run, recordings)
    };
    for protocol in [Protocol::TorqueMap, Protocol::ClampSteps] {
        let (run, recordings) = thinned(protocol);
        examine(&mut campaign.clone(), &mut recordings.clone()).unwrap_or_else(|e| panic!("{protocol}: {e}"));
        // the same times in ms
        let mut wrong = recordings;
        scale(&mut wrong[run].time_s, 1e3);
        let said = examine(&mut campaign.clone(), &mut wrong).unwrap_err().to_string();
        assert!(said.contains("in ms: multiply it by 1e-3"), "{protocol}: {said}");
    }
    let (_, mut swinging) = thinned(Protocol::SquareWave);
    let said = examine(&mut campaign.clone(), &mut swinging).unwrap_err().to_string();
    assert!(said.contains("time_s") && said.contains("swing"), "{said}");
}

#[test]
fn the_bench_of_the_pump_may_stand_at_any_pressure() {
    let (mut campaign, mut recordings) = drawn(3, &[]);
    let mut bench: Vec<usize> =
        (0..recordings.len()).filter(|&n| campaign.runs[n].protocol == Protocol::PumpMap).collect();
    // one port at the pressure of a load, the other one below the ambient; then as many such runs as there are others
    recordings[bench[0]].pressure1_bar.fill(19.9);
    recordings[bench[0]].pressure2_bar.fill(0.6);
    examine(&mut campaign.clone(), &mut recordings.clone()).unwrap();
    while bench.len() * 2 <= recordings.len() + 1 {
        campaign.runs.push(campaign.runs[bench[0]].clone());
        recordings.push(recordings[bench[0]].clone());
        bench.push(recordings.len() - 1);
    }
    examine(&mut campaign, &mut recordings).unwrap();
}

#[test]
fn an_unusual_rig_passes() {
    // large, slow, sampled at 100 Hz, at twice the pressure
    let (mut campaign, mut recordings) = drawn(7, &[]);
    for r in &mut recordings {
        scale(&mut r.pressure1_bar, 2.0);
        scale(&mut r.pressure2_bar, 2.0);
        scale(&mut r.torque_nm, 3.0);
        scale(&mut r.volume_ml, 1.5);
        scale(&mut r.time_s, 2.5);
    }
    assert_eq!(examine(&mut campaign, &mut recordings).unwrap(), []);
    assert_eq!(campaign.runs.iter().filter(|r| r.plane == Plane::Vertical).count(), 1);
}
