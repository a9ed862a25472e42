//! The rig's end: takes samples out of shared memory as a monitor does and hands them to the network, tells what a run is, and, where it
//! is allowed, passes commands on to the run.

use super::message::{Asked, Said};
use super::{State, VERSION, broken, free, key, session};
use crate::failure::{Failure, Kind};
use crate::over::OverAtEnd;
use recordings::carry;
use rt_core::announce::Announcements;
use rt_core::{Answer, Delivery, LinkError, Refusal, RunCommand, Sample, SampleSubscriber, send_command};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Query;
use zenoh::{Session, Wait};

/// Samples of so long travel together.
const TOGETHER: Duration = Duration::from_millis(10);
/// At most so many: a message stays well below what the network takes at once.
const MOST_TOGETHER: usize = 32;
/// Between two signs of life.
const SIGN: Duration = Duration::from_millis(200);
/// The run answers within a tick, a confirmation within two seconds.
const PATIENCE: Duration = Duration::from_millis(2500);
/// A run's last sample goes along with each sign of life for so long, in case it did not cross: without it nobody over there knows that the run has ended.
/// Longer than the other end waits before it closes what it publishes.
const END_TOLD: Duration = Duration::from_secs(10);
/// Runs whose setup is remembered.
const SETUPS_KEPT: usize = 8;

/// What the rig's end is to do.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Instance of the runs.
    pub instance: String,
    /// Addresses to listen on: [`super::endpoint`].
    pub listen: Vec<String>,
    /// Take commands.
    pub control: bool,
}

/// What each run is, by number: for queries, which come in threads of their own.
type Setups = Arc<Mutex<BTreeMap<u32, Vec<u8>>>>;

/// Serves until `end` is set.
///
/// # Errors
/// The instance can't be subscribed to, the addresses can't be listened on (4).
pub fn serve(settings: &Settings, end: &AtomicBool, say: &(dyn Fn(&str) + Sync)) -> Result<(), Failure> {
    let Settings { instance, listen, control } = settings;
    let link = |e: LinkError| Failure::of(Kind::Device, &e);
    listen.iter().try_for_each(|endpoint| free(endpoint))?;
    // Before the network: who connects finds something.
    let announcements = Announcements::open(instance).map_err(link)?;
    let subscriber = SampleSubscriber::open(instance, Delivery::BestEffort).map_err(link)?;
    let session = session(listen, &[])?;
    say(&format!(
        "instance {instance:?} is served on {}, {}",
        listen.join(", "),
        if *control { "with commands" } else { "read-only" }
    ));

    let setups = Setups::default();
    let (asked, lanes) = Lanes::open();
    let answering = Arc::clone(&setups);
    let _setup_queries = session
        .declare_queryable(key(instance, "setup"))
        .callback(move |query| answer_setup(&query, &answering))
        .wait()
        .map_err(|e| broken("answering for setups", &e))?;
    let _command_queries = session
        .declare_queryable(key(instance, "command"))
        // A command takes its time, and the network's thread has none. The receivers are gone only when the command ends.
        .callback(move |query| asked.take(query))
        .wait()
        .map_err(|e| broken("answering for commands", &e))?;

    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _over = OverAtEnd(&over);
        let until = &over;
        for lane in lanes {
            scope.spawn(move || obey(&lane, until, &|command| decide(settings, command, say)));
        }
        let sender = Sender::new(settings, &session, setups);
        sender.and_then(|mut sender| sender.follow(subscriber, announcements, end))
    })?;
    session.close().wait().map_err(|e| broken("closing", &e))
}

/// What is sent by itself.
struct Sender<'s> {
    settings: &'s Settings,
    samples: Publisher<'s>,
    states: Publisher<'s>,
    setups: Setups,
    sent: u64,
    missed: u64,
    /// The last sample of the run that has ended, and since when it has.
    ended: Option<(Vec<u8>, Instant)>,
}

impl<'s> Sender<'s> {
    fn new(settings: &'s Settings, session: &'s Session, setups: Setups) -> Result<Self, Failure> {
        // What blocks would keep signs of life back.
        let publisher = |part: &str, priority| {
            let publisher = session.declare_publisher(key(&settings.instance, part));
            let publisher = publisher.congestion_control(CongestionControl::Drop).priority(priority).express(true);
            publisher.wait().map_err(|e| broken("publishing", &e))
        };
        Ok(Sender {
            settings,
            samples: publisher("sample", Priority::Data)?,
            // Before the samples: a full network is not taken for a dead one.
            states: publisher("state", Priority::InteractiveHigh)?,
            setups,
            sent: 0,
            missed: 0,
            ended: None,
        })
    }

    fn follow(
        &mut self,
        mut subscriber: SampleSubscriber,
        mut announcements: Announcements,
        end: &AtomicBool,
    ) -> Result<(), Failure> {
        let link = |e: LinkError| Failure::of(Kind::Device, &e);
        let mut samples = Vec::new();
        let mut signed: Option<Instant> = None;
        while !end.load(Ordering::Relaxed) {
            samples.clear();
            if subscriber.receive(TOGETHER, &mut samples).map_err(link)? > 0 {
                // What comes within the next moments travels along.
                std::thread::sleep(TOGETHER);
                while subscriber.drain(&mut samples).map_err(link)? > 0 {}
            }
            if let Some((run, bytes)) = announcements.newest().map_err(link)? {
                self.remember(run, bytes);
            }
            while let Some(certificate) = subscriber.take_certificate() {
                self.missed += certificate.expected.saturating_sub(certificate.received);
            }
            for together in samples.chunks(MOST_TOGETHER) {
                self.send(together)?;
            }
            if signed.is_none_or(|at| at.elapsed() >= SIGN) {
                signed = Some(Instant::now());
                self.sign()?;
                self.tell_end()?;
            }
        }
        Ok(())
    }

    fn remember(&self, run: u32, bytes: &[u8]) {
        let mut setups = self.setups.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if setups.get(&run).is_none_or(|kept| kept != bytes) {
            // A service that was started again numbers its runs anew: what follows is not what was there.
            setups.retain(|kept, _| *kept < run);
            while setups.len() >= SETUPS_KEPT {
                setups.pop_first();
            }
            setups.insert(run, bytes.to_owned());
        }
    }

    /// Hands samples to the network, or drops them where it has no room.
    fn send(&mut self, together: &[Sample]) -> Result<(), Failure> {
        self.sent += together.len() as u64;
        self.ended = together.last().filter(|sample| sample.last()).map(|last| (carried_alone(last), Instant::now()));
        let mut bytes = Vec::new();
        together.iter().for_each(|sample| carry(sample, &mut bytes));
        self.samples.put(bytes).wait().map_err(|e| broken("sending samples", &e))
    }

    fn tell_end(&self) -> Result<(), Failure> {
        match &self.ended {
            Some((last, since)) if since.elapsed() < END_TOLD => {
                self.samples.put(last.as_slice()).wait().map_err(|e| broken("sending samples", &e))
            }
            _ => Ok(()),
        }
    }

    fn sign(&self) -> Result<(), Failure> {
        let state = State { version: VERSION, control: self.settings.control, sent: self.sent, missed: self.missed };
        let text = serde_json::to_vec(&state).map_err(|e| Failure::of(Kind::Internal, &e))?;
        self.states.put(text).wait().map_err(|e| broken("sending a sign of life", &e))
    }
}

fn carried_alone(sample: &Sample) -> Vec<u8> {
    let mut bytes = Vec::new();
    carry(sample, &mut bytes);
    bytes
}

/// Answers with what the run is that is asked for; says nothing of one that it does not know.
fn answer_setup(query: &Query, setups: &Setups) {
    let Some(run) = query.parameters().get("run").and_then(|run| run.parse::<u32>().ok()) else { return };
    let setup = setups.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get(&run).cloned();
    if let Some(setup) = setup
        && let Err(error) = query.reply(query.key_expr().clone(), setup).wait()
    {
        tracing::warn!(%error, "answer to a query for a setup");
    }
}

/// A query and the command in it, or what is wrong with it.
type Command = (Query, Result<RunCommand, String>);

/// Where commands wait for their turn. Those of one lane are done one after the other; a stop does not wait for a confirmation that nobody takes, and an
/// emergency stop for nothing.
struct Lanes {
    emergency: mpsc::Sender<Command>,
    stop: mpsc::Sender<Command>,
    other: mpsc::Sender<Command>,
}

impl Lanes {
    /// The lanes, and their ends.
    fn open() -> (Lanes, [Receiver<Command>; 3]) {
        let ((emergency, first), (stop, second), (other, third)) = (channel(), channel(), channel());
        (Lanes { emergency, stop, other }, [first, second, third])
    }

    fn take(&self, query: Query) {
        let payload = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        let command = Asked::parse(&payload);
        let lane = match command {
            Ok(RunCommand::EmergencyStop) => &self.emergency,
            Ok(RunCommand::Stop) => &self.stop,
            Ok(RunCommand::Look | RunCommand::Confirm(_)) | Err(_) => &self.other,
        };
        // The other end is gone only when all ends.
        let _ = lane.send((query, command));
    }
}

/// Answers the commands of a lane, one after the other, until it is over.
fn obey(lane: &Receiver<Command>, over: &AtomicBool, decide: &dyn Fn(RunCommand) -> Answer) {
    while !over.load(Ordering::Relaxed) {
        let (query, command) = match lane.recv_timeout(Duration::from_millis(50)) {
            Ok(command) => command,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let replied = match command {
            Ok(command) => {
                let text = serde_json::to_vec(&Said::from(&decide(command))).unwrap_or_default();
                query.reply(query.key_expr().clone(), text).wait()
            }
            Err(wrong) => query.reply_err(wrong).wait(),
        };
        if let Err(error) = replied {
            tracing::warn!(%error, "answer to a command");
        }
    }
}

/// Passes a command on to the run. To look is always allowed.
fn decide(settings: &Settings, command: RunCommand, say: &(dyn Fn(&str) + Sync)) -> Answer {
    let refused = |refusal| Answer { taken: Err(refusal), open: None, text: String::new() };
    let words = match command {
        RunCommand::Look => None,
        RunCommand::Stop => Some("stop"),
        RunCommand::EmergencyStop => Some("emergency stop"),
        RunCommand::Confirm(_) => Some("confirmation"),
    };
    if let (Some(words), false) = (words, settings.control) {
        say(&format!("refused: {words} from the other end; the link is read-only, --control lets commands in"));
        return refused(Refusal::ReadOnly);
    }
    let outcome = send_command(&settings.instance, command, PATIENCE);
    if let Some(words) = words {
        let became = match &outcome {
            Ok(Answer { taken: Ok(_), .. }) => "taken".to_owned(),
            Ok(Answer { taken: Err(refusal), .. }) => format!("not taken: {refusal}"),
            Err(error) => format!("not taken: {error}"),
        };
        say(&format!("{words} from the other end: {became}"));
    }
    outcome.unwrap_or_else(|_| refused(Refusal::NoAnswer))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::Confirmation;

    /// Longer than anything here takes; only a failing test waits that long.
    const LONG: Duration = Duration::from_secs(60);

    #[test]
    fn an_emergency_stop_waits_neither_for_a_confirmation_nor_for_a_stop() {
        let session = session(&[], &[]).expect("a session of its own");
        let (asked, lanes) = Lanes::open();
        let queries = session.declare_queryable("lanes/command").callback(move |query| asked.take(query));
        let _queries = queries.wait().expect("a key");
        let over = AtomicBool::new(false);
        let (begun, begins) = channel();
        let (emergency_stopped, others_may_end) = channel();
        let others_may_end = Mutex::new(others_may_end);
        let decide = |command: RunCommand| {
            begun.send(command).expect("the test listens");
            let taken = if command == RunCommand::EmergencyStop {
                Ok(None)
            } else {
                let wait = others_may_end.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                wait.recv_timeout(LONG).map(|()| None).map_err(|_| Refusal::NoAnswer)
            };
            Answer { taken, open: None, text: String::new() }
        };
        let (answered, answers) = channel();
        let ask = |command: RunCommand| {
            let (text, answered) = (serde_json::to_vec(&Asked::from(command)).expect("plain"), answered.clone());
            let query = session.get("lanes/command").payload(text).timeout(2 * LONG);
            let query = query.callback(move |reply| {
                let said = reply.result().ok().and_then(|sample| Said::parse(&sample.payload().to_bytes()));
                answered.send((command, said.expect("an answer").taken)).expect("the test listens");
            });
            query.wait().expect("it is sent");
        };
        std::thread::scope(|scope| {
            for lane in lanes {
                let (over, decide) = (&over, decide);
                scope.spawn(move || obey(&lane, over, &decide));
            }
            let confirm = RunCommand::Confirm(Confirmation::default());
            for held in [confirm, RunCommand::Stop] {
                ask(held);
                assert_eq!(begins.recv_timeout(LONG), Ok(held));
            }
            ask(RunCommand::EmergencyStop);
            assert_eq!(answers.recv_timeout(LONG), Ok((RunCommand::EmergencyStop, Ok(None))));
            (0..2).for_each(|_| emergency_stopped.send(()).expect("they wait"));
            let mut later = [(); 2].map(|()| answers.recv_timeout(LONG).expect("an answer"));
            later.sort_by_key(|(command, _)| *command == confirm);
            assert_eq!(later, [(RunCommand::Stop, Ok(None)), (confirm, Ok(None))]);
            over.store(true, Ordering::Relaxed);
        });
    }
}
