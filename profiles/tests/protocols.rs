//! The built-in scripts: what they do, played against a fake rig.

mod common;

use common::{EXAMPLE, FakeRig, Row, plausible_rigs, play};
use profiles::{BUILTIN, Context, EXAMPLES, Plane, Role, Script, builtin, load_folder};
use rt_core::{ControlledPressure, Fixture, PERIOD_NS, Target};
use std::path::Path;

const U_MAX_V: f64 = 24.0;

fn script(name: &str) -> Script {
    builtin().expect("built-in scripts parse").into_iter().find(|s| s.name == name).expect("listed")
}

fn examples() -> Vec<Script> {
    EXAMPLES.iter().map(|(file, text)| Script::parse(text, file).expect("examples parse")).collect()
}

fn run_on(script: &Script, rig: common::Parameters, seed: u64) -> Vec<Row> {
    let mut playback =
        script.compile(&Context { u_max_v: U_MAX_V, seed, hands: profiles::Hands::Rig }).expect("compiles");
    let fill_bar = script.fill_bar.unwrap_or(2.8);
    let mut rig = FakeRig::new(rig, script.plane == Plane::Vertical, script.start().fixture, fill_bar);
    let limit = (script.duration_bound_s() * 1e9 / PERIOD_NS as f64).ceil() as u64 + 1;
    play(&mut playback, &mut rig, U_MAX_V, limit)
}

fn run(name: &str) -> Vec<Row> {
    run_on(&script(name), EXAMPLE, 1)
}

/// Rows of each segment, in order; segments must count from 0 without gaps.
fn segments(rows: &[Row]) -> Vec<&[Row]> {
    let segments: Vec<_> = rows.chunk_by(|a, b| a.step.segment == b.step.segment).collect();
    for (k, segment) in segments.iter().enumerate() {
        assert_eq!(segment[0].step.segment as usize, k);
    }
    segments
}

fn voltage(row: &Row) -> f64 {
    match row.step.target {
        Target::VoltageV(v) => v,
        other => panic!("{other:?} where a voltage was expected"),
    }
}

#[test]
fn the_list_is_complete_and_named_after_its_files() {
    let scripts = builtin().expect("built-in scripts parse");
    for (script, (file, _)) in scripts.iter().chain(&examples()).zip(BUILTIN.iter().chain(EXAMPLES)) {
        assert_eq!(format!("{}.toml", script.name), *file);
        assert!(!script.about.is_empty(), "{file}");
    }
    let folder = load_folder(Path::new(env!("CARGO_MANIFEST_DIR"))).expect("the crate's folder loads");
    assert_eq!(folder.len(), BUILTIN.len() + EXAMPLES.len(), "a script in the folder is missing from the lists");
    for listed in scripts.into_iter().chain(examples()) {
        let same = folder.iter().find(|s| s.name == listed.name).expect("a file of this name");
        assert_eq!((&same.text, same.protocol, same.role), (&listed.text, listed.protocol, listed.role));
    }
}

#[test]
fn roles_and_planes_are_the_campaigns() {
    let validate: Vec<_> =
        builtin().expect("parses").into_iter().filter(|s| s.role == Role::Validate).map(|s| s.name).collect();
    assert_eq!(validate, ["square_h", "square_v", "random_b"]);
    for script in builtin().expect("parses") {
        assert_eq!(script.plane == Plane::Vertical, script.name == "square_v", "{}", script.name);
    }
}

#[test]
fn every_plausible_rig_stays_within_its_range() {
    for script in builtin().expect("parses").into_iter().chain(examples()) {
        for (rig, parameters) in plausible_rigs() {
            let rows = run_on(&script, parameters, 7);
            let place = format!("{} on {rig}", script.name);
            for row in &rows {
                let m = row.measured;
                for pressure in [m.pressure1_bar, m.pressure2_bar] {
                    assert!((1.2..=5.7).contains(&pressure), "{place}: {pressure} bar");
                }
                assert!(m.angle_deg.is_nan() || m.angle_deg.abs() <= 40.01, "{place}: {} deg", m.angle_deg);
                assert!(row.voltage_v.abs() <= U_MAX_V);
            }
            assert!(rows.len() as f64 * 1e-3 <= script.duration_bound_s() + 2e-3, "{place}");
        }
    }
}

#[test]
fn a_campaign_takes_about_twenty_minutes() {
    let seconds: f64 = builtin().expect("parses").iter().map(|s| run_on(s, EXAMPLE, 1).len() as f64 * 1e-3).sum();
    assert!((15.0..23.0).contains(&(seconds / 60.0)), "{seconds} s");
}

#[test]
fn dynamic_runs_begin_with_a_second_of_rest() {
    for name in ["constant_flow", "random_a", "random_b", "square_a", "square_b", "square_h", "square_v"] {
        let rows = run(name);
        let first = segments(&rows)[0];
        assert_eq!(first.len(), 1000, "{name}");
        assert!(first.iter().all(|r| voltage(r) == 0.0 && r.step.fixture == Fixture::Free), "{name}");
        assert!(first.iter().all(|r| r.step.brake_open && !r.step.bypass_open), "{name}");
        assert!(rows.iter().all(|r| r.step.fixture == Fixture::Free), "{name}");
    }
}

#[test]
fn torque_map_visits_nine_angles_with_six_voltages_each() {
    let rows = run("torque_map");
    // The last hold waits for a condition: one closing tick.
    let segments = segments(&rows[..rows.len() - 1]);
    assert_eq!(segments.len(), 1 + 9 * 7);
    for (block, angle) in segments[1..].chunks(7).zip((-40..=40).step_by(10)) {
        let (moved, held) = block.split_first().expect("seven segments");
        assert!(moved.iter().all(|r| r.step.bypass_open && voltage(r) == 0.0));
        assert!(moved.iter().all(|r| matches!(r.step.fixture, Fixture::Driven { .. })));
        let volts: Vec<f64> = held.iter().map(|s| (voltage(&s[0]) * 1000.0).round() / 1000.0).collect();
        assert_eq!(volts, [-2.4, -1.824, -1.248, 1.248, 1.824, 2.4]);
        for segment in held {
            assert!((3000..=8000).contains(&segment.len()), "{} ticks", segment.len());
            let clamped = Fixture::Clamped { angle_deg: f64::from(angle) };
            assert!(segment.iter().all(|r| r.step.fixture == clamped && !r.step.bypass_open && r.step.brake_open));
            let end = segment[segment.len() - 1].measured;
            assert!((end.angle_deg - f64::from(angle)).abs() < 1e-6);
            assert!(end.torque_nm.is_finite());
        }
    }
}

#[test]
fn volume_map_fills_then_sweeps_both_ways_in_one_segment() {
    let rows = run("volume_map");
    let segments = segments(&rows);
    assert_eq!(segments.len(), 14);
    assert!(rows.iter().all(|r| !r.step.brake_open && !r.step.bypass_open && voltage(r) == 0.0));
    for pair in segments.chunks(2) {
        let [filled, swept] = pair else { panic!("a filling without its sweep") };
        assert!(filled.iter().all(|r| matches!(r.step.fixture, Fixture::Filled { .. })));
        let (tick_before_next, swept) = swept.split_last().expect("a sweep");
        assert!(swept.iter().all(|r| matches!(r.step.fixture, Fixture::Driven { .. })));
        assert!(matches!(tick_before_next.step.fixture, Fixture::Clamped { .. }));
        let angles: Vec<f64> = swept.iter().map(|r| r.measured.angle_deg).collect();
        let (first, last) = (angles[0], angles[angles.len() - 1]);
        let (low, high) = angles.iter().fold((first, first), |(l, h), &a| (l.min(a), h.max(a)));
        assert!(high - first > 3.0 && first - low > 3.0, "a sweep of {low}..{high} from {first}");
        assert!((last - first).abs() < 0.01, "not back at the start");
        let fastest = angles.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        assert!(fastest < 1.5e-3, "{fastest} deg a tick is no slow sweep");
    }
}

#[test]
fn pump_map_holds_each_point_for_three_seconds_in_both_directions() {
    let rows = run("pump_map");
    let (points, loads): (Vec<&[Row]>, Vec<&[Row]>) = segments(&rows).into_iter().partition(|s| voltage(&s[0]) != 0.0);
    assert_eq!((points.len(), loads.len()), (48, 8));
    for point in points {
        assert_eq!(point.len(), 3000);
        assert!(point.iter().all(|r| voltage(r) == voltage(&point[0])));
        // The discharge side carries the load; the first row too, for the load was set before.
        let Fixture::PumpBench { pressure1_bar, pressure2_bar } = point[0].step.fixture else { panic!("no bench") };
        let (discharge, intake) =
            if voltage(&point[0]) > 0.0 { (pressure1_bar, pressure2_bar) } else { (pressure2_bar, pressure1_bar) };
        assert!(discharge >= intake && intake == 1.5);
        assert!(point.iter().all(|r| r.measured.pressure1_bar == pressure1_bar));
    }
}

#[test]
fn clamp_steps_release_one_ml_and_rest() {
    let rows = run("clamp_steps");
    let flow = |r: &Row| match r.step.fixture {
        Fixture::Released { flow_ml_s, .. } => Some(flow_ml_s),
        _ => None,
    };
    // The loop of the last angle is left early: one closing tick.
    let rows = &rows[..rows.len() - 1];
    let mut angles = 0;
    let mut releases = 0;
    for segment in segments(rows).into_iter() {
        match flow(&segment[0]) {
            None => {
                assert!(matches!(segment[0].step.fixture, Fixture::Filled { .. }));
                angles += 1;
            }
            Some(0.0) => assert_eq!(segment.len(), 1501),
            Some(rate) => {
                releases += 1;
                let flowing = segment.iter().take_while(|r| flow(r) == Some(rate)).count();
                assert!((rate * flowing as f64 * 1e-3 - 1.0).abs() < 0.02, "{rate} ml/s for {flowing} ticks");
                let (tick_before_next, rest) = segment[flowing..].split_last().expect("a rest");
                assert_eq!(rest.len(), 2000);
                assert!(rest.iter().all(|r| flow(r) == Some(0.0)));
                assert!(matches!(tick_before_next.step.fixture, Fixture::Clamped { .. }));
                assert!(segment[0].measured.pressure1_bar >= 1.65, "released below the stop");
            }
        }
    }
    assert_eq!(angles, 9);
    assert!((55..=90).contains(&releases), "{releases}");
}

#[test]
fn constant_flow_returns_to_the_start_angle_before_each_stroke() {
    let rows = run("constant_flow");
    let segments = segments(&rows);
    assert_eq!(segments.len(), 1 + 2 * 14);
    for (pair, flow) in segments[1..].chunks(2).zip(1..) {
        let [back, stroke] = pair else { panic!("a way back without its stroke") };
        assert!(voltage(&back[0]) < 0.0 && voltage(&back[back.len() - 1]) == 0.0);
        assert!((stroke[0].measured.angle_deg + 26.0).abs() < 1.0, "stroke {flow} starts elsewhere");
        assert_eq!(stroke[0].step.target, Target::FlowMlS(f64::from(flow)));
        let ticks = stroke.iter().take_while(|r| matches!(r.step.target, Target::FlowMlS(_))).count();
        let reached = stroke[ticks].measured.angle_deg > 26.0;
        assert!(reached != (ticks == 6000), "stroke {flow}: {ticks} ticks, reached: {reached}");
        assert_eq!(stroke.len() - ticks, 300);
    }
}

#[test]
fn square_waves_turn_at_the_angle_or_after_the_time() {
    for (name, share, limit_deg, halves) in [
        ("square_a", 0.6, 30.0, 4),
        ("square_b", 0.85, 30.0, 6),
        ("square_h", 0.9, 30.0, 8),
        ("square_v", 0.9, 27.0, 8),
    ] {
        let rows = run(name);
        let segments = segments(&rows);
        assert_eq!(segments.len(), 1 + halves, "{name}");
        let mut sign = 1.0;
        for (k, half) in segments[1..].iter().enumerate() {
            assert!(half.iter().all(|r| (voltage(r) - sign * share * U_MAX_V).abs() < 1e-9), "{name} half {k}");
            let turned = if k + 1 < halves { segments[k + 2][0] } else { half[half.len() - 1] };
            assert!(turned.measured.angle_deg * sign > limit_deg, "{name} half {k} turned before its angle");
            sign = -sign;
        }
    }
    // A rig that never gets there: the lever is stuck, the time turns it.
    let mut playback = script("square_h")
        .compile(&Context { u_max_v: U_MAX_V, seed: 0, hands: profiles::Hands::Rig })
        .expect("compiles");
    let stuck = rt_core::Measurement { angle_deg: 3.0, ..rt_core::Measurement::NONE };
    let mut ticks = 0u64;
    while !rt_core::Reference::step(&mut playback, rt_core::Tick::at(ticks), &stuck).last {
        ticks += 1;
    }
    assert_eq!(ticks, 1000 + 8 * 7000);
}

#[test]
fn random_steps_have_closed_brake_and_open_bypass_and_respect_the_guard() {
    for name in ["random_a", "random_b"] {
        let rows = run(name);
        assert_eq!(rows.len(), 71_000, "{name}");
        let stretches = segments(&rows);
        let brake = stretches.iter().filter(|s| !s[0].step.brake_open).count();
        let bypass = stretches.iter().filter(|s| s[0].step.bypass_open).count();
        assert!(brake >= 2 && bypass >= 2, "{name}: {brake} with closed brake, {bypass} with open bypass");
        assert!(rows.iter().all(|r| r.step.brake_open || !r.step.bypass_open), "{name}: never both");
        for row in &rows {
            let outward = row.measured.angle_deg * voltage(row) > 0.0;
            assert!(!(outward && row.measured.angle_deg.abs() >= 25.0), "{name}: driven on beyond the guard");
        }
        for stretch in stretches {
            assert!(stretch.iter().all(|r| voltage(r) == voltage(&stretch[0])), "{name}: a segment of two voltages");
        }
    }
}

#[test]
fn the_seed_alone_decides_the_random_steps() {
    let a = script("random_a");
    assert_eq!(format!("{:?}", run_on(&a, EXAMPLE, 5)), format!("{:?}", run_on(&a, EXAMPLE, 5)));
    let volts = |rows: Vec<Row>| rows.iter().map(voltage).collect::<Vec<_>>();
    let first = volts(run_on(&a, EXAMPLE, 5));
    assert_ne!(first, volts(run_on(&a, EXAMPLE, 6)), "another seed, the same steps");
    assert_ne!(first, volts(run_on(&script("random_b"), EXAMPLE, 5)), "two scripts draw the same steps");
}

#[test]
fn the_examples_stay_within_25_degrees_and_their_targets_are_reached() {
    for script in examples() {
        assert_eq!(script.role, Role::Identify, "{}", script.name);
        for (rig, parameters) in plausible_rigs() {
            let rows = run_on(&script, parameters, 7);
            let place = format!("{} on {rig}", script.name);
            assert!(rows[..1000].iter().all(|r| voltage(r) == 0.0), "{place}: no second of rest");
            let mut most_deg: f64 = 0.0;
            let mut squares = (0.0, 0u32);
            for row in &rows[2000..] {
                most_deg = most_deg.max(row.measured.angle_deg.abs());
                if let Target::AngleDeg { angle_deg, .. } = row.step.target {
                    squares = (squares.0 + (row.measured.angle_deg - angle_deg).powi(2), squares.1 + 1);
                }
            }
            assert!((2.0..25.0).contains(&most_deg), "{place}: {most_deg} deg");
            let rms_deg = (squares.0 / f64::from(squares.1.max(1))).sqrt();
            assert!(rms_deg < 0.5, "{place}: {rms_deg} deg off its target");
            for segment in segments(&rows) {
                let row = segment[segment.len() - 1];
                let measured = row.measured;
                let off_bar = match row.step.target {
                    Target::PressureBar { of: ControlledPressure::Difference, bar } => {
                        measured.pressure1_bar - measured.pressure2_bar - bar
                    }
                    Target::PressureBar { bar, .. } => measured.pressure1_bar - bar,
                    _ => 0.0,
                };
                assert!(off_bar.abs() < 0.05, "{place}, step {}: {off_bar} bar off its target", row.step.index);
            }
        }
    }
}
