//! Where people do the operator's part, a script waits for them: where, for how long, with what in force, and what is asked.
#![allow(clippy::unwrap_used, reason = "a test")]

use profiles::{Context, Hands, Playback, Script, builtin};
use rt_core::{Amount, Fixture, Measurement, Reference, Step, Target, Tick};

const RIG: Context = Context { u_max_v: 20.0, seed: 3, hands: Hands::Rig };
const PEOPLE: Context = Context { hands: Hands::People, ..RIG };

fn script(steps: &str) -> Script {
    let head = "name = \"t\"\nprotocol = \"clamp-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
                [start]\nfixture = \"clamped\"\nangle_deg = 0\nbrake = \"closed\"\nbypass = \"closed\"\nfill_bar = 2.5\n";
    Script::parse(&format!("{head}{steps}"), "t.toml").unwrap_or_else(|error| panic!("{error}"))
}

/// Plays to the end; people confirm so many ticks after they were first asked.
fn play(playback: &mut Playback, takes: u64, measured: impl Fn(u64) -> Measurement) -> Vec<Step> {
    let (mut steps, mut asked): (Vec<Step>, Option<u64>) = (Vec::new(), None);
    for tick in 0..2_000_000 {
        if asked.is_some_and(|since| tick == since + takes) {
            playback.confirmed(Tick::at(tick));
            asked = None;
        }
        let step = playback.step(Tick::at(tick), &measured(tick));
        match step.waiting {
            Some(_) => _ = asked.get_or_insert(tick),
            None => asked = None,
        }
        steps.push(step);
        if step.last {
            return steps;
        }
    }
    panic!("no end");
}

fn nothing(_: u64) -> Measurement {
    Measurement::NONE
}

/// Runs of ticks that agree in what `of` says of them, with their length.
fn runs<T: PartialEq>(steps: &[Step], of: impl Fn(&Step) -> T) -> Vec<(T, usize)> {
    let mut runs: Vec<(T, usize)> = Vec::new();
    for step in steps {
        let value = of(step);
        match runs.last_mut() {
            Some((last, count)) if *last == value => *count += 1,
            _ => runs.push((value, 1)),
        }
    }
    runs
}

#[test]
fn a_clamp_is_waited_for_at_0_v_in_a_segment_of_its_own_with_the_valves_of_its_step() {
    let script = script(
        "[[step]]\nvoltage_v = 5.0\nfor_s = 0.01\n\
         [[step]]\nfixture = \"clamped\"\nangle_deg = 20\nbypass = \"open\"\nfor_s = 0.02\n\
         [[step]]\nfixture = \"clamped\"\nangle_deg = 20\nfor_s = 0.005\n",
    );
    let steps = play(&mut script.compile(&PEOPLE).unwrap(), 7, nothing);
    let seen = runs(&steps, |s| (s.index, s.segment, s.waiting.is_some(), s.target, s.bypass_open, s.fixture));
    let (at, rest) = (|v| Target::VoltageV(v), Target::VoltageV(0.0));
    let (old, new) = (Fixture::Clamped { angle_deg: 0.0 }, Fixture::Clamped { angle_deg: 20.0 });
    assert_eq!(
        seen,
        [
            ((0, 0, false, at(5.0), false, old), 10),
            ((1, 1, true, rest, true, old), 7),
            // The tick at which it is confirmed is the wait's last.
            ((1, 1, false, rest, true, old), 1),
            ((1, 2, false, at(5.0), true, new), 20),
            // It is clamped there already.
            ((2, 3, false, at(5.0), true, new), 5),
        ]
    );
    let alone = play(&mut script.compile(&RIG).unwrap(), 7, nothing);
    assert_eq!(alone.len(), 35);
    assert!(alone.iter().all(|s| s.waiting.is_none()));
}

#[test]
fn a_step_of_the_operators_own_lasts_until_it_is_confirmed_and_a_tick_on_a_rig_that_does_it() {
    let script = script(
        "[[step]]\nvoltage_v = 5.0\nfor_s = 0.01\n\
         [[step]]\noperator = \"Weigh the beaker\"\namount = \"volume_ml\"\n\
         [[step]]\nvoltage_v = 2.0\nfor_s = 0.003\n",
    );
    let seen = |context, takes| {
        let steps = play(&mut script.compile(context).unwrap(), takes, nothing);
        runs(&steps, |s| (s.index, s.segment, s.waiting.and_then(|w| w.amount), s.target))
    };
    let at = |v| Target::VoltageV(v);
    let wanted = [((0, 0, None, at(5.0)), 10), ((1, 1, None, at(0.0)), 1), ((2, 2, None, at(2.0)), 3)];
    assert_eq!(seen(&RIG, 1), wanted);
    let [first, done, last] = wanted;
    assert_eq!(seen(&PEOPLE, 30), [first, ((1, 1, Some(Amount::VolumeMl), at(0.0)), 30), done, last]);
    let requests = script.requests(&PEOPLE).unwrap();
    assert_eq!(requests.len(), 1);
    assert_eq!((requests[0].step, &*requests[0].text, requests[0].line), (1, "Weigh the beaker", 14));
    assert_eq!(script.requests(&RIG).unwrap(), []);
}

#[test]
fn a_step_of_the_operators_own_also_ends_by_its_conditions_and_its_time() {
    let script = script(
        "[[step]]\nvoltage_v = 3.0\noperator = \"Watch\"\nuntil = [{ channel = \"angle_deg\", above = 5.0 }]\ntimeout_s = 0.05\n\
         [[step]]\nvoltage_v = 0.0\nfor_s = 0.003\n",
    );
    let lasts = |takes, angle: fn(u64) -> f64| {
        let mut playback = script.compile(&PEOPLE).unwrap();
        let steps = play(&mut playback, takes, |tick| Measurement { angle_deg: angle(tick), ..Measurement::NONE });
        let watching = steps.iter().filter(|s| s.index == 0).inspect(|s| assert_eq!(s.target, Target::VoltageV(3.0)));
        (watching.count(), playback.timeouts().len())
    };
    assert_eq!(lasts(20, |_| 0.0), (21, 0), "confirmed");
    assert_eq!(lasts(200, |tick| tick as f64), (6, 0), "the angle got there");
    assert_eq!(lasts(200, |_| 0.0), (50, 1), "nobody, and nothing happened");
}

#[test]
fn people_may_have_their_hands_on_the_rig_where_it_waits_and_rests_and_nowhere_else() {
    let hands_on = |own: &str| {
        let script =
            script(&format!("[[step]]\nvoltage_v = 5.0\nfor_s = 0.01\n[[step]]\noperator = \"Look\"\n{own}\n"));
        let steps = play(&mut script.compile(&PEOPLE).unwrap(), 300, nothing);
        assert!(steps.iter().all(|s| !s.hands_on || s.waiting.is_some()));
        let waits: Vec<&Step> = steps.iter().filter(|s| s.waiting.is_some()).collect();
        assert_eq!(waits.len(), 300, "{own}");
        (waits.iter().all(|s| s.hands_on), waits.iter().any(|s| s.hands_on))
    };
    for rests in ["", "voltage_v = 0.0", "voltage_u_max = 0.0", "bypass = \"open\"\namount = \"volume_ml\""] {
        assert_eq!(hands_on(rests), (true, true), "{rests}");
    }
    for drives in [
        "voltage_v = 2.0",
        "voltage_v = 2.0\ntimeout_s = 5.0",
        "flow_ml_s = 0.0",
        // 0 V at some of its ticks.
        "target = { quantity = \"voltage_v\", wave = \"sine\", amplitude = 2.0, frequency_hz = 5.0 }",
    ] {
        assert_eq!(hands_on(drives), (false, false), "{drives}");
    }
}

#[test]
fn a_prediction_plays_a_step_that_drives_until_people_confirm_as_long_as_it_may_last() {
    let ticks = |context: &Context, own: &str, angle: fn(u64) -> f64| {
        let script =
            script(&format!("[[step]]\noperator = \"Look\"\n{own}\n[[step]]\nvoltage_v = 0.0\nfor_s = 0.003\n"));
        let mut playback = script.foreseen(context).unwrap();
        assert!(playback.requests().is_empty());
        let open = playback.is_open_ended(0);
        let steps = play(&mut playback, 1, |tick| Measurement { angle_deg: angle(tick), ..Measurement::NONE });
        assert!(steps.iter().all(|s| s.waiting.is_none() && !s.hands_on));
        (steps.iter().filter(|s| s.index == 0).count(), open)
    };
    let still = |_: u64| 0.0;
    assert_eq!(ticks(&PEOPLE, "voltage_v = 2.0", still), (60_000, true));
    assert_eq!(ticks(&PEOPLE, "voltage_v = 2.0\ntimeout_s = 0.5", still), (500, false));
    let until = "voltage_v = 2.0\nuntil = [{ channel = \"angle_deg\", above = 5.0 }]";
    assert_eq!(ticks(&PEOPLE, until, |tick| tick as f64), (6, true));
    assert_eq!(ticks(&PEOPLE, "", still), (1, false), "what is done at rest is done at once");
    assert_eq!(ticks(&RIG, "voltage_v = 2.0", still), (1, false), "nobody has to confirm");
}

#[test]
fn a_lever_that_is_led_by_hand_is_led_until_people_say_so_or_a_condition_is_met() {
    let script = script(
        "[[step]]\nfixture = \"driven\"\nangle_deg = 10\nrate_deg_s = 10\nuntil = [{ channel = \"pressure1_bar\", below = 1.7 }]\n\
         [[step]]\nnew_segment = false\nfixture = \"driven\"\nangle_deg = 10\nrate_deg_s = 10\n\
         [[step]]\nnew_segment = false\nfixture = \"clamped\"\nangle_deg = 10\nfor_s = 0.004\n",
    );
    let steps = play(&mut script.compile(&PEOPLE).unwrap(), 3000, nothing);
    // Longer than the ramp would take; then there is no way left to lead it, but it must be clamped.
    let seen = runs(&steps, |s| (s.index, s.segment, s.waiting.is_some()));
    assert_eq!(
        seen,
        [((0, 0, true), 3000), ((0, 0, false), 1), ((1, 0, false), 2), ((2, 0, true), 3000), ((2, 0, false), 5)]
    );
    let low = |tick| Measurement { pressure1_bar: if tick < 500 { 2.0 } else { 1.0 }, ..Measurement::NONE };
    let steps = play(&mut script.compile(&PEOPLE).unwrap(), 3000, low);
    assert_eq!(steps.iter().filter(|s| s.index == 0).count(), 500);
}

#[test]
fn oil_is_released_until_people_say_so_and_read_in_the_same_segment_after_its_time() {
    let script = script(
        "[[step]]\nfixture = \"released\"\nangle_deg = 0\nrelease_ml_s = 2.0\nfor_s = 0.5\n\
         [[step]]\nnew_segment = false\nfixture = \"released\"\nangle_deg = 0\nrelease_ml_s = 0.0\nfor_s = 0.1\n\
         [[step]]\nnew_segment = false\nfixture = \"clamped\"\nangle_deg = 0\nfor_s = 0.001\n",
    );
    let seen = |takes| {
        let steps = play(&mut script.compile(&PEOPLE).unwrap(), takes, nothing);
        assert!(steps.iter().all(|s| s.target == Target::VoltageV(0.0) && s.segment == 0));
        runs(&steps, |s| (s.index, s.waiting.is_some()))
    };
    // Quick people: the reading still has its time to rest. Slow ones: it waits for them.
    assert_eq!(seen(30), [((0, true), 30), ((0, false), 1), ((1, true), 30), ((1, false), 70), ((2, false), 1)]);
    assert_eq!(seen(300), [((0, true), 300), ((0, false), 1), ((1, true), 300), ((1, false), 1), ((2, false), 1)]);
    let requests = script.requests(&PEOPLE).unwrap();
    // The last is not asked here: the lever is held there already.
    assert_eq!(requests.iter().map(|r| r.amount).collect::<Vec<_>>(), [None, Some(Amount::VolumeMl), None]);
    assert!(requests[0].text.contains("1.00 ml from chamber 1"), "{}", requests[0].text);
}

#[test]
fn every_built_in_script_says_what_people_have_to_do_and_comes_to_its_end_with_them() {
    for script in builtin().unwrap() {
        let name = &script.name;
        let alone = play(&mut script.compile(&RIG).unwrap(), 1, nothing);
        assert!(alone.iter().all(|s| s.waiting.is_none()), "{name}");
        let mut playback = script.compile(&PEOPLE).unwrap();
        let requests = playback.requests().to_vec();
        let steps = play(&mut playback, 5, nothing);
        for step in &steps {
            assert!(step.waiting.is_none() || step.target == Target::VoltageV(0.0), "{name}");
            assert_eq!(step.hands_on, step.waiting.is_some(), "{name}: the rig rests at every wait");
            if let Some(waiting) = step.waiting {
                let request = &requests[waiting.request as usize];
                assert_eq!((request.step, request.amount), (step.index, waiting.amount), "{name}");
            }
        }
        let asked = steps.windows(2).filter(|w| w[0].waiting.is_none() && w[1].waiting.is_some()).count();
        assert_eq!(asked > 0 || steps[0].waiting.is_some(), !requests.is_empty(), "{name}");
        let volumes = requests.iter().filter(|r| r.amount.is_some()).count();
        assert_eq!(volumes > 0, matches!(name.as_str(), "clamp_steps" | "volume_map"), "{name}: {requests:?}");
        assert!(script.preparation().contains(script.plane.as_str()) || name == "pump_map", "{}", script.preparation());
    }
}

#[test]
fn what_is_confirmed_while_nothing_is_asked_changes_nothing() {
    let script = script("[[step]]\nfor_s = 0.01\n[[step]]\nfixture = \"free\"\nfor_s = 0.01\n");
    let mut disturbed = script.compile(&PEOPLE).unwrap();
    for tick in 0..30 {
        if tick != 10 {
            disturbed.confirmed(Tick::at(tick.min(9)));
        }
        let step = disturbed.step(Tick::at(tick), &Measurement::NONE);
        assert_eq!(step.waiting.is_some(), tick == 10, "tick {tick}");
    }
}

#[test]
fn ticks_that_are_left_out_skip_no_request() {
    let script = script("[[step]]\nfor_s = 0.01\n[[step]]\nfixture = \"free\"\nfor_s = 0.01\n");
    let mut playback = script.compile(&PEOPLE).unwrap();
    assert_eq!(playback.step(Tick::at(0), &Measurement::NONE).waiting, None);
    for tick in [500, 700, 701] {
        assert!(playback.step(Tick::at(tick), &Measurement::NONE).waiting.is_some(), "tick {tick}");
    }
    playback.confirmed(Tick::at(800));
    assert_eq!(playback.step(Tick::at(800), &Measurement::NONE).index, 1);
    assert!(playback.step(Tick::at(900), &Measurement::NONE).last, "its ten ticks began at 801");
}

#[test]
fn what_an_operator_step_can_not_be_is_refused_where_it_stands() {
    for (step, what) in [
        ("operator = \"Look\"\nfor_s = 1.0", "remove `for_s`"),
        ("operator = \"\"\n", "`operator` must be one line"),
        ("operator = \"two\\nlines\"\n", "`operator` must be one line"),
        ("amount = \"volume_ml\"\nfor_s = 1.0", "`amount` is what the operator confirms"),
        ("operator = \"Weigh\"\namount = \"mass_g\"", "mass_g"),
        ("operator = \"Clamp it\"\nfixture = \"clamped\"\nangle_deg = 3\nvoltage_v = 2.0", "remove its target"),
        ("repeat = 2\noperator = \"Look\"", "`operator` has no meaning beside `repeat`"),
        ("operator = \"Lead it\"\nfixture = \"driven\"\nangle_deg = 3\nrate_deg_s = 1\ntimeout_s = 3", "`timeout_s`"),
    ] {
        let text = format!(
            "name = \"t\"\nprotocol = \"clamp-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
             [start]\nfixture = \"free\"\nbrake = \"closed\"\nbypass = \"closed\"\n[[step]]\n{step}\n"
        );
        let error = Script::parse(&text, "t.toml").map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(what) && error.starts_with("t.toml:"), "{step}: {error}");
    }
}
