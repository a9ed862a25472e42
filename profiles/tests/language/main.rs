//! The script language: what holds, loops, ramps and conditions do, and what is said about a bad script.

mod refused;

use profiles::{Context, Playback, Script};
use rt_core::{Fixture, Input, Limits, Measurement, Reference, Step, Target, Tick};

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
fn a_lever_that_stands_beyond_the_range_of_a_script_is_led_all_the_way() {
    for (from_deg, to_deg) in [(58.0, -40.0), (-58.0, 44.0), (46.0, -45.0)] {
        let text = format!(
            "[[step]]\nfixture = \"driven\"\nangle_deg = {to_deg}\nrate_deg_s = 50\n\
             [[step]]\nfixture = \"driven\"\nangle_deg = {to_deg}\nrate_deg_s = 50\n"
        );
        let steps = steps(&mut compile(&text), |_| from_deg);
        let first: Vec<&Step> = steps.iter().filter(|step| step.index == 0).collect();
        assert_eq!(first[first.len() - 1].fixture, Fixture::Driven { angle_deg: to_deg }, "from {from_deg}");
        let way_ms = ((to_deg - from_deg).abs() / 50.0 * 1e3).round() as usize;
        assert!((way_ms..=way_ms + 2).contains(&first.len()), "{} ticks for {way_ms} ms", first.len());
    }
    // No encoder reads that: it must not upset the count of ticks.
    let mut playback = compile("[[step]]\nfixture = \"driven\"\nangle_deg = 0\nrate_deg_s = 50\n");
    playback.step(Tick::at(0), &Measurement { angle_deg: f64::MAX, ..Measurement::NONE });
    assert!(!playback.step(Tick::at(1), &Measurement::NONE).last);
}

/// What the device itself calls wrong is as good as not measured, also where it looks like a number.
#[test]
fn a_faulty_value_meets_no_condition_turns_no_voltage_leaves_no_loop_and_begins_no_ramp() {
    let faulty = Measurement { angle_deg: 30.0, faulty: Input::Angle.bit(), ..Measurement::NONE };
    let sound = Measurement { faulty: 0, ..faulty };
    let differs = |text: &str, of: &dyn Fn(&Step) -> f64| {
        let at_end = |measured: &Measurement| {
            let mut playback = compile(text);
            let steps: Vec<Step> = (0..20).map(|k| playback.step(Tick::at(k), measured)).collect();
            of(&steps[10])
        };
        (at_end(&sound), at_end(&faulty))
    };
    let until = "[[step]]\nvoltage_v = 2\nuntil = [{ channel = \"angle_deg\", above = 20 }]\ntimeout_s = 1\n[[step]]\nvoltage_v = 3\nfor_s = 1\n";
    assert_eq!(differs(until, &volts), (3.0, 2.0));
    let steady = "[[step]]\nvoltage_v = 2\nuntil = [{ channel = \"angle_deg\", steady_within = 1, for_s = 0.005 }]\ntimeout_s = 1\n\
                  [[step]]\nvoltage_v = 3\nfor_s = 1\n";
    assert_eq!(differs(steady, &volts), (3.0, 2.0));
    let stop = "[[step]]\nrepeat = 9\nstop_when = [{ channel = \"angle_deg\", above = 20 }]\n[[step.step]]\nvoltage_v = 2\nfor_s = 1\n\
                [[step]]\nvoltage_v = 3\nfor_s = 1\n";
    assert_eq!(differs(stop, &volts), (3.0, 2.0));
    let ramp =
        "[[step]]\ntarget = { quantity = \"angle_deg\", wave = \"ramp\", to = 5, rate_per_s = 0.001 }\nfor_s = 1\n";
    let angle = |step: &Step| match step.target {
        Target::AngleDeg { angle_deg, .. } => angle_deg.round(),
        other => panic!("{other:?}"),
    };
    assert_eq!(differs(ramp, &angle), (30.0, 5.0));
    let guarded = "[[step]]\n[step.random]\ntotal_s = 1\nlength_s = [0.5, 0.5]\nvoltage_u_max = [0.5, 0.5]\nzero_share = 0\n\
                   brake_closed_share = 0\nbypass_open_share = 0\nguard_deg = 25\n";
    let inward = |measured: &Measurement| {
        let mut playback = compile(guarded);
        (0..900).all(|k| volts(&playback.step(Tick::at(k), measured)) < 0.0)
    };
    assert!(inward(&sound), "outward at 30 degrees it is turned");
    let other_side = |measured: Measurement| Measurement { angle_deg: -measured.angle_deg, ..measured };
    let mut kept = (compile(guarded), compile(guarded));
    for k in 0..900 {
        let (one, other) = (kept.0.step(Tick::at(k), &faulty), kept.1.step(Tick::at(k), &other_side(faulty)));
        assert_eq!(one.target, other.target, "no side is known");
    }
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
