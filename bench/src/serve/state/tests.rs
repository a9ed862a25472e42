use super::*;

fn desk(state: State) -> Desk {
    Desk { state, ..Desk::new(Arc::default()) }
}

const NOW_S: f64 = 100.0;

fn held() -> Held {
    Held { run: Some(1), reason: "pressure 1 above 8 bar".to_owned() }
}

fn running(armed_until_s: Option<f64>, stopping: bool) -> State {
    State::Running { number: 1, armed_until_s, stopping }
}

fn tripped(run_alive: bool) -> State {
    State::Tripped { held: held(), run_alive }
}

/// The states that differ in what follows, with a name for the table.
fn states() -> Vec<(&'static str, State)> {
    vec![
        ("idle", State::Idle),
        ("armed", State::Armed(150.0)),
        ("late", State::Armed(100.0)),
        ("running", running(Some(150.0), false)),
        ("run-late", running(Some(90.0), false)),
        ("run-dis", running(None, false)),
        ("stopping", running(None, true)),
        ("trip-run", tripped(true)),
        ("tripped", tripped(false)),
    ]
}

fn input(name: &str) -> Input {
    let ended = |outcome| Input::RunEnded(outcome, "its words".to_owned());
    match name {
        "arm" => Input::Arm(50.0),
        "disarm" => Input::Disarm,
        "stop" => Input::Stop,
        "emergency" => Input::EmergencyStop,
        "acknowledge" => Input::Acknowledge,
        "seen" => Input::TripSeen(held()),
        "completed" => ended(Outcome::Completed),
        "end-tripped" => ended(Outcome::Tripped),
        "stopped" => ended(Outcome::Stopped),
        "aborted" => ended(Outcome::Aborted),
        "failed" => ended(Outcome::Failed),
        "look" => Input::Look { rig_free: true },
        "busy" => Input::Look { rig_free: false },
        other => panic!("no input {other}"),
    }
}

/// Every state and every input: the state that follows, and the effect. `!`: refused, and nothing changes.
const TABLE: &str = "
              idle     armed     late      running   run-late  run-dis   stopping  trip-run  tripped
arm           armed    armed     armed     running   running   running   !         !         !
disarm        idle     idle      idle      run-dis   run-dis   run-dis   stopping  trip-run  tripped
stop          idle/S   idle/S    idle/S    stopping/S stopping/S stopping/S stopping/S trip-run/S tripped/S
emergency     e-idle/T e-idle/T  e-idle/T  e-run/T   e-run/T   e-run/T   e-run/T   trip-run/T tripped/T
acknowledge   !        !         !         !         !         !         !         !         idle
seen          tripped  tripped   tripped   trip-run  trip-run  trip-run  trip-run  trip-run  tripped
completed     idle     armed     late      armed     idle      idle      idle      tripped   tripped
end-tripped   idle     armed     late      words     words     words     words     tripped   tripped
stopped       idle     armed     late      idle      idle      idle      idle      tripped   tripped
aborted       idle     armed     late      idle      idle      idle      idle      tripped   tripped
failed        idle     armed     late      idle      idle      idle      idle      tripped   tripped
look          idle     running/Q idle      running   run-dis   run-dis   stopping  trip-run  tripped
busy          idle     armed     idle      running   run-dis   run-dis   stopping  trip-run  tripped
";

fn expected(name: &str) -> State {
    let emergency = |run: Option<u32>| State::Tripped {
        held: Held { run, reason: "emergency stop".to_owned() },
        run_alive: run.is_some(),
    };
    match name {
        "e-idle" => emergency(None),
        "e-run" => emergency(Some(1)),
        "words" => State::Tripped { held: Held { run: Some(1), reason: "its words".to_owned() }, run_alive: false },
        other => states().into_iter().find(|(name, _)| *name == other).map(|(_, state)| state).expect("a state"),
    }
}

#[test]
fn every_input_in_every_state() {
    let mut lines = TABLE.lines().filter(|line| !line.trim().is_empty());
    let columns: Vec<&str> = lines.next().expect("a head").split_whitespace().collect();
    assert_eq!(columns, states().iter().map(|(name, _)| *name).collect::<Vec<_>>(), "every state has its column");
    let mut rows = 0;
    for line in lines {
        let words: Vec<&str> = line.split_whitespace().collect();
        assert_eq!(words.len(), columns.len() + 1, "{line}");
        rows += 1;
        for ((from, state), cell) in states().into_iter().zip(&words[1..]) {
            let mut desk = desk(state.clone());
            let id = desk.enqueue("square_h", 5).expect("there is room");
            let queued = Queued { id, profile: "square_h".to_owned(), seed: 5 };
            let said = desk.step(input(words[0]), NOW_S);
            let place = format!("{} in {from}", words[0]);
            if *cell == "!" {
                let refusal = said.expect_err(&place);
                assert!(!refusal.error.is_empty() && !refusal.remedy.is_empty(), "{place}");
                assert_eq!(desk.state, state, "{place}: a refusal changes nothing");
                continue;
            }
            let (to, effect) = cell.split_once('/').unwrap_or((cell, ""));
            let effect = match effect {
                "S" => Some(Effect::StopRun),
                "T" => Some(Effect::TripRun),
                "Q" => Some(Effect::Start(queued.clone())),
                _ => None,
            };
            let queue: Vec<Queued> = desk.queue().cloned().collect();
            let kept = if matches!(effect, Some(Effect::Start(_))) { vec![] } else { vec![queued] };
            assert_eq!(said, Ok(effect), "{place}");
            assert_eq!(desk.state, expected(to), "{place}");
            assert_eq!(queue, kept, "{place}: the queue is kept but for what is started");
        }
    }
    assert_eq!(rows, 13, "every input has its row");
}

#[test]
fn only_armed_and_nothing_else_starts_a_run() {
    for (name, state) in states() {
        for said in ["arm", "disarm", "stop", "emergency", "acknowledge", "seen", "completed", "look", "busy"] {
            let mut desk = desk(state.clone());
            desk.enqueue("square_h", 1).expect("there is room");
            let starts = matches!(desk.step(input(said), NOW_S), Ok(Some(Effect::Start(_))));
            assert_eq!(starts, (name, said) == ("armed", "look"), "{said} in {name}");
        }
    }
}

#[test]
fn one_run_after_the_other_while_it_is_armed_then_idle() {
    let mut desk = Desk::new(Arc::default());
    desk.enqueue("a", 1).expect("room");
    desk.enqueue("b", 2).expect("room");
    let look = Input::Look { rig_free: true };
    assert_eq!(desk.step(look.clone(), 0.0), Ok(None), "idle starts nothing");
    desk.step(Input::Arm(10.0), 0.0).expect("idle can be armed");
    assert!(matches!(desk.step(look.clone(), 1.0), Ok(Some(Effect::Start(queued))) if queued.profile == "a"));
    assert_eq!((desk.own_run(), desk.armed_left_s(1.0)), (Some(1), Some(9.0)));
    assert_eq!(desk.step(look.clone(), 2.0), Ok(None), "one at a time");
    desk.step(Input::RunEnded(Outcome::Completed, String::new()), 9.0).expect("it was running");
    assert!(matches!(desk.step(look.clone(), 9.5), Ok(Some(Effect::Start(queued))) if queued.profile == "b"));
    desk.step(look.clone(), 11.0).expect("a look is never refused");
    assert_eq!((desk.state(), desk.armed_left_s(11.0)), (ServiceState::Running, None), "the run goes on");
    desk.step(Input::RunEnded(Outcome::Completed, String::new()), 12.0).expect("it was running");
    assert_eq!((desk.state(), desk.own_run()), (ServiceState::Idle, None));
    assert_eq!(desk.numbers.next(), 3);
}

#[test]
fn times_that_are_none_are_refused_and_the_queue_has_an_end() {
    for for_s in [0.0, -1.0, f64::NAN, f64::INFINITY, ARMED_MOST_S + 1.0] {
        assert!(Desk::new(Arc::default()).step(Input::Arm(for_s), 0.0).is_err(), "{for_s}");
    }
    let mut desk = Desk::new(Arc::default());
    for _ in 0..QUEUE_MOST {
        desk.enqueue("a", 1).expect("room");
    }
    assert!(desk.enqueue("a", 1).expect_err("it is full").error.contains("100"));
    assert_eq!(desk.unqueue(7).map(|queued| queued.id), Ok(7));
    assert!(desk.unqueue(7).is_err(), "it is gone");
    assert_eq!(desk.enqueue("a", 1), Ok(QUEUE_MOST as u64 + 1), "no id is used twice");
}
