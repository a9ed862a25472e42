//! The script language: what holds, loops, ramps and conditions do, and what is said about a bad script.

use profiles::{Context, LoadError, Playback, Script, load_folder};
use rt_core::{Fixture, Limits, Measurement, Reference, Step, Target, Tick};

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

fn compile(steps: &str) -> Playback {
    let script = Script::parse(&format!("{HEAD}{steps}"), "t.toml").expect("parses");
    script.compile(&CONTEXT).expect("compiles")
}

/// All steps up to the last, with the angle as a function of the tick.
fn steps(playback: &mut Playback, angle_deg: impl Fn(u64) -> f64) -> Vec<Step> {
    let mut steps = Vec::new();
    for k in 0..100_000 {
        let measured = Measurement { angle_deg: angle_deg(k), ..Measurement::NONE };
        steps.push(playback.step(Tick::at(k), &measured));
        if steps[steps.len() - 1].last {
            return steps;
        }
    }
    panic!("no end");
}

fn volts(step: &Step) -> f64 {
    match step.target {
        Target::VoltageV(v) => v,
        _ => f64::NAN,
    }
}

#[test]
fn holds_last_their_ticks_and_keep_what_they_do_not_say() {
    let mut playback = compile(
        "[[step]]\nvoltage_v = 2.0\nbrake = \"closed\"\nfor_s = 0.003\n[[step]]\nvoltage_u_max = -0.5\nfor_s = 0.002\n\
         [[step]]\nnew_segment = false\nflow_ml_s = 4\nbypass = \"open\"\nfor_s = 0.001\n",
    );
    assert_eq!(playback.ticks_bound(), 6);
    let steps = steps(&mut playback, |_| 0.0);
    assert_eq!(steps.iter().map(|s| s.segment).collect::<Vec<_>>(), [0, 0, 0, 1, 1, 1]);
    assert_eq!(steps[..5].iter().map(volts).collect::<Vec<_>>(), [2.0, 2.0, 2.0, -10.0, -10.0]);
    assert_eq!(steps[5].target, Target::FlowMlS(4.0));
    assert!(steps.iter().all(|s| !s.brake_open));
    assert_eq!(steps.iter().map(|s| s.bypass_open).collect::<Vec<_>>(), [false, false, false, false, false, true]);
    let after = playback.step(Tick::at(6), &Measurement::NONE);
    assert_eq!(after, steps[5], "after the end the last step stays");
}

#[test]
fn until_ends_at_the_tick_that_meets_it_or_at_the_timeout() {
    let text = "[[step]]\nvoltage_v = 1.0\nuntil = [{ channel = \"angle_deg\", above = 5 }, { channel = \"angle_deg\", below = -5 }]\n\
                timeout_s = 0.02\n[[step]]\nvoltage_v = 0.0\nfor_s = 0.001\n";
    let ends = |angle: &dyn Fn(u64) -> f64| steps(&mut compile(text), angle).len() - 1;
    assert_eq!(ends(&|k| k as f64), 6);
    assert_eq!(ends(&|k| -(k as f64) * 0.5), 11);
    assert_eq!(ends(&|_| 0.0), 20);
    assert_eq!(ends(&|_| f64::NAN), 20);
    assert_eq!(ends(&|_| 9.0), 1, "a hold lasts one tick at least");
}

#[test]
fn a_run_that_ends_on_a_condition_says_last_at_that_tick() {
    let mut playback =
        compile("[[step]]\nvoltage_v = 1.0\nuntil = [{ channel = \"angle_deg\", above = 5 }]\ntimeout_s = 1.0\n");
    let steps = steps(&mut playback, |k| k as f64);
    assert_eq!(steps.len(), 7);
    assert!(steps.iter().all(|s| volts(s) == 1.0 && s.segment == 0));
}

#[test]
fn loops_nest_and_variables_walk_together() {
    let mut playback = compile(
        "[[step]]\nfor_each = { a = [1, 2], b = [10, 20] }\n[[step.step]]\nrepeat = 2\n[[step.step.step]]\nvoltage_v = \"$a\"\nfor_s = 0.001\n\
         [[step.step]]\nvoltage_v = \"$b\"\nfor_s = 0.001\n",
    );
    let steps = steps(&mut playback, |_| 0.0);
    assert_eq!(steps.iter().map(volts).collect::<Vec<_>>(), [1.0, 1.0, 10.0, 2.0, 2.0, 20.0]);
}

#[test]
fn stop_when_leaves_the_loop_before_a_pass_and_what_was_skipped_changes_nothing() {
    let text = "[[step]]\nvoltage_v = 7.0\nfor_s = 0.001\n[[step]]\nrepeat = 5\nstop_when = [{ channel = \"angle_deg\", above = 3 }]\n\
                [[step.step]]\nvoltage_v = 1.0\nfor_s = 0.002\n[[step.step]]\nvoltage_v = 2.0\nbrake = \"closed\"\nfor_s = 0.001\n\
                [[step]]\nfor_s = 0.001\n";
    let run = |angle: &dyn Fn(u64) -> f64| steps(&mut compile(text), angle);
    assert_eq!(run(&|_| 0.0).len(), 1 + 5 * 3 + 1);
    // Seen first before the pass that would begin at tick 4.
    let stopped = run(&|k| k as f64);
    assert_eq!(stopped.iter().map(volts).collect::<Vec<_>>(), [7.0, 1.0, 1.0, 2.0, 2.0]);
    let never = run(&|_| 9.0);
    assert_eq!(never.iter().map(volts).collect::<Vec<_>>(), [7.0, 7.0]);
    assert!(never.iter().all(|s| s.brake_open), "the valve of a skipped pass was set");
}

#[test]
fn a_driven_lever_ramps_from_where_it_is_and_the_step_ends_on_arrival() {
    let mut playback = compile(
        "[[step]]\nfixture = \"driven\"\nangle_deg = 2.0\nrate_deg_s = 50.0\n\
         [[step]]\nfixture = \"driven\"\nangle_deg = -40.0\nrate_deg_s = 50.0\nuntil = [{ channel = \"pressure1_bar\", above = 3 }]\n\
         [[step]]\nfor_s = 0.002\n",
    );
    let mut steps = Vec::new();
    for k in 0..1000 {
        // Free at 1 degree at first; the pressure stops the second ramp at tick 61.
        let pressure1_bar = if k < 61 { 2.0 } else { 4.0 };
        let measured = Measurement { angle_deg: 1.0, pressure1_bar, ..Measurement::NONE };
        steps.push(playback.step(Tick::at(k), &measured));
        if steps[steps.len() - 1].last {
            break;
        }
    }
    let angle = |k: usize| match steps[k].fixture {
        Fixture::Driven { angle_deg } => angle_deg,
        other => panic!("tick {k}: {other:?}"),
    };
    assert_eq!((angle(0), angle(10), angle(20)), (1.0, 1.5, 2.0));
    assert_eq!(steps[21].segment, 1);
    assert!((angle(31) - 1.5).abs() < 1e-9, "the second ramp begins where the first ended");
    assert_eq!(steps.len(), 63);
    assert!(angle(61) == angle(60) && angle(62) == angle(60), "stays where it was stopped");
}

#[test]
fn duration_bound_counts_every_wait_and_the_ways_of_the_lever() {
    let text = format!(
        "{HEAD}[[step]]\nfor_s = 1.5\n[[step]]\nrepeat = 3\nstop_when = [{{ channel = \"angle_deg\", above = 3 }}]\n[[step.step]]\nvoltage_v = 1\n\
         until = [{{ channel = \"angle_deg\", above = 3 }}]\ntimeout_s = 2.0\n\
         [[step]]\nfixture = \"clamped\"\nangle_deg = -10\nfor_s = 1.0\n\
         [[step]]\nfixture = \"driven\"\nangle_deg = 10\nrate_deg_s = 5\n"
    );
    let bound_s = Script::parse(&text, "t.toml").expect("parses").duration_bound_s();
    assert!((bound_s - (1.5 + 6.0 + 1.0 + 4.0)).abs() < 0.01, "{bound_s}");
}

#[test]
fn a_voltage_beyond_the_rig_is_refused_with_its_line() {
    let text = format!("{HEAD}[[step]]\nvoltage_v = 12\nfor_s = 1\n\n[[step]]\nvoltage_v = -20.5\nfor_s = 1\n");
    let script = Script::parse(&text, "a/b.toml").expect("parses");
    let error = script.compile(&CONTEXT).expect_err("20.5 V on a rig of 20 V");
    assert_eq!((error.file.as_str(), error.line), ("a/b.toml", 13));
    assert!(error.to_string().contains("-20.5") && error.to_string().contains("20 V"), "{error}");
    for u_max_v in [0.0, -24.0, f64::NAN, f64::INFINITY] {
        assert!(script.compile(&Context { u_max_v, seed: 0, hands: profiles::Hands::Rig }).is_err(), "{u_max_v}");
    }
}

/// Every kind of mistake: the steps (appended to HEAD, so that line 9 is their first), the line, and a part of the message.
const BAD_STEPS: &[(&str, usize, &str)] = &[
    ("", 1, "at least one [[step]]"),
    ("[[step]]\nvoltage_v = \n", 10, ""),
    ("[[step]]\nfor_s = 1\nspeed = 3\n", 11, "unknown field `speed`"),
    ("[[step]]\nvoltage_v = \"2\"\nfor_s = 1\n", 10, "a number, or"),
    ("[[step]]\nvoltage_v = true\nfor_s = 1\n", 10, "a number, or"),
    ("[[step]]\nvoltage_v = nan\nfor_s = 1\n", 10, "finite"),
    ("[[step]]\nvoltage_v = 1\nvoltage_v = 2\nfor_s = 1\n", 11, "duplicate"),
    ("[[step]]\nvoltage_v = 1\nflow_ml_s = 2\nfor_s = 1\n", 11, "only one of"),
    ("[[step]]\nvoltage_u_max = 1.2\nfor_s = 1\n", 10, "-1 .. 1, got 1.2"),
    ("[[step]]\nbrake = \"ajar\"\nfor_s = 1\n", 10, "ajar"),
    ("[[step]]\nvoltage_v = 1\n", 9, "`for_s`, or `until`"),
    ("[[step]]\nfor_s = 0\n", 10, "`for_s` must lie within"),
    ("[[step]]\nfor_s = -1\n", 10, "got -1"),
    ("[[step]]\nuntil = []\ntimeout_s = 1\n", 10, "at least one condition"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", above = 1 }]\n", 10, "needs a `timeout_s`"),
    ("[[step]]\ntimeout_s = 1\n", 10, "belongs to `until`"),
    ("[[step]]\nfor_s = 1\nuntil = [{ channel = \"angle_deg\", above = 1 }]\n", 11, "got both"),
    ("[[step]]\nuntil = [\n  { channel = \"angle\", above = 1 },\n]\ntimeout_s = 1\n", 11, "unknown variant `angle`"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\" }]\ntimeout_s = 1\n", 10, "exactly one of"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", above = 1, below = 2 }]\ntimeout_s = 1\n", 10, "exactly one of"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", rate_below = 1 }]\ntimeout_s = 1\n", 10, "`window_s`"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 1 }]\ntimeout_s = 1\n", 10, "`for_s`"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", for_s = 1 }]\ntimeout_s = 1\n", 10, "`steady_within`"),
    (
        "[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 1, for_s = 1, above = 3 }]\ntimeout_s = 1\n",
        10,
        "exactly one of",
    ),
    (
        "[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 0, for_s = 1 }]\ntimeout_s = 2\n",
        10,
        "`steady_within` must lie within",
    ),
    (
        "[[step]]\nuntil = [{ channel = \"angle_deg\", steady_within = 1, for_s = 2 }]\ntimeout_s = 2\n",
        11,
        "can't be met within `timeout_s` = 2",
    ),
    ("[[step]]\nuntil = [{ channel = \"pressure1_bar\", above = 300 }]\ntimeout_s = 2\n", 10, "300 kPa are 3 bar"),
    ("[[step]]\nuntil = [{ channel = \"angle_deg\", below = -400 }]\ntimeout_s = 2\n", 10, "-90 .. 90, got -400"),
    ("[[step]]\nangle_deg = 3\nfor_s = 1\n", 10, "needs `fixture`"),
    ("[[step]]\nfixture = \"glued\"\nfor_s = 1\n", 10, "glued"),
    ("[[step]]\nfixture = \"clamped\"\nfor_s = 1\n", 10, "`angle_deg` is missing"),
    ("[[step]]\nfixture = \"clamped\"\nangle_deg = 50\nfor_s = 1\n", 11, "-45 .. 45, got 50"),
    ("[[step]]\nfixture = \"free\"\nangle_deg = 5\nfor_s = 1\n", 11, "has no `angle_deg`"),
    ("[[step]]\nfixture = \"driven\"\nangle_deg = 5\nrate_deg_s = 0\n", 12, "`rate_deg_s` must lie within"),
    ("[[step]]\nfixture = \"driven\"\nangle_deg = 5\nrate_deg_s = 1\nfor_s = 3\n", 13, "remove `for_s`"),
    ("[[step]]\nfixture = \"filled\"\nangle_deg = 5\npressure1_bar = 9\npressure2_bar = 2\nfor_s = 1\n", 12, "got 9"),
    ("[[step]]\nfixture = \"released\"\nangle_deg = 5\nrelease_ml_s = -1\nfor_s = 1\n", 12, "got -1"),
    ("[[step]]\nfixture = \"pump-bench\"\npressure1_bar = 2\nfor_s = 1\n", 10, "`pressure2_bar` is missing"),
    ("[[step]]\nrepeat = 0\n[[step.step]]\nfor_s = 1\n", 10, "at least 1, got 0"),
    ("[[step]]\nrepeat = -2\n[[step.step]]\nfor_s = 1\n", 10, "-2"),
    ("[[step]]\nrepeat = 2\n", 10, "needs inner steps"),
    ("[[step]]\nrepeat = 2\nfor_s = 1\n[[step.step]]\nfor_s = 1\n", 11, "inner [[step.step]]"),
    ("[[step]]\nrepeat = 4000000000\n[[step.step]]\nfor_s = 1\n", 11, "more than"),
    ("[[step]]\nrepeat = 2\nfor_each = { a = [1] }\n[[step.step]]\nfor_s = \"$a\"\n", 9, "got several"),
    (
        "[[step]]\nrepeat = 2\nstop_when = [{ channel = \"angle_deg\", rate_below = 1, window_s = 1 }]\n[[step.step]]\nfor_s = 1\n",
        11,
        "exactly one of",
    ),
    ("[[step]]\nfor_s = 1\nstop_when = [{ channel = \"angle_deg\", above = 1 }]\n", 11, "belongs to `repeat`"),
    ("[[step]]\nfor_s = 1\n[[step.step]]\nfor_s = 1\n", 9, "need `repeat` or `for_each`"),
    ("[[step]]\nvoltage_u_max = 60\nfor_s = 1\n", 10, "it is a fraction: 60 % are 0.6"),
    ("[[step]]\nfor_s = 100000\n", 10, "100000 ms are 100 s"),
    (
        "[[step]]\nfixture = \"filled\"\nangle_deg = 5\npressure1_bar = 500\npressure2_bar = 2\nfor_s = 1\n",
        12,
        "`pressure1_bar` must lie within 0.1 .. 8, got 500; write it in bar: 500 kPa are 5 bar, 500 mbar are 0.5 bar",
    ),
    (
        "[[step]]\nfixture = \"pump-bench\"\npressure1_bar = 40\npressure2_bar = 2\nfor_s = 1\n",
        11,
        "40 psi are 2.757903 bar",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 10, step = 3 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "set `to` to 9 or 12",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = -1, step = 3 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "set `to` to 0 or -3",
    ),
    ("[[step]]\nfor_each = { a = { from = 0, to = 10, step = -5 } }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "got -5"),
    (
        "[[step]]\nfor_each = { a = { from = 1, to = 1, count = 2 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "must differ",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 1, count = 1 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "2 .. 10000, got 1",
    ),
    ("[[step]]\nfor_each = { a = { from = 0, to = 1 } }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "one of `step`"),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 1, step = 1, count = 2 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "one of `step`",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, to = 1, step = 1e-6 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "more than 10000",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 0, till = 1, step = 1 } }\n[[step.step]]\nfor_s = \"$a\"\n",
        10,
        "unknown field `till`",
    ),
    (
        "[[step]]\nfor_each = { a = { from = 1, to = 3, step = 1 }, b = [1, 2] }\n[[step.step]]\nvoltage_v = \"$a\"\nfor_s = \"$b\"\n",
        10,
        "`a` has 3, `b` 2",
    ),
    ("[[step]]\nfor_s = 1\n[envelope]\npressure_max_bar = 500\n", 12, "500 kPa are 5 bar"),
    ("[[step]]\nfor_s = 1\n[envelope]\nangle_max_deg = 0\n", 12, "0.1 .. 90, got 0"),
    (
        "[[step]]\nfor_s = 1\n[envelope]\npressure_max_bar = 2\npressure_min_bar = 3\n",
        11,
        "below `pressure_max_bar` = 2",
    ),
    ("[[step]]\nfor_s = 1\n[envelope]\nslew_max_v_s = 2\n", 12, "unknown field `slew_max_v_s`"),
    ("[[step]]\nfor_s = 1\n[envelope]\nangle_max_deg = \"$a\"\n", 12, "in scope: none"),
    ("[[step]]\nfor_each = {}\n[[step.step]]\nfor_s = 1\n", 10, "at least one list"),
    ("[[step]]\nfor_each = { a = [] }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "at least 1"),
    (
        "[[step]]\nfor_each = { a = [1, 2], b = [1] }\n[[step.step]]\nvoltage_v = \"$b\"\nfor_s = \"$a\"\n",
        10,
        "`a` has 2, `b` 1",
    ),
    ("[[step]]\nfor_each = { a = [1, inf] }\n[[step.step]]\nfor_s = \"$a\"\n", 10, "finite"),
    ("[[step]]\nfor_each = { a = [1, \"x\"] }\n[[step.step]]\nfor_s = \"$a\"\n", 10, ""),
    ("[[step]]\nfor_each = { A = [1] }\n[[step.step]]\nfor_s = \"$A\"\n", 10, "a-z, 0-9"),
    ("[[step]]\nfor_each = { a = [1] }\n[[step.step]]\nfor_s = 1\n", 10, "no inner step uses"),
    ("[[step]]\nfor_each = { a = [1] }\n[[step.step]]\nfor_s = \"$b\"\n", 12, "in scope: a"),
    (
        "[[step]]\nfor_each = { a = [1] }\n[[step.step]]\nfor_each = { a = [1] }\n[[step.step.step]]\nfor_s = \"$a\"\n",
        12,
        "already that of",
    ),
    ("[[step]]\nfor_s = \"$a\"\n", 10, "in scope: none"),
    (
        "[[step]]\nvoltage_v = 1\n[step.random]\ntotal_s = 1\nlength_s = [0.1, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 0\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n",
        10,
        "beside `random`",
    ),
    (
        "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.3, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 0\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n",
        12,
        "[0.3, 0.2]",
    ),
    (
        "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.1, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 1.5\nbrake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 20\n",
        14,
        "got 1.5",
    ),
    (
        "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.1, 0.2]\nvoltage_u_max = [0, 1]\nzero_share = 0\nbrake_closed_share = 0.6\nbypass_open_share = 0.6\nguard_deg = 20\n",
        16,
        "got 1.2",
    ),
    ("[[step]]\n[step.random]\ntotal_s = 1\n", 10, "missing field"),
];

#[test]
fn a_bad_step_is_refused_with_file_line_and_reason() {
    for (steps, line, reason) in BAD_STEPS {
        let error = Script::parse(&format!("{HEAD}{steps}"), "dir/bad.toml").expect_err(steps);
        assert_eq!(error.line, *line, "{error}\n{steps}");
        assert!(error.what.contains(reason), "{error}\nexpected: {reason}\n{steps}");
        assert!(!error.what.is_empty());
        assert!(error.to_string().starts_with(&format!("dir/bad.toml:{line}: ")), "{error}");
    }
}

#[test]
fn a_bad_head_is_refused_with_file_line_and_reason() {
    let good = format!("{HEAD}[[step]]\nfor_s = 1\n");
    Script::parse(&good, "t.toml").expect("the head is good");
    for (from, to, line, reason) in [
        ("name = \"t\"", "name = \"../t\"", 1, "a-z, 0-9"),
        ("name = \"t\"", "name = \"\"", 1, "a-z, 0-9"),
        ("name = \"t\"\n", "", 1, "missing field `name`"),
        ("square-wave", "triangle-wave", 2, "unknown variant `triangle-wave`"),
        ("identify", "train", 3, "unknown variant `train`"),
        ("horizontal", "tilted", 4, "unknown variant `tilted`"),
        ("[start]", "colour = 3\n[start]", 5, "unknown field `colour`"),
        ("fixture = \"free\"\n", "", 5, "missing field `fixture`"),
        ("fixture = \"free\"", "fixture = \"driven\"", 6, "can't start with"),
        ("fixture = \"free\"", "fixture = \"clamped\"", 6, "`angle_deg` is missing"),
        ("bypass = \"closed\"", "bypass = \"closed\"\nfill_bar = 0", 9, "`fill_bar` must lie within"),
        ("bypass = \"closed\"", "bypass = \"closed\"\nfill_bar = \"$p\"", 9, "in scope: none"),
    ] {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good);
        let error = Script::parse(&text, "bad.toml").expect_err(to);
        assert_eq!(error.line, line, "{error}\n{text}");
        assert!(error.what.contains(reason), "{error}, expected: {reason}");
    }
}

#[test]
fn folders_are_loaded_or_refused_with_the_file() {
    let folder = std::env::temp_dir().join(format!("profiles-test-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    assert!(matches!(load_folder(&folder), Err(LoadError::Empty { .. })));
    assert!(matches!(load_folder(&folder.join("none")), Err(LoadError::Read { .. })));
    let write = |file: &str, text: &str| std::fs::write(folder.join(file), text).expect("temporary file");
    let good = format!("{HEAD}[[step]]\nfor_s = 1\n");
    write("b.toml", &good);
    write("a.toml", &good.replacen("\"t\"", "\"u\"", 1));
    write("notes.txt", "no script");
    let names: Vec<_> = load_folder(&folder).expect("two scripts").into_iter().map(|s| s.name).collect();
    assert_eq!(names, ["u", "t"]);
    write("c.toml", &good);
    let error = load_folder(&folder).expect_err("a name twice").to_string();
    assert!(error.contains("c.toml") && error.contains("b.toml"), "{error}");
    write("c.toml", &good.replacen("for_s = 1", "for_s = 0", 1));
    let error = load_folder(&folder).expect_err("a bad script").to_string();
    assert!(error.contains("c.toml:10: "), "{error}");
    std::fs::remove_dir_all(&folder).expect("temporary folder");
}

#[test]
fn a_hold_waits_until_a_channel_is_steady() {
    let text = "[[step]]\nvoltage_v = 1\nuntil = [{ channel = \"angle_deg\", steady_within = 0.5, for_s = 0.1 }]\ntimeout_s = 2.0\n\
                [[step]]\nvoltage_v = 0\nfor_s = 0.001\n";
    let waited = |angle_deg: &dyn Fn(u64) -> f64| {
        let mut playback = compile(text);
        let length = steps(&mut playback, angle_deg).len();
        (length, playback.timeouts())
    };
    // It settles at tick 300: the window begins there, or as much earlier as the way is within the tolerance.
    let settles = |k: u64| if k < 300 { k as f64 * 0.1 } else { 30.0 };
    let (length, timeouts) = waited(&settles);
    assert_eq!((length, timeouts), (300 - 5 + 100 + 1, vec![]));
    let (length, _) = waited(&|_| 7.0);
    assert_eq!(length, 1 + 100 + 1, "no shorter than the window");
    let (length, timeouts) = waited(&|k| 0.6 * (k % 2) as f64);
    assert_eq!(length, 2001);
    let [timeout] = timeouts.as_slice() else { panic!("{timeouts:?}") };
    assert_eq!((timeout.step, timeout.place.line, timeout.tick, timeout.ticks), (0, 9, 2000, 2000));
    assert_eq!(timeout.waited[0].left, Some(0.6));
    let said = timeout.to_string();
    assert!(
        said.contains("line 9: after 2 s") && said.contains("angle_deg steady within 0.5 for 0.1 s (was 0.6000)"),
        "{said}"
    );
}

#[test]
fn time_outs_say_what_was_left_and_in_which_pass() {
    let mut playback = compile(
        "[[step]]\nfor_each = { limit_deg = [5, 50] }\n[[step.step]]\nrepeat = 2\n[[step.step.step]]\n\
         until = [{ channel = \"angle_deg\", above = \"$limit_deg\" }, { channel = \"torque_nm\", above = 1 }]\ntimeout_s = 0.01\n",
    );
    steps(&mut playback, |_| 20.0);
    let said: Vec<String> = playback.timeouts().iter().map(ToString::to_string).collect();
    assert_eq!(said.len(), 2, "the passes with 5 degrees are met: {said:?}");
    assert!(said[1].starts_with("line 13 (limit_deg = 50, pass 2 of 2): after 0.01 s, at tick "), "{said:?}");
    assert!(said[1].contains("angle_deg above 50 (was 20.0000), or torque_nm above 1 (not measured"), "{said:?}");
}

#[test]
fn ranges_are_the_lists_that_one_would_have_written() {
    let sweep = |values: &str| {
        let text =
            format!("[[step]]\nfor_each = {{ v = {values} }}\n[[step.step]]\nvoltage_v = \"$v\"\nfor_s = 0.001\n");
        steps(&mut compile(&text), |_| 0.0).iter().map(volts).collect::<Vec<f64>>()
    };
    for (range, list) in [
        ("{ from = -20, to = 20, step = 10 }", "[-20, -10, 0, 10, 20]"),
        ("{ from = 0.3, to = -0.1, step = 0.1 }", "[0.3, 0.2, 0.1, 0.0, -0.1]"),
        ("{ from = 1, to = 14, step = 1 }", "[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]"),
        ("{ from = 1, to = 2, count = 2 }", "[1, 2]"),
        ("{ from = 2, to = 1, count = 5 }", "[2, 1.75, 1.5, 1.25, 1]"),
    ] {
        let bits = |values: Vec<f64>| values.into_iter().map(f64::to_bits).collect::<Vec<_>>();
        assert_eq!(bits(sweep(range)), bits(sweep(list)), "{range}");
    }
    let third = sweep("{ from = 0, to = 1, count = 4 }");
    assert_eq!((third[0], third[1], third[3]), (0.0, 1.0 / 3.0, 1.0));
}

#[test]
fn nested_ranges_give_every_combination_and_may_depend_on_each_other() {
    let text = "[[step]]\nfor_each = { a = { from = 1, to = 3, count = 3 } }\n[[step.step]]\n\
                for_each = { b = { from = 0, to = \"$a\", step = 1 } }\n[[step.step.step]]\nvoltage_v = \"$b\"\nfor_s = 0.001\n";
    let values: Vec<f64> = steps(&mut compile(text), |_| 0.0).iter().map(volts).collect();
    assert_eq!(values, [0.0, 1.0, 0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 3.0]);
}

#[test]
fn an_envelope_narrows_and_never_widens() {
    let script = |envelope: &str| {
        Script::parse(&format!("{HEAD}[[step]]\nfor_s = 1\n[envelope]\n{envelope}"), "t.toml").expect("parses").envelope
    };
    let rig = Limits::default();
    assert_eq!(script("").narrow(&rig), Ok(rig));
    let narrow =
        script("pressure_max_bar = 5\npressure_min_bar = 1\nangle_max_deg = 30\nvoltage_max_v = 12").narrow(&rig);
    let expected =
        Limits { pressure_max_bar: 5.0, pressure_min_bar: 1.0, angle_max_deg: 30.0, voltage_max_v: 12.0, ..rig };
    assert_eq!(narrow, Ok(expected));
    assert_eq!(script("torque_max_nm = 80").narrow(&rig), Ok(rig), "as wide as the rig's is not wider");
    for (wide, key) in [
        ("pressure_max_bar = 8", "pressure_max_bar = 8 is wider"),
        ("pressure_min_bar = 0.4", "pressure_min_bar = 0.4 is wider"),
        ("velocity_max_deg_s = 1001", "own limit of 1000"),
    ] {
        let rig = Limits { pressure_max_bar: 7.5, ..rig };
        let error = script(wide).narrow(&rig).expect_err(wide).to_string();
        assert!(error.contains(key), "{error}");
    }
}

#[test]
fn the_shortest_and_the_longest_time() {
    let script = |steps: &str| Script::parse(&format!("{HEAD}{steps}"), "t.toml").expect("parses");
    let wait = "until = [{ channel = \"angle_deg\", above = 5 }]\ntimeout_s = 3\n";
    let one = script(&format!("[[step]]\nfor_s = 1\n[[step]]\n{wait}"));
    assert_eq!((one.duration_least_s(), one.duration_bound_s()), (1.001, 4.0));
    let left = script(&format!(
        "[[step]]\nfor_s = 1\n[[step]]\nrepeat = 5\nstop_when = [{{ channel = \"angle_deg\", above = 1 }}]\n[[step.step]]\nfor_s = 2\n[[step]]\n{wait}"
    ));
    assert_eq!((left.duration_least_s(), left.duration_bound_s()), (1.001, 14.0));
}
