//! Commands from another program, and their answers.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use rt_core::{
    Amount, Answer, CommandServer, Confirmation, LinkError, Measurement, Refusal, RunCommand, Switches, Tick, Waiting,
    send_command,
};

const PATIENCE: Duration = Duration::from_secs(20);

fn instance(name: &str) -> String {
    format!("commands-{name}-{}", std::process::id())
}

/// A server on this instance while `body` runs, over switches that nobody or `a loop` looks at.
fn serving<T>(instance: &str, with_loop: bool, body: impl FnOnce(&Switches) -> T) -> T {
    let switches = Switches::new();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        let (ready, opened) = mpsc::channel();
        scope.spawn(|| {
            let ready = ready; // the channel closes should the server not open
            let mut server = CommandServer::open(instance).unwrap();
            ready.send(()).unwrap();
            while !over.load(Ordering::Relaxed) {
                server.serve(Duration::from_millis(10), &switches, &|| "read the cylinder".to_owned()).unwrap();
            }
        });
        opened.recv().unwrap();
        if with_loop {
            scope.spawn(|| {
                let mut waiting = Some(Waiting { request: 3, amount: Some(Amount::VolumeMl) });
                for tick in 0.. {
                    if over.load(Ordering::Relaxed) {
                        return;
                    }
                    if switches.confirmations.take(Tick::at(tick), waiting, &Measurement::NONE).is_some() {
                        waiting = None;
                    }
                    thread::sleep(Duration::from_millis(1));
                }
            });
        }
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| body(&switches)));
        over.store(true, Ordering::Relaxed);
        result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

#[test]
fn a_stop_and_an_emergency_stop_throw_their_switches_and_are_answered() {
    let instance = instance("stop");
    serving(&instance, false, |switches| {
        let thrown = || (switches.stop.load(Ordering::Relaxed), switches.emergency_stop.load(Ordering::Relaxed));
        let taken = Answer { taken: Ok(None), open: None, text: "read the cylinder".to_owned() };
        assert_eq!(send_command(&instance, RunCommand::Look, PATIENCE), Ok(taken.clone()));
        assert_eq!(thrown(), (false, false));
        assert_eq!(send_command(&instance, RunCommand::Stop, PATIENCE), Ok(taken.clone()));
        assert_eq!(thrown(), (true, false));
        assert_eq!(send_command(&instance, RunCommand::EmergencyStop, PATIENCE), Ok(taken));
        assert_eq!(thrown(), (true, true));
    });
    let nobody = Err(LinkError::Nobody { instance: instance.clone() });
    assert_eq!(send_command(&instance, RunCommand::Stop, PATIENCE), nobody);
}

#[test]
fn a_confirmation_is_taken_by_the_loop_once_and_refused_with_its_reason() {
    let instance = instance("confirm");
    serving(&instance, true, |_| {
        let confirm = |request, volume_ml| {
            let command = RunCommand::Confirm(Confirmation { request, volume_ml });
            send_command(&instance, command, PATIENCE).unwrap().taken
        };
        let open = loop {
            let answer = send_command(&instance, RunCommand::Look, PATIENCE).unwrap();
            if let Some(open) = answer.open {
                break open;
            }
        };
        assert_eq!(open, Waiting { request: 3, amount: Some(Amount::VolumeMl) });
        assert_eq!(confirm(Some(3), None), Err(Refusal::AmountMissing));
        assert_eq!(confirm(Some(2), Some(1.0)), Err(Refusal::OtherRequest));
        assert!(matches!(confirm(Some(3), Some(1.0)), Ok(Some(_))), "at a tick");
        assert_eq!(confirm(Some(3), Some(1.0)), Err(Refusal::NothingWaits));
    });
}

#[test]
fn while_a_confirmation_has_no_answer_an_emergency_stop_is_heard() {
    let instance = instance("held");
    serving(&instance, false, |switches| {
        thread::scope(|scope| {
            let held = scope.spawn(|| send_command(&instance, RunCommand::Confirm(Confirmation::default()), PATIENCE));
            let begun = Instant::now();
            // The confirmation is before the loop that there is not, and stays there for a while.
            while switches.confirmations.offer(Confirmation::default()) {
                assert!(switches.confirmations.withdraw(), "nobody judges");
                assert!(begun.elapsed() < PATIENCE, "it never came");
                thread::sleep(Duration::from_millis(1));
            }
            send_command(&instance, RunCommand::EmergencyStop, PATIENCE).unwrap();
            assert!(switches.emergency_stop.load(Ordering::Relaxed));
            let answer = held.join().unwrap().unwrap();
            assert_eq!(answer.taken, Err(Refusal::NoAnswer));
        });
    });
}

#[test]
fn while_a_command_that_was_passed_on_has_no_answer_an_emergency_stop_is_passed_on() {
    let instance = instance("passed");
    let mut server = CommandServer::open(&instance).unwrap();
    let taken = |tick| Answer { taken: Ok(tick), open: None, text: String::new() };
    let (mut held, mut stopped) = (None, None);
    let mut asking = Vec::new();
    let ask = |command| {
        let instance = instance.clone();
        thread::spawn(move || send_command(&instance, command, PATIENCE))
    };
    asking.push(ask(RunCommand::Confirm(Confirmation::default())));
    while asking.iter().any(|client| !client.is_finished()) {
        let mut pass = |command| {
            let (answer, answers) = mpsc::channel();
            *if matches!(command, RunCommand::Confirm(_)) { &mut held } else { &mut stopped } = Some(answer);
            answers
        };
        server.pass_on(Duration::from_millis(10), &mut pass).unwrap();
        if held.is_some() && asking.len() == 1 {
            asking.push(ask(RunCommand::EmergencyStop));
        }
        // What came first is answered last.
        if let Some(answer) = stopped.take() {
            answer.send(taken(None)).unwrap();
        } else if let Some(answer) = held.take_if(|_| asking.len() == 2 && asking[1].is_finished()) {
            answer.send(taken(Some(7))).unwrap();
        }
    }
    let answers: Vec<_> = asking.into_iter().map(|client| client.join().unwrap()).collect();
    assert_eq!(answers, [Ok(taken(Some(7))), Ok(taken(None))]);
}

#[test]
fn a_command_that_was_passed_on_in_vain_is_answered_so() {
    let instance = instance("in-vain");
    let mut server = CommandServer::open(&instance).unwrap();
    let client = {
        let instance = instance.clone();
        thread::spawn(move || send_command(&instance, RunCommand::Stop, PATIENCE))
    };
    while !client.is_finished() {
        server.pass_on(Duration::from_millis(10), &mut |_| mpsc::channel().1).unwrap();
    }
    assert_eq!(client.join().unwrap().unwrap().taken, Err(Refusal::Unreachable));
}

#[test]
fn a_name_that_is_none_is_refused() {
    assert!(matches!(send_command("a/b", RunCommand::Stop, PATIENCE), Err(LinkError::InstanceName(_))));
    assert!(matches!(CommandServer::open(""), Err(LinkError::InstanceName(_))));
}
