//! Inputs that are missing for a time: a short gap is bridged, over a long one nobody knows what drove the rig.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use identify::prepare::{Channel, Stretch, stretches};
use recordings::{Plane, Protocol, Recording};

/// Three dwells of 3 s on the pump's bench at 2, 3 and 4 bar, without what `silent` says of (dwell, seconds in it).
fn bench(silent: impl Fn(usize, f64) -> bool) -> Vec<Stretch> {
    let mut r = Recording::default();
    for row in 0..900 {
        let (dwell, within_s) = (row / 300, (row % 300) as f64 * 0.01);
        let pressure_bar = if silent(dwell, within_s) { f64::NAN } else { 2.0 + dwell as f64 };
        r.time_s.push(row as f64 * 0.01);
        r.voltage_v.push(5.0);
        r.angle_deg.push(f64::NAN);
        r.pressure1_bar.push(pressure_bar);
        r.pressure2_bar.push(2.0);
        r.torque_nm.push(f64::NAN);
        r.volume_ml.push(within_s);
        r.brake_open.push(true);
        r.bypass_open.push(false);
        r.segment.push(dwell as i64);
    }
    stretches(0, "pump_map.csv", Protocol::PumpMap, Plane::Horizontal, &r).unwrap()
}

#[test]
fn a_dwell_without_its_pressure_for_a_time_is_passed_over_and_a_short_gap_is_bridged() {
    assert_eq!(bench(|_, _| false).len(), 3);
    let bridged = bench(|dwell, t| dwell == 1 && (1.0..1.4).contains(&t));
    assert_eq!(bridged.len(), 3);
    assert!(bridged[1].pressure_bar[0].iter().all(|p| (p - 3.0).abs() < 1e-9));
    // a sensor that saturates loses the start, the middle or the end
    for (from, to) in [(0.0, 0.9), (1.0, 1.9), (2.0, 3.0)] {
        let left = bench(|dwell, t| dwell == 1 && (from..to).contains(&t));
        let shown: Vec<f64> = left.iter().map(|s| s.pressure_bar[0][150]).collect();
        assert_eq!(shown.len(), 2, "{from} .. {to} s: {shown:?}");
        assert!((shown[0] - 2.0).abs() < 1e-9 && (shown[1] - 4.0).abs() < 1e-9, "{shown:?}");
    }
}

/// One filling at 6, 5, .. 1 bar in steps of 3 s, of which the first second is a release: 10 ml a step. Pressures above `top_bar` are missing.
fn filling(top_bar: f64) -> Vec<Stretch> {
    let mut r = Recording::default();
    for row in 0..1800 {
        let (step, within_s) = (row / 300, (row % 300) as f64 * 0.01);
        let rests = step == 0 || within_s >= 1.0;
        let pressure_bar = 6.0 - step as f64;
        r.time_s.push(row as f64 * 0.01);
        r.voltage_v.push(0.0);
        r.angle_deg.push(10.0);
        r.pressure1_bar.push(if pressure_bar > top_bar { f64::NAN } else { pressure_bar });
        r.pressure2_bar.push(pressure_bar);
        r.torque_nm.push(1.0);
        r.volume_ml.push(if rests { 10.0 * step as f64 } else { f64::NAN });
        r.brake_open.push(false);
        r.bypass_open.push(false);
        r.segment.push(step as i64);
    }
    stretches(0, "clamp_steps.csv", Protocol::ClampSteps, Plane::Horizontal, &r).unwrap()
}

#[test]
fn a_filling_whose_top_saturates_is_read_from_where_its_pressures_are_known() {
    let readings = |stretches: &[Stretch]| {
        let targets = stretches[0].targets.iter().filter(|t| t.channel == Channel::Volume);
        targets.map(|t| t.measured).collect::<Vec<_>>()
    };
    let whole = filling(9.0);
    assert_eq!(
        (whole.len(), whole[0].pressure_bar[0][0], readings(&whole)),
        (1, 6.0, vec![10.0, 20.0, 30.0, 40.0, 50.0])
    );
    let cut = filling(4.5);
    assert_eq!((cut.len(), cut[0].pressure_bar[0][0], readings(&cut)), (1, 4.0, vec![10.0, 20.0, 30.0]));
}

/// Three sweeps of 4 s, shut off, at 5 deg/s, without the angle that `silent` says of (sweep, seconds in it).
fn sweeps(silent: impl Fn(usize, f64) -> bool) -> Vec<Stretch> {
    let mut r = Recording::default();
    for row in 0..1200 {
        let (sweep, within_s) = (row / 400, (row % 400) as f64 * 0.01);
        r.time_s.push(row as f64 * 0.01);
        r.voltage_v.push(0.0);
        r.angle_deg.push(if silent(sweep, within_s) { f64::NAN } else { 5.0 * within_s - 10.0 });
        r.pressure1_bar.push(2.0 + sweep as f64);
        r.pressure2_bar.push(2.0);
        r.torque_nm.push(f64::NAN);
        r.volume_ml.push(if within_s == 0.0 { 80.0 } else { f64::NAN });
        r.brake_open.push(false);
        r.bypass_open.push(false);
        r.segment.push(sweep as i64);
    }
    stretches(0, "volume_map.csv", Protocol::VolumeMap, Plane::Horizontal, &r).unwrap()
}

#[test]
fn a_sweep_without_its_angle_for_a_time_is_passed_over_and_a_short_gap_is_bridged() {
    assert_eq!(sweeps(|_, _| false).len(), 3);
    let bridged = sweeps(|sweep, t| sweep == 1 && (1.0..1.4).contains(&t));
    assert_eq!(bridged.len(), 3);
    let off_deg = bridged[1].angle_rad.iter().zip(&bridged[0].angle_rad).map(|(a, b)| (a - b).to_degrees().abs());
    assert!(off_deg.fold(0.0, f64::max) < 1e-9, "a straight line");
    for (from, to) in [(0.0, 0.9), (1.0, 1.9), (3.0, 4.0)] {
        let left = sweeps(|sweep, t| sweep == 1 && (from..to).contains(&t));
        let shown: Vec<f64> = left.iter().map(|s| s.initial[1]).collect();
        assert_eq!(shown.len(), 2, "{from} .. {to} s: {shown:?}");
        assert!((shown[0] - 2.0).abs() < 1e-9 && (shown[1] - 4.0).abs() < 1e-9, "{shown:?}");
    }
}
