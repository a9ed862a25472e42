//! Inputs that are missing for a time: a short gap is bridged, over a long one nobody knows what drove the rig.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use identify::component::{fit_capacity, torque_points};
use identify::prepare::{Channel, Stretch, stretches};
use model::Parameters;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use recordings::{Plane, Protocol, Recording};

/// Adds a row with these readings: angle (deg), pressures (bar), torque (Nm), volume (ml). `open`: brake and bypass.
fn push_row(r: &mut Recording, time_s: f64, voltage_v: f64, read: [f64; 5], open: (bool, bool), segment: i64) {
    r.time_s.push(time_s);
    r.voltage_v.push(voltage_v);
    let columns = [&mut r.angle_deg, &mut r.pressure1_bar, &mut r.pressure2_bar, &mut r.torque_nm, &mut r.volume_ml];
    columns.into_iter().zip(read).for_each(|(column, value)| column.push(value));
    r.brake_open.push(open.0);
    r.bypass_open.push(open.1);
    r.segment.push(segment);
}

/// Three dwells of 3 s on the pump's bench at 2, 3 and 4 bar, without what `silent` says of (dwell, seconds in it).
fn bench(silent: impl Fn(usize, f64) -> bool) -> Vec<Stretch> {
    let mut r = Recording::default();
    for row in 0..900 {
        let (dwell, within_s) = (row / 300, (row % 300) as f64 * 0.01);
        let pressure_bar = if silent(dwell, within_s) { f64::NAN } else { 2.0 + dwell as f64 };
        let read = [f64::NAN, pressure_bar, 2.0, f64::NAN, within_s];
        push_row(&mut r, row as f64 * 0.01, 5.0, read, (true, false), dwell as i64);
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
        let read = [
            10.0,
            if pressure_bar > top_bar { f64::NAN } else { pressure_bar },
            pressure_bar,
            1.0,
            if rests { 10.0 * step as f64 } else { f64::NAN },
        ];
        push_row(&mut r, row as f64 * 0.01, 0.0, read, (false, false), step as i64);
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
        let read = [
            if silent(sweep, within_s) { f64::NAN } else { 5.0 * within_s - 10.0 },
            2.0 + sweep as f64,
            2.0,
            f64::NAN,
            if within_s == 0.0 { 80.0 } else { f64::NAN },
        ];
        push_row(&mut r, row as f64 * 0.01, 0.0, read, (false, false), sweep as i64);
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

/// Two fillings at -20 and 20 degrees that are drained from 6 bar in eight steps of 3 s, of which 0.4 s are the release; the cylinder is read where `read`
/// says so of seconds behind the release. The capacity is that of the example.
fn drained(rows_s: f64, read: impl Fn(f64) -> bool) -> Vec<Stretch> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let mut noise = |std: f64| -> f64 {
        let drawn: f64 = StandardNormal.sample(&mut rng);
        std * drawn
    };
    let capacity = Parameters::example().capacity;
    let released_ml = |angle_deg: f64, to_bar: f64| {
        let over = |bar: f64| capacity.h1 * bar.powf(capacity.h2 + 1.0) / (capacity.h2 + 1.0) + capacity.h3 * bar;
        (-capacity.a1 * angle_deg).exp() * (over(6.0) - over(to_bar))
    };
    let mut r = Recording::default();
    let in_step = (3.0 / rows_s).round() as usize;
    for row in 0..18 * in_step {
        let (step, within_s) = (row / in_step, (row % in_step) as f64 * rows_s);
        let (filling, nth) = (step / 9, (step % 9) as f64);
        let angle_deg = [-20.0, 20.0][filling];
        let behind_s = if nth == 0.0 { within_s } else { within_s - 0.4 };
        let (before_bar, after_bar) = (6.0 - 0.5 * (nth - 1.0).max(0.0), 6.0 - 0.5 * nth);
        let share = if nth == 0.0 { 1.0 } else { (within_s / 0.4).min(1.0) };
        let rests = behind_s > -1e-9;
        let read = [
            angle_deg + noise(0.005),
            before_bar + (after_bar - before_bar) * share + noise(0.006),
            3.0 + noise(0.006),
            f64::NAN,
            if rests && read(behind_s) { released_ml(angle_deg, after_bar) } else { f64::NAN },
        ];
        push_row(&mut r, row as f64 * rows_s, 0.0, read, (false, false), step as i64);
    }
    stretches(0, "clamp_steps.csv", Protocol::ClampSteps, Plane::Horizontal, &r).unwrap()
}

#[test]
fn the_cylinder_may_be_read_once_at_any_time_of_the_rest() {
    let example = Parameters::example().capacity;
    let truth = |bar: f64| example.h1 * bar.powf(example.h2) + example.h3;
    // in every row, at once, after 1 and 2 s, in the last row; by a person with rows half a second apart
    type Read = fn(f64) -> bool;
    let reads: [(f64, Read); 6] = [
        (0.01, |_| true),
        (0.01, |s| s < 0.005),
        (0.01, |s| (s - 1.0).abs() < 0.005),
        (0.01, |s| (s - 2.0).abs() < 0.005),
        (0.01, |s| (s - 2.58).abs() < 0.005),
        (0.5, |s| s > 2.0),
    ];
    for (n, (rows_s, read)) in reads.into_iter().enumerate() {
        let cut = drained(rows_s, read);
        let mut found = Parameters::example();
        assert!(fit_capacity(&cut.iter().collect::<Vec<_>>(), &mut found), "{n}");
        let c = found.capacity;
        for bar in [2.5_f64, 4.0, 5.5] {
            let ratio = (c.h1 * bar.powf(c.h2) + c.h3) / truth(bar);
            assert!((ratio - 1.0).abs() < 0.04, "reading {n} at {bar} bar: {ratio}");
        }
        // a late reading is compared in the rest: the pressure there is the one that the release ended at
        for s in &cut {
            for (target, after_bar) in
                s.targets.iter().filter(|t| t.channel == Channel::Volume).zip((1..9).map(|n| 6.0 - 0.5 * f64::from(n)))
            {
                let shown = s.pressure_bar[0][target.middle];
                assert!((shown - after_bar).abs() < 0.025, "reading {n}: {shown} for {after_bar} bar");
            }
        }
    }
}

/// Four dwells of 5 s at two angles with rows so far apart, in which the torque is read where `read` says so of the row; nobody reads it while the lever is led.
fn clamped(rows_s: f64, read: impl Fn(usize) -> bool) -> Recording {
    let mut r = Recording::default();
    let in_segment = (5.0 / rows_s).round() as usize;
    for row in 0..5 * in_segment {
        let (segment, within) = (row / in_segment, (row % in_segment) as f64 / in_segment as f64);
        let angle_deg = [-20.0, -20.0, -20.0 + 40.0 * within, 20.0, 20.0][segment];
        let dp_bar = [1.0, -1.0, 0.0, 1.0, -1.0][segment];
        let read = [
            angle_deg,
            3.0 + dp_bar / 2.0,
            3.0 - dp_bar / 2.0,
            if segment != 2 && read(row) { 6.8 * dp_bar } else { f64::NAN },
            f64::NAN,
        ];
        push_row(&mut r, row as f64 * rows_s, 5.0 * dp_bar, read, (segment != 2, segment == 2), segment as i64);
    }
    r
}

#[test]
fn a_torque_sensor_may_be_slower_than_the_rows_and_the_rows_may_be_slow() {
    type Read = fn(usize) -> bool;
    // rows at 100 Hz, 1 kHz and 2 Hz; a value in every row, every other, every tenth but never in the row that is kept
    let ways: [(f64, Read); 5] = [
        (0.01, |_| true),
        (0.01, |row| row % 2 == 1),
        (1e-3, |row| row % 10 == 7),
        (1e-3, |row| row % 100 == 7),
        (0.5, |_| true),
    ];
    for (n, (rows_s, read)) in ways.into_iter().enumerate() {
        let r = clamped(rows_s, read);
        let cut = stretches(0, "torque_map.csv", Protocol::TorqueMap, Plane::Horizontal, &r).unwrap();
        assert_eq!(cut.len(), 2, "way {n}: an angle each");
        for s in &cut {
            let torques: Vec<f64> =
                s.targets.iter().filter(|t| t.channel == Channel::Torque).map(|t| t.measured).collect();
            assert!(torques.len() >= 20, "way {n}: {}", torques.len());
            assert!(torques.iter().all(|nm| (nm.abs() - 6.8).abs() < 1e-9), "way {n}: {torques:?}");
        }
        assert_eq!(torque_points(&r).len(), 4, "way {n}");
    }
    // a value a second is too seldom to tell a dwell
    let seldom = clamped(0.01, |row| row % 100 == 7);
    assert!(stretches(0, "torque_map.csv", Protocol::TorqueMap, Plane::Horizontal, &seldom).is_err());
}

#[test]
fn a_sweep_of_slow_rows_is_read() {
    let mut r = Recording::default();
    for row in 0..30 {
        let (sweep, within_s) = (row / 10, (row % 10) as f64 * 0.5);
        let read =
            [2.0 * within_s - 5.0, 2.0 + sweep as f64, 2.0, f64::NAN, if within_s == 0.0 { 80.0 } else { f64::NAN }];
        push_row(&mut r, row as f64 * 0.5, 0.0, read, (false, false), sweep as i64);
    }
    assert_eq!(stretches(0, "volume_map.csv", Protocol::VolumeMap, Plane::Horizontal, &r).unwrap().len(), 3);
}
