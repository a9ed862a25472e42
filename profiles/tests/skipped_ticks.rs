//! The loop may leave ticks out: what is played must not depend on it, as far as nothing measured decides.

use profiles::{Context, Playback, Script};
use proptest::prelude::*;
use rt_core::{Fixture, Measurement, Reference, Step, Target, Tick};

const HEAD: &str = r#"name = "t"
protocol = "random-steps"
role = "identify"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
[files]
"a.csv" = '''
time_s,value
0,0
0.02,0.7
0.05,0.2
'''
"#;

const MEASURED: Measurement =
    Measurement { angle_deg: 1.0, pressure1_bar: 3.0, pressure2_bar: 2.5, ..Measurement::NONE };

fn compile(steps: &str) -> Playback {
    let script = Script::parse(&format!("{HEAD}{steps}"), "t.toml").expect("parses");
    script.compile(&Context { u_max_v: 20.0, seed: 3, hands: profiles::Hands::Rig }).expect("compiles")
}

/// Every wave, within what every quantity allows.
const WAVES: &[&str] = &[
    "wave = \"step\", value = 0.4",
    "wave = \"ramp\", to = 0.9",
    "wave = \"ramp\", to = 0.2, rate_per_s = 9",
    "wave = \"ramp\", from = 0.3, to = 0.9, rate_per_s = 40",
    "wave = \"sine\", mean = 0.5, amplitude = 0.4, frequency_hz = 13",
    "wave = \"chirp\", mean = 0.5, amplitude = 0.4, from_hz = 3, to_hz = 70",
    "wave = \"chirp\", mean = 0.5, amplitude = 0.4, from_hz = 70, to_hz = 3, sweep = \"logarithmic\"",
    "wave = \"multisine\", mean = 0.5, amplitude = 0.4, band_hz = [20, 90], period_s = 0.1",
    "wave = \"random-steps\", range = [0.2, 0.8], length_s = [0.01, 0.02]",
    "wave = \"file\", file = \"a.csv\"",
    "wave = \"file\", file = \"a.csv\", interpolation = \"hold\"",
];

const QUANTITIES: &[&str] = &["voltage_v", "voltage_u_max", "flow_ml_s", "pressure_difference_bar", "angle_deg"];

/// The lines of a hold behind its `[[step]]`.
fn hold() -> impl Strategy<Value = String> {
    let drive = prop_oneof![
        Just(String::new()),
        (0.0..1.0f64).prop_map(|share| format!("voltage_u_max = {share}\n")),
        (0..QUANTITIES.len(), 0..WAVES.len())
            .prop_map(|(q, w)| format!("target = {{ quantity = \"{}\", {} }}\n", QUANTITIES[q], WAVES[w])),
    ];
    let other = prop_oneof![
        Just(""),
        Just("brake = \"closed\"\n"),
        Just("brake = \"open\"\nbypass = \"open\"\n"),
        Just("new_segment = false\n"),
        Just("fixture = \"free\"\n"),
        Just("fixture = \"clamped\"\nangle_deg = 3\n"),
    ];
    (drive, other, 1..60u32).prop_map(|(drive, other, ms)| format!("{drive}{other}for_s = {}\n", f64::from(ms) * 1e-3))
}

fn step() -> impl Strategy<Value = String> {
    prop_oneof![
        4 => hold().prop_map(|hold| format!("[[step]]\n{hold}")),
        1 => (-2.0..4.0f64).prop_map(|to| format!("[[step]]\nfixture = \"driven\"\nangle_deg = {to}\nrate_deg_s = 70\n")),
        1 => (1..5u32, hold(), hold())
            .prop_map(|(times, a, b)| format!("[[step]]\nrepeat = {times}\n[[step.step]]\n{a}[[step.step]]\n{b}")),
        1 => Just(
            "[[step]]\n[step.random]\ntotal_s = 0.2\nlength_s = [0.01, 0.05]\nvoltage_u_max = [0.1, 0.9]\nzero_share = 0.2\n\
             brake_closed_share = 0.3\nbypass_open_share = 0.3\nguard_deg = 20\n".to_owned()
        ),
    ]
}

proptest! {
    #[test]
    fn what_is_played_does_not_depend_on_the_ticks_left_out(
        steps in prop::collection::vec(step(), 1..8),
        first in 0..30u64,
        gaps in prop::collection::vec(prop_oneof![3 => 1..4u64, 2 => 1..200u64], 1..80),
    ) {
        let text: String = steps.concat();
        let mut whole = compile(&text);
        let dense: Vec<Step> = (0..whole.ticks_bound() + 100).map(|k| whole.step(Tick::at(k), &MEASURED)).collect();
        let length = dense.iter().position(|step| step.last).expect("an end") as u64 + 1;
        prop_assert!(dense[length as usize..].iter().all(|step| *step == dense[length as usize - 1]));

        let mut gappy = compile(&text);
        let mut tick = first;
        for gap in gaps.iter().cycle() {
            if tick >= dense.len() as u64 {
                break;
            }
            prop_assert_eq!(gappy.step(Tick::at(tick), &MEASURED), dense[tick as usize], "tick {}\n{}", tick, text);
            tick += gap;
        }
    }
}

fn angle(angle_deg: f64) -> Measurement {
    Measurement { angle_deg, ..Measurement::NONE }
}

fn volts(step: Step) -> f64 {
    match step.target {
        Target::VoltageV(voltage_v) => voltage_v,
        other => panic!("{other:?} where a voltage was expected"),
    }
}

const WAITS: &str = "[[step]]\nvoltage_v = 1\nfor_s = 0.01\n\
     [[step]]\nvoltage_v = 2\nuntil = [{ channel = \"angle_deg\", above = 5 }]\ntimeout_s = 0.02\n\
     [[step]]\nvoltage_v = 3\nfor_s = 0.01\n[[step]]\nvoltage_v = 4\nfor_s = 0.05\n";

#[test]
fn a_wait_goes_by_the_newest_measurement_and_its_timeout_is_on_time() {
    // (tick, angle) played, then the voltage and the step expected at the last.
    for (played, voltage_v, index) in [
        // Met while it was not looked at: it ends at the tick that sees it.
        (&[(0, 0.0), (12, 0.0), (17, 9.0)][..], 3.0, 2),
        (&[(0, 0.0), (12, 0.0), (17, 9.0), (26, 0.0)], 3.0, 2),
        (&[(0, 0.0), (12, 0.0), (17, 9.0), (27, 0.0)], 4.0, 3),
        // Begins within the gap, and is over by what is measured now.
        (&[(0, 0.0), (15, 9.0)], 3.0, 2),
        // At the tick at which it begins, it lasts.
        (&[(0, 0.0), (10, 9.0)], 2.0, 1),
        // The timeout at tick 30 is passed over: the next step began there.
        (&[(0, 0.0), (12, 0.0), (39, 9.0)], 3.0, 2),
        (&[(0, 0.0), (12, 0.0), (40, 9.0)], 4.0, 3),
    ] {
        let mut playback = compile(WAITS);
        let steps: Vec<Step> = played.iter().map(|&(k, deg)| playback.step(Tick::at(k), &angle(deg))).collect();
        let step = steps[steps.len() - 1];
        assert_eq!((volts(step), step.index, step.segment), (voltage_v, index, index), "{played:?}");
    }
}

#[test]
fn a_loop_is_left_by_the_newest_measurement() {
    let text = "[[step]]\nrepeat = 5\nstop_when = [{ channel = \"angle_deg\", above = 3 }]\n\
                [[step.step]]\nvoltage_v = 1.0\nfor_s = 0.005\n[[step.step]]\nvoltage_v = 2.0\nfor_s = 0.005\n\
                [[step]]\nvoltage_v = 9.0\nfor_s = 0.01\n";
    let mut playback = compile(text);
    assert_eq!(volts(playback.step(Tick::at(0), &angle(0.0))), 1.0);
    // The third pass began at tick 20; the fourth, at tick 30, is left out.
    assert_eq!(volts(playback.step(Tick::at(26), &angle(0.0))), 2.0);
    let step = playback.step(Tick::at(33), &angle(4.0));
    assert_eq!((volts(step), step.index), (9.0, 10));
    assert!(playback.step(Tick::at(40), &angle(0.0)).last, "it began at tick 30");
}

#[test]
fn a_rate_is_judged_by_time_not_by_ticks_played() {
    let text = "[[step]]\nuntil = [{ channel = \"angle_deg\", rate_below = 1, window_s = 0.05 }]\ntimeout_s = 3\n[[step]]\nfor_s = 1\n";
    for (slope_deg_s, settles) in [(0.8, true), (1.2, false)] {
        let mut playback = compile(text);
        let mut index = 0;
        for k in (0..2000).filter(|k| k % 7 == 0 || k % 10 < 3) {
            index = playback.step(Tick::at(k), &angle(slope_deg_s * k as f64 * 1e-3)).index;
        }
        assert_eq!(index == 1, settles, "{slope_deg_s} deg/s");
    }
}

#[test]
fn a_ramp_of_the_lever_that_was_passed_over_has_arrived() {
    let mut playback = compile(
        "[[step]]\nfixture = \"driven\"\nangle_deg = 3.0\nrate_deg_s = 50\n[[step]]\nfixture = \"driven\"\nangle_deg = 4.0\nrate_deg_s = 50\n\
         [[step]]\nfor_s = 0.1\n",
    );
    let fixture = |angle_deg| Fixture::Driven { angle_deg };
    assert_eq!(playback.step(Tick::at(0), &MEASURED).fixture, fixture(1.0));
    assert_eq!(playback.step(Tick::at(100), &MEASURED).fixture, fixture(4.0));
}

#[test]
fn random_steps_count_one_by_one() {
    let mut playback = compile(
        "[[step]]\nfor_s = 0.01\n[[step]]\n[step.random]\ntotal_s = 0.3\nlength_s = [0.01, 0.05]\nvoltage_u_max = [0.1, 0.9]\n\
         zero_share = 0\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n[[step]]\nvoltage_v = 0\nfor_s = 0.01\n",
    );
    let steps: Vec<Step> = (0..320).map(|k| playback.step(Tick::at(k), &MEASURED)).collect();
    let numbers: Vec<u32> = steps.chunk_by(|a, b| a.index == b.index).map(|run| run[0].index).collect();
    assert_eq!(numbers, (0..numbers.len() as u32).collect::<Vec<_>>());
    assert!((8..=32).contains(&numbers.len()), "{}", numbers.len());
    for run in steps.chunk_by(|a, b| a.index == b.index) {
        assert!(run.iter().all(|step| step.target == run[0].target && step.segment == run[0].index));
    }
}
