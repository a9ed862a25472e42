//! What a target's waves are: their values, their exact rates, their ranges, and what is said about a bad one.

use profiles::{Context, Playback, Script};
use rt_core::{ControlledPressure, Measurement, OverrunPolicy, Reference, Target, Tick};
use std::f64::consts::TAU;

const CONTEXT: Context = Context { u_max_v: 20.0, seed: 3, hands: profiles::Hands::Rig };

const HEAD: &str = r#"name = "t"
protocol = "square-wave"
role = "identify"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
"#;

const MEASURED: Measurement =
    Measurement { angle_deg: 4.0, pressure1_bar: 3.0, pressure2_bar: 2.5, ..Measurement::NONE };

fn compiled(steps: &str, seed: u64) -> Playback {
    let script = Script::parse(&format!("{HEAD}{steps}"), "t.toml").expect("parses");
    script.compile(&Context { seed, ..CONTEXT }).expect("compiles")
}

fn targets(steps: &str) -> Vec<Target> {
    let mut playback = compiled(steps, CONTEXT.seed);
    (0..playback.ticks_bound()).map(|k| playback.step(Tick::at(k), &MEASURED).target).collect()
}

/// Angle and velocity at each tick of one step with this target.
fn angles(target: &str, for_s: f64) -> Vec<(f64, f64)> {
    angles_of(&format!("[[step]]\ntarget = {{ quantity = \"angle_deg\", {target} }}\nfor_s = {for_s}\n"))
}

fn angles_of(steps: &str) -> Vec<(f64, f64)> {
    let angle = |target| match target {
        Target::AngleDeg { angle_deg, velocity_deg_s } => (angle_deg, velocity_deg_s),
        other => panic!("{other:?} where an angle was expected"),
    };
    targets(steps).into_iter().map(angle).collect()
}

fn assert_near(got: (f64, f64), expected: (f64, f64)) {
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9 * (1.0 + b.abs());
    assert!(near(got.0, expected.0) && near(got.1, expected.1), "{got:?}, expected {expected:?}");
}

#[test]
fn every_quantity_becomes_its_target_constant_or_as_a_wave() {
    let pressure = |of, bar| Target::PressureBar { of, bar };
    for (quantity, value, expected) in [
        ("voltage_v", 2.5, Target::VoltageV(2.5)),
        ("voltage_u_max", 0.5, Target::VoltageV(10.0)),
        ("flow_ml_s", -3.0, Target::FlowMlS(-3.0)),
        ("pressure1_bar", 3.5, pressure(ControlledPressure::Chamber1, 3.5)),
        ("pressure2_bar", 2.5, pressure(ControlledPressure::Chamber2, 2.5)),
        ("pressure_difference_bar", -1.5, pressure(ControlledPressure::Difference, -1.5)),
        ("angle_deg", -12.0, Target::AngleDeg { angle_deg: -12.0, velocity_deg_s: 0.0 }),
    ] {
        for target in [
            format!("{{ {quantity} = {value} }}"),
            format!("{{ quantity = \"{quantity}\", wave = \"step\", value = {value} }}"),
            format!(
                "{{ quantity = \"{quantity}\", wave = \"random-steps\", range = [{value}, {value}], length_s = [0.01, 0.02] }}"
            ),
            format!(
                "{{ quantity = \"{quantity}\", wave = \"sine\", mean = {value}, amplitude = 0, frequency_hz = 1 }}"
            ),
        ] {
            assert_eq!(targets(&format!("[[step]]\ntarget = {target}\nfor_s = 0.05\n")), vec![expected; 50]);
        }
    }
}

#[test]
fn a_sine_has_its_mean_amplitude_frequency_and_phase() {
    let wave = angles("wave = \"sine\", mean = 3, amplitude = 10, frequency_hz = 2, phase_deg = 90", 0.6);
    let top_rate = TAU * 2.0 * 10.0;
    assert_near(wave[0], (13.0, 0.0));
    assert_near(wave[125], (3.0, -top_rate));
    assert_near(wave[250], (-7.0, 0.0));
    assert_near(wave[375], (3.0, top_rate));
    assert_near(angles("wave = \"sine\", amplitude = 10, frequency_hz = 2", 0.1)[0], (0.0, top_rate));
}

#[test]
fn a_ramp_goes_over_its_step_or_at_its_rate_and_stays_at_its_end() {
    let own = angles("wave = \"ramp\", from = -5, to = 5, rate_per_s = 50", 0.3);
    assert_near(own[0], (-5.0, 50.0));
    assert_near(own[100], (0.0, 50.0));
    assert_eq!(own[200..], vec![(5.0, 0.0); 100]);
    // From the measured angle, over the step; the next step says nothing and the third goes on from there.
    let three = angles_of(
        "[[step]]\ntarget = { quantity = \"angle_deg\", wave = \"ramp\", to = 8 }\nfor_s = 0.1\n[[step]]\nbrake = \"closed\"\nfor_s = 0.1\n\
         [[step]]\ntarget = { quantity = \"angle_deg\", wave = \"ramp\", to = 6, rate_per_s = 10 }\nfor_s = 0.1\n",
    );
    assert_near(three[0], (4.0, 40.0));
    assert_near(three[50], (6.0, 40.0));
    assert_eq!(three[100], (8.0, 0.0));
    assert_near(three[200], (8.0, -10.0));
    assert_near(three[250], (7.5, -10.0));
}

#[test]
fn a_ramp_sets_out_from_the_target_in_force_the_measurement_or_rest() {
    let first = |before: &str, quantity: &str, to: f64| {
        let steps = format!(
            "[[step]]\n{before}\nfor_s = 0.001\n[[step]]\ntarget = {{ quantity = \"{quantity}\", wave = \"ramp\", to = {to} }}\nfor_s = 0.1\n"
        );
        targets(&steps)[1]
    };
    let difference = |bar| Target::PressureBar { of: ControlledPressure::Difference, bar };
    assert_eq!(first("voltage_v = 5", "voltage_u_max", 1.0), Target::VoltageV(5.0));
    assert_eq!(first("target = { angle_deg = 1 }", "voltage_v", 1.0), Target::VoltageV(0.0));
    assert_eq!(first("voltage_v = 5", "flow_ml_s", 1.0), Target::FlowMlS(0.0));
    assert_eq!(first("target = { pressure_difference_bar = 1 }", "pressure_difference_bar", 0.0), difference(1.0));
    assert_eq!(first("target = { pressure1_bar = 1 }", "pressure_difference_bar", 0.0), difference(0.5));
    // From where a wave is by then.
    let moving = angles_of(
        "[[step]]\ntarget = { quantity = \"angle_deg\", wave = \"sine\", amplitude = 10, frequency_hz = 10 }\nfor_s = 0.02\n\
         [[step]]\ntarget = { quantity = \"angle_deg\", wave = \"ramp\", to = 0, rate_per_s = 5 }\nfor_s = 0.1\n",
    );
    assert_near(moving[20], (10.0 * (TAU * 0.2).sin(), -5.0));
    // Nothing measured: the end at once.
    let mut playback =
        compiled("[[step]]\ntarget = { quantity = \"angle_deg\", wave = \"ramp\", to = 8 }\nfor_s = 0.1\n", 0);
    let blind = playback.step(Tick::at(0), &Measurement::NONE).target;
    assert!(matches!(blind, Target::AngleDeg { angle_deg: 8.0, .. }), "{blind:?}");
}

#[test]
fn a_chirp_passes_its_frequencies_and_stops_at_the_end_of_its_step() {
    for (sweep, middle_hz, cycles) in [("linear", 2.5, 10.0), ("logarithmic", 2.0, 4.0 * 3.0 / 4f64.ln())] {
        let target = format!(
            "quantity = \"angle_deg\", wave = \"chirp\", amplitude = 10, from_hz = 1, to_hz = 4, sweep = \"{sweep}\""
        );
        let wave = angles_of(&format!("[[step]]\ntarget = {{ {target} }}\nfor_s = 4\n[[step]]\nfor_s = 0.1\n"));
        // rate^2 / (A^2 - value^2) is the square of the frequency.
        let hz = |k: usize| wave[k].1.abs() / (100.0 - wave[k].0.powi(2)).sqrt() / TAU;
        assert_near((hz(0), hz(2000)), (1.0, middle_hz));
        assert!((hz(3990) - 4.0).abs() < 0.02, "{}", hz(3990));
        assert_near((wave[4000].0, wave[4000].1), (10.0 * (TAU * cycles).sin(), 0.0));
        assert!(wave[4000..].iter().all(|point| *point == wave[4000]), "does not stay");
    }
    let sine = angles("wave = \"sine\", amplitude = 10, frequency_hz = 3", 1.0);
    let chirp = angles("wave = \"chirp\", amplitude = 10, from_hz = 3, to_hz = 3, sweep = \"logarithmic\"", 1.0);
    sine.iter().zip(&chirp).for_each(|(a, b)| assert_near(*a, *b));
}

#[test]
fn a_multisine_has_its_lines_alone_alike_and_its_peak() {
    let band = "wave = \"multisine\", mean = 2, amplitude = 10, band_hz = [1, 8], period_s = 1";
    let wave = angles(band, 2.0);
    assert_eq!(wave[..1000], wave[1000..], "not periodic");
    let values: Vec<f64> = wave[..1000].iter().map(|point| point.0 - 2.0).collect();
    let peak = values.iter().fold(0.0, |peak: f64, value| peak.max(value.abs()));
    assert!((peak - 10.0).abs() < 1e-9, "{peak}");
    assert!(values.iter().all(|value| value.abs() >= values[0].abs()), "begins with a kick of {}", values[0]);
    let line = |k: usize| {
        let part = |shift: f64| -> f64 {
            let turn = |n: usize| TAU * (k * n) as f64 / 1000.0 + shift;
            values.iter().enumerate().map(|(n, value)| value * turn(n).cos()).sum::<f64>() / 500.0
        };
        part(0.0).hypot(part(TAU / 4.0))
    };
    for k in 0..50 {
        let expected = if (1..=8).contains(&k) { line(1) } else { 0.0 };
        assert!((line(k) - expected).abs() < 1e-9, "line {k}: {}", line(k));
    }
    // Eight lines in phase have a crest factor of 4; Schroeder's phases about 1.7.
    let crest = peak / (values.iter().map(|value| value * value).sum::<f64>() / 1000.0).sqrt();
    assert!(crest < 2.0, "{crest}");
    let list = angles(
        "wave = \"multisine\", mean = 2, amplitude = 10, frequencies_hz = [8, 1, 2, 3, 4, 5, 6, 7], period_s = 1",
        2.0,
    );
    assert_eq!(list, wave);
}

#[test]
fn random_steps_keep_their_ranges_and_follow_the_seed() {
    let target =
        "target = { quantity = \"angle_deg\", wave = \"random-steps\", range = [-7, 9], length_s = [0.05, 0.2] }";
    let steps = format!("[[step]]\n{target}\nfor_s = 20\n[[step]]\n{target}\nfor_s = 20\n");
    let wave = angles_of(&steps);
    assert!(wave.iter().all(|(value, rate)| (-7.0..=9.0).contains(value) && *rate == 0.0));
    let (first, second) = wave.split_at(20_000);
    let runs: Vec<&[(f64, f64)]> = first.chunk_by(|a, b| a == b).collect();
    assert!((100..=400).contains(&runs.len()), "{}", runs.len());
    for run in &runs[..runs.len() - 1] {
        assert!((50..=200).contains(&run.len()), "{} ticks", run.len());
    }
    assert!(first.iter().any(|p| p.0 < -5.0) && first.iter().any(|p| p.0 > 7.0), "the range is not used");
    assert_ne!(first, second, "two waves draw the same");
    let value = |seed| compiled(&steps, seed).step(Tick::at(0), &MEASURED).target;
    assert_eq!(value(4), value(4));
    assert_ne!(value(4), value(5));
}

#[test]
fn a_table_is_joined_by_lines_or_held_and_stays_at_its_end() {
    let file = "[files]\n\"a.csv\" = '''\ntime_s, value\n0, 1\n0.1, 3\n0.103, -3\n'''\n";
    let wave = |interpolation: &str| {
        angles_of(&format!(
            "[[step]]\ntarget = {{ quantity = \"angle_deg\", wave = \"file\", file = \"a.csv\"{interpolation} }}\nfor_s = 0.2\n{file}"
        ))
    };
    let linear = wave("");
    assert_near(linear[0], (1.0, 20.0));
    assert_near(linear[50], (2.0, 20.0));
    assert_near(linear[100], (3.0, -2000.0));
    assert_near(linear[101], (1.0, -2000.0));
    assert_eq!(linear[103..], vec![(-3.0, 0.0); 97]);
    assert_eq!(linear, wave(", interpolation = \"linear\""));
    let held = wave(", interpolation = \"hold\"");
    assert_eq!(
        (held[0], held[99], held[100], held[102], held[103]),
        ((1.0, 0.0), (1.0, 0.0), (3.0, 0.0), (3.0, 0.0), (-3.0, 0.0))
    );
}

#[test]
fn the_velocity_is_the_derivative_of_the_angle() {
    for target in [
        "wave = \"sine\", mean = 1, amplitude = 10, frequency_hz = 1.3, phase_deg = 20",
        "wave = \"chirp\", amplitude = 10, from_hz = 0.2, to_hz = 2, phase_deg = 20",
        "wave = \"chirp\", amplitude = 10, from_hz = 2, to_hz = 0.2, sweep = \"logarithmic\"",
        "wave = \"multisine\", amplitude = 10, frequencies_hz = [0.2, 0.6, 1.4, 2.2], period_s = 5",
        "wave = \"ramp\", from = -3, to = 20",
    ] {
        let wave = angles(target, 3.0);
        for k in 1..wave.len() - 1 {
            let slope = (wave[k + 1].0 - wave[k - 1].0) / 2e-3;
            assert!((slope - wave[k].1).abs() < 0.02, "{target} at tick {k}: {slope}, said {}", wave[k].1);
        }
    }
}

#[test]
fn variables_stand_for_any_number_of_a_wave() {
    let looped = angles_of(
        "[[step]]\nfor_each = { a = [2, 3], f = [10, 20], l = [0.01, 0.02] }\n[[step.step]]\n\
         target = { quantity = \"angle_deg\", wave = \"sine\", amplitude = \"$a\", frequency_hz = \"$f\" }\nfor_s = 0.05\n[[step.step]]\n\
         target = { quantity = \"angle_deg\", wave = \"random-steps\", range = [\"$a\", \"$a\"], length_s = [\"$l\", 0.03] }\nfor_s = 0.05\n[[step.step]]\n\
         target = { quantity = \"angle_deg\", wave = \"multisine\", amplitude = \"$a\", frequencies_hz = [\"$f\", 30], period_s = 0.1 }\nfor_s = 0.1\n",
    );
    assert_near(looped[25], (2.0, 0.0));
    assert_near(looped[200 + 12], (3.0 * (TAU * 0.24).sin(), 3.0 * TAU * 20.0 * (TAU * 0.24).cos()));
    assert_eq!((looped[60], looped[260]), ((2.0, 0.0), (3.0, 0.0)));
    for (pass, peak) in [(0, 2.0), (200, 3.0)] {
        let most = looped[pass + 100..pass + 200].iter().fold(0.0, |most: f64, p| most.max(p.0.abs()));
        assert!((most - peak).abs() < 1e-9, "{most}");
    }
}

#[test]
fn the_overrun_policy_is_the_scripts() {
    let with = |word: &str| Script::parse(&format!("overrun = \"{word}\"\n{HEAD}[[step]]\nfor_s = 1\n"), "t.toml");
    for policy in OverrunPolicy::ALL {
        assert_eq!(with(policy.as_str()).expect("a policy").overrun, policy);
    }
    let error = with("panic").expect_err("no policy");
    assert_eq!((error.line, error.what.contains("catch-up")), (1, true), "{error}");
    let silent = Script::parse(&format!("{HEAD}[[step]]\nfor_s = 1\n"), "t.toml").expect("parses");
    assert_eq!(silent.overrun, OverrunPolicy::Skip);
}

/// The target (on line 10), the line of the error, and a part of its message.
const BAD_TARGETS: &[(&str, usize, &str)] = &[
    ("{}", 10, "got neither"),
    ("{ angle_deg = 1, flow_ml_s = 2 }", 10, "stands alone"),
    ("{ angle_deg = 1, wave = \"sine\" }", 10, "stands alone"),
    ("{ angle_deg = 1, amplitude = 2 }", 10, "stands alone"),
    ("{ quantity = \"angle_deg\" }", 10, "`quantity` and `wave`"),
    ("{ wave = \"sine\", amplitude = 1, frequency_hz = 1 }", 10, "`quantity` and `wave`"),
    ("{ quantity = \"angle\", wave = \"step\", value = 1 }", 10, "unknown variant `angle`"),
    ("{ quantity = \"angle_deg\", wave = \"square\", value = 1 }", 10, "unknown variant `square`"),
    ("{ quantity = \"angle_deg\", wave = \"step\" }", 10, "`value` is missing"),
    ("{ quantity = \"angle_deg\", wave = \"step\", value = 1, mean = 2 }", 10, "has no `mean`"),
    ("{ quantity = \"angle_deg\", wave = \"sine\", amplitude = 1 }", 10, "`frequency_hz` is missing"),
    ("{ quantity = \"angle_deg\", wave = \"sine\", amplitude = -1, frequency_hz = 1 }", 10, "got -1"),
    ("{ quantity = \"angle_deg\", wave = \"sine\", amplitude = 1, frequency_hz = 0 }", 10, "200, got 0"),
    ("{ quantity = \"angle_deg\", wave = \"sine\", amplitude = 1, frequency_hz = 400 }", 10, "got 400"),
    ("{ quantity = \"angle_deg\", wave = \"sine\", amplitude = \"$a\", frequency_hz = 1 }", 10, "in scope: none"),
    ("{ angle_deg = 46 }", 10, "-45 .. 45, got 46"),
    ("{ pressure1_bar = 0 }", 10, "0.1 .. 8, got 0"),
    ("{ pressure_difference_bar = -8 }", 10, "-7.9 .. 7.9, got -8"),
    ("{ voltage_u_max = 1.01 }", 10, "-1 .. 1, got 1.01"),
    ("{ quantity = \"angle_deg\", wave = \"step\", value = 46 }", 10, "reaches 46 `angle_deg`"),
    ("{ quantity = \"angle_deg\", wave = \"sine\", mean = -30, amplitude = 20, frequency_hz = 1 }", 10, "reaches -50"),
    ("{ quantity = \"pressure2_bar\", wave = \"sine\", amplitude = 1, frequency_hz = 1 }", 10, "0.1 .. 8"),
    ("{ quantity = \"angle_deg\", wave = \"ramp\", to = 60 }", 10, "reaches 60"),
    ("{ quantity = \"angle_deg\", wave = \"ramp\", from = -60, to = 6 }", 10, "reaches -60"),
    ("{ quantity = \"angle_deg\", wave = \"ramp\", to = 6, rate_per_s = 0 }", 10, "`rate_per_s` must lie within"),
    (
        "{ quantity = \"voltage_u_max\", wave = \"chirp\", mean = 0.5, amplitude = 0.6, from_hz = 1, to_hz = 2 }",
        10,
        "reaches 1.1",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"chirp\", amplitude = 1, from_hz = 1, to_hz = 2, sweep = \"cubic\" }",
        10,
        "cubic",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 50, band_hz = [1, 2], period_s = 1 }",
        10,
        "reaches 50",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 1 }",
        10,
        "one of `frequencies_hz` and `band_hz`",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 0.0105, band_hz = [1, 2] }",
        10,
        "whole number of milliseconds",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 1, band_hz = [0.2, 0.8] }",
        10,
        "no multiple of",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 1, band_hz = [2, 1] }",
        10,
        "[smallest, largest]",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 2, frequencies_hz = [1.2] }",
        10,
        "the nearest is 1",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 2, frequencies_hz = [1, 1] }",
        10,
        "1 Hz twice",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 2, frequencies_hz = [] }",
        10,
        "no multiple of",
    ),
    (
        "{ quantity = \"angle_deg\", wave = \"multisine\", amplitude = 1, period_s = 600, band_hz = [1, 200] }",
        10,
        "too many to prepare",
    ),
    ("{ quantity = \"angle_deg\", wave = \"random-steps\", range = [-50, 5], length_s = [1, 2] }", 10, "reaches -50"),
    ("{ quantity = \"angle_deg\", wave = \"random-steps\", range = [5, -5], length_s = [1, 2] }", 10, "got [5, -5]"),
    ("{ quantity = \"angle_deg\", wave = \"random-steps\", range = [0, 5], length_s = [0, 2] }", 10, "got [0, 2]"),
    ("{ quantity = \"angle_deg\", wave = \"random-steps\", range = [0, 5] }", 10, "`length_s` is missing"),
    ("{ quantity = \"angle_deg\", wave = \"file\", file = \"a.csv\" }", 10, "was not read from a folder"),
    ("{ quantity = \"angle_deg\", wave = \"step\", value = 1, colour = 2 }", 10, "unknown field `colour`"),
];

#[test]
fn a_bad_target_is_refused_with_file_line_and_reason() {
    for (target, line, reason) in BAD_TARGETS {
        let text = format!("{HEAD}[[step]]\ntarget = {target}\nfor_s = 1\n");
        let error = Script::parse(&text, "bad.toml").expect_err(target);
        assert_eq!((error.file.as_str(), error.line), ("bad.toml", *line), "{error}\n{target}");
        assert!(error.what.contains(reason), "{error}\nexpected: {reason}\n{target}");
    }
    for (step, line, reason) in [
        ("[[step]]\nvoltage_v = 1\ntarget = { angle_deg = 1 }\nfor_s = 1\n", 11, "only one of"),
        ("[[step]]\nrepeat = 2\ntarget = { angle_deg = 1 }\n[[step.step]]\nfor_s = 1\n", 11, "inner [[step.step]]"),
        (
            "[[step]]\nfixture = \"driven\"\nangle_deg = 3\nrate_deg_s = 1\ntarget = { quantity = \"flow_ml_s\", wave = \"ramp\", to = 1 }\n",
            13,
            "neither `for_s` nor `timeout_s`",
        ),
    ] {
        let error = Script::parse(&format!("{HEAD}{step}"), "bad.toml").expect_err(step);
        assert_eq!((error.line, error.what.contains(reason)), (line, true), "{error}");
    }
    let over = "{ quantity = \"voltage_v\", wave = \"sine\", mean = 15, amplitude = 6, frequency_hz = 1 }";
    let script = Script::parse(&format!("{HEAD}[[step]]\ntarget = {over}\nfor_s = 1\n"), "t.toml").expect("parses");
    let error = script.compile(&CONTEXT).expect_err("21 V on a rig of 20 V");
    assert_eq!((error.line, error.what.contains("reaches 21 V")), (9, true), "{error}");
}
