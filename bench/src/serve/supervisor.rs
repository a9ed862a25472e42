//! The supervision of the runs: takes commands, moves the desk, starts and ends the runs' processes. One thread, the process's first: the
//! kernel ties a run's life to the thread that started it.

use super::board::{Board, OwnRun};
use super::described::Described;
use super::event_log::{Severity, utc_now};
use super::library::Library;
use super::line;
use super::notify::Notifier;
use super::process::{Common, Ended, Line, Order, RunProcess};
use super::state::{Desk, Effect, Held, Input, Outcome, Queued, Refusal};
use super::view;
use crate::commands::run::free_file;
use profiles::{Context, Hands};
use rt_core::{RunCommand, ServiceCommand, ServiceState};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Between two looks after the run's process.
const LOOK: Duration = Duration::from_millis(25);

/// The way by which a command came, for the events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Over HTTP, with the token.
    Web,
    /// Over shared memory, from a program of the same user.
    Local,
}

impl Way {
    fn words(self) -> &'static str {
        match self {
            Way::Web => "over HTTP",
            Way::Local => "by a program on this machine",
        }
    }
}

/// What became of a command: the id of what was queued.
pub type Answer = Result<Option<u64>, Refusal>;

/// What reaches the supervisor.
#[derive(Debug)]
pub enum Message {
    /// A command, and who waits for what became of it.
    Command(ServiceCommand, Way, oneshot::Sender<Answer>),
    /// A run tripped.
    TripSeen(Held),
    /// The own channel of this run of the queue did not take the order to stop, and why.
    Unheard(u32, String),
}

/// What the supervisor needs.
pub struct Supervisor {
    /// What is common to all runs.
    pub common: Common,
    /// Where recordings go.
    pub data: PathBuf,
    /// Largest voltage of the rig, V.
    pub u_max_v: f64,
    /// Who does the operator's part, as far as it is known before a run.
    pub hands: Hands,
    /// The profiles.
    pub library: Arc<Library>,
    /// Where the others look.
    pub board: Arc<Board>,
    /// From the others.
    pub messages: Receiver<Message>,
    /// To the thread that speaks to a run.
    pub line: Sender<line::Order>,
}

/// While it works.
struct Work {
    setup: Supervisor,
    desk: Desk,
    run: Option<RunProcess>,
    begun: Instant,
    tripped_utc: String,
}

impl Supervisor {
    /// Works until `stop` is set, then ends the run that is under way and waits for its end. Says whether it cut one short.
    pub fn work(self, stop: &AtomicBool, notifier: &mut Notifier) -> bool {
        let desk = Desk::new(Arc::clone(&self.board.numbers));
        let mut work = Work { setup: self, desk, run: None, begun: Instant::now(), tripped_utc: String::new() };
        while !stop.load(Ordering::Relaxed) {
            work.pass();
            notifier.alive(&work.setup.board);
        }
        work.leave(notifier)
    }
}

impl Work {
    fn now_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    fn pass(&mut self) {
        match self.setup.messages.recv_timeout(LOOK) {
            Ok(message) => self.hear(message),
            Err(RecvTimeoutError::Timeout) => {}
            // The others are gone: what is under way is still looked after.
            Err(RecvTimeoutError::Disconnected) => thread::sleep(LOOK),
        }
        self.look_after_run();
        let rig_free = self.run.is_none() && !self.setup.board.busy.load(Ordering::Relaxed);
        self.step(Input::Look { rig_free });
        self.show();
    }

    fn hear(&mut self, message: Message) {
        match message {
            Message::Command(command, way, reply) => {
                let answer = self.obey(&command, way);
                // Who asked sees the state after it.
                self.show();
                let _ = reply.send(answer);
            }
            Message::TripSeen(held) => self.step(Input::TripSeen(held)),
            Message::Unheard(number, why) => {
                if let Some(run) = self.run.as_mut().filter(|run| run.order.number == number) {
                    let text = format!("the run has not taken the command ({why}): it gets SIGTERM");
                    self.setup.board.note(Severity::Warning, "service", &text, Some((run.order.number, None)));
                    run.terminate();
                }
            }
        }
    }

    fn obey(&mut self, command: &ServiceCommand, way: Way) -> Answer {
        let (input, done) = match command {
            ServiceCommand::State => return Ok(None),
            ServiceCommand::Queue { profile, seed } => return self.enqueue(profile, *seed, way).map(Some),
            ServiceCommand::Unqueue { id } => {
                let queued = self.desk.unqueue(*id)?;
                self.note(way, &format!("{} taken out of the queue", queued.profile));
                return Ok(None);
            }
            ServiceCommand::Arm { for_s } => (Input::Arm(*for_s), format!("armed for {for_s:.0} s")),
            ServiceCommand::Disarm => (Input::Disarm, "disarmed".to_owned()),
            ServiceCommand::Stop => (Input::Stop, "stop".to_owned()),
            ServiceCommand::EmergencyStop => (Input::EmergencyStop, "EMERGENCY STOP".to_owned()),
            ServiceCommand::Acknowledge => (Input::Acknowledge, "trip acknowledged".to_owned()),
        };
        let effect = self.desk.step(input, self.now_s())?;
        self.note(way, &done);
        if let Some(effect) = effect {
            self.do_it(effect);
        }
        Ok(None)
    }

    fn note(&self, way: Way, what: &str) {
        let run = self.desk.own_run().map(|run| (run, None));
        self.setup.board.note(Severity::Info, "command", &format!("{what} ({})", way.words()), run);
    }

    fn enqueue(&mut self, profile: &str, seed: u64, way: Way) -> Result<u64, Refusal> {
        if self.setup.library.find(profile).is_none() {
            let error = format!("expected the name of a profile, got {profile:?}");
            return Err(Refusal::new(error, format!("there are {}", self.setup.library.names())));
        }
        let id = self.desk.enqueue(profile, seed)?;
        self.note(way, &format!("{profile} queued with seed {seed}"));
        Ok(id)
    }

    /// For what no state refuses.
    fn step(&mut self, input: Input) {
        let before = self.desk.state();
        if let Ok(Some(effect)) = self.desk.step(input, self.now_s()) {
            self.do_it(effect);
        }
        if (before, self.desk.state()) == (ServiceState::Armed, ServiceState::Idle) {
            self.setup.board.note(Severity::Info, "service", "no longer armed: its time is over", None);
        }
    }

    fn do_it(&mut self, effect: Effect) {
        match effect {
            Effect::Start(queued) => self.start(&queued),
            Effect::StopRun => self.tell_run(RunCommand::Stop),
            Effect::TripRun => self.tell_run(RunCommand::EmergencyStop),
        }
    }

    fn start(&mut self, queued: &Queued) {
        let Some(number) = self.desk.own_run() else { return };
        if let Err(text) = self.try_start(queued, number) {
            self.ended(number, &queued.profile, None, Ended { outcome: Outcome::Failed, text });
        }
    }

    fn try_start(&mut self, queued: &Queued, number: u32) -> Result<(), String> {
        let Supervisor { library, data, u_max_v, hands, board, common, .. } = &self.setup;
        let entry = library.find(&queued.profile).ok_or("its profile is gone")?;
        std::fs::create_dir_all(data)
            .map_err(|error| format!("{}: expected a folder for recordings, got \"{error}\"", data.display()))?;
        let order = Order {
            number,
            profile: queued.profile.clone(),
            file: entry.file.clone(),
            seed: queued.seed,
            recording: free_file(data, &entry.script.name),
        };
        let context = Context { u_max_v: *u_max_v, seed: queued.seed, hands: *hands };
        let described = Arc::new(Described::queued(&entry.script, &context));
        // Before its first sample can come: that sample belongs to it.
        board.set_own(Some(OwnRun { number, described }));
        let text = format!("{} started with seed {}", queued.profile, queued.seed);
        board.note(Severity::Info, "service", &text, Some((number, None)));
        let run = RunProcess::start(order, common).map_err(|error| format!("the run's process: {error}"))?;
        self.run = Some(run);
        Ok(())
    }

    /// The run, whosever it is.
    fn tell_run(&mut self, command: RunCommand) {
        let own = self.run.as_mut().map(|run| {
            run.stop_asked();
            run.order.number
        });
        // A line that is gone is as good as one that is not answered.
        if let (Err(_), Some(number)) = (self.setup.line.send((command, own)), own) {
            self.hear(Message::Unheard(number, "the service's own thread for it has ended".to_owned()));
        }
    }

    fn look_after_run(&mut self) {
        let Some(run) = &mut self.run else { return };
        let board = &self.setup.board;
        let of_run = Some((run.order.number, None));
        for (from, line) in run.lines() {
            match (from, line.strip_prefix("error: ")) {
                // Results stand in the recording; they and an error are said at the end.
                (Line::Stdout, _) | (Line::Stderr, Some(_)) => {}
                (Line::Stderr, None) => board.note(Severity::Info, "run", &line, of_run),
            }
        }
        let ended = match run.poll(|what| board.note(Severity::Error, "service", what, of_run)) {
            Ok(None) => return,
            Ok(Some(ended)) => ended,
            Err(error) => Ended { outcome: Outcome::Failed, text: format!("the run's process: {error}") },
        };
        let (number, profile) = (run.order.number, run.order.profile.clone());
        let id = run.recording_id(&self.setup.data);
        self.run = None;
        self.ended(number, &profile, id, ended);
    }

    fn ended(&mut self, number: u32, profile: &str, id: Option<String>, ended: Ended) {
        let Ended { outcome, text } = ended;
        let severity = match outcome {
            Outcome::Completed => Severity::Info,
            Outcome::Stopped => Severity::Warning,
            Outcome::Tripped | Outcome::Aborted | Outcome::Failed => Severity::Error,
        };
        let said = format!("{profile} {}: {text}", outcome.as_str());
        self.setup.board.note(severity, "service", &said, Some((number, None)));
        self.setup.board.set_own(None);
        let last = view::Last { id, name: profile.to_owned(), outcome: outcome.as_str(), text: text.clone() };
        self.setup.board.desk(|desk| desk.last = Some(last));
        self.step(Input::RunEnded(outcome, text));
        self.show();
    }

    /// Puts everything on the board.
    fn show(&mut self) {
        let (state, now_s) = (self.desk.state(), self.now_s());
        if state == ServiceState::Tripped {
            if self.tripped_utc.is_empty() {
                self.tripped_utc = utc_now();
            }
        } else {
            self.tripped_utc.clear();
        }
        let trip = self.desk.held().map(|held| view::Trip {
            run: held.run,
            reason: held.reason.clone(),
            utc: self.tripped_utc.clone(),
        });
        let queue: Vec<Queued> = self.desk.queue().cloned().collect();
        let changed = self.setup.board.desk(|desk| {
            let changed = desk.service.state != state.as_str() || desk.queue != queue;
            desk.service.state = state.as_str();
            desk.service.armed_left_s = self.desk.armed_left_s(now_s);
            desk.service.trip = trip;
            desk.queue = queue;
            changed
        });
        if changed {
            self.setup.board.change();
        }
    }

    /// The service ends: so does its run, orderly.
    fn leave(mut self, notifier: &mut Notifier) -> bool {
        notifier.stopping();
        // What is queued is not started any more.
        self.step(Input::Disarm);
        let cut_short = self.run.is_some();
        if cut_short {
            self.setup.board.note(Severity::Warning, "service", "the service ends: the run is stopped", None);
            self.step(Input::Stop);
        }
        while self.run.is_some() {
            self.pass();
            notifier.extend();
        }
        cut_short
    }
}
