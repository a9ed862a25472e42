//! Commands to a run from another process, each with an answer: stop, emergency stop, confirmations of people at the rig.
//!
//! | service | pattern | carries |
//! |---|---|---|
//! | `rec-bench/<instance>/command` | request-response | a command; whether it was taken, at which tick, or why not |
//! | `rec-bench/<instance>/command-wake` | event | there is a command: the server sleeps until then |
//!
//! A stop is taken when its switch is thrown: within a tick the loop sees it, and its samples show it. A confirmation is taken or refused by
//! the loop itself, at a tick that the answer names.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use iceoryx2::prelude::*;

use crate::confirmation::{Amount, Confirmation, Refusal, Waiting};
use crate::exchange::{Answering, Asking, Kind, LOOK, NONE, packed, unpacked};
use crate::link::LinkError;
use crate::traits::Switches;

/// Version of the messages; the other end answers nothing else.
const VERSION: u32 = 1;
/// Bytes of an answer's text.
const TEXT_BYTES: usize = 240;
/// The loop judges a confirmation within a tick; one that is held up for longer than this has no answer.
const VERDICT_PATIENCE: Duration = Duration::from_secs(2);
/// One run's end may still be open when the next one begins.
const KIND: Kind = Kind { part: "command", nobody: |instance| LinkError::Nobody { instance }, servers: 2 };

/// What another process asks of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RunCommand {
    /// What is asked for now? Changes nothing.
    Look,
    /// An orderly end.
    Stop,
    /// The supervisor is to trip.
    EmergencyStop,
    /// The people at the rig have done what the run asked for.
    Confirm(Confirmation),
}

/// What the run says to a command.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Taken: at this tick, where the loop itself took it. Otherwise why not.
    pub taken: Result<Option<u64>, Refusal>,
    /// What the run waits for now.
    pub open: Option<Waiting>,
    /// That in words; empty where nothing is asked.
    pub text: String,
}

#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchCommand1")]
struct Message {
    version: u32,
    /// 0: look, 1: stop, 2: emergency stop, 3: confirm.
    kind: u32,
    request: u64,
    volume_ml: f64,
    has_volume: u32,
    reserved: u32,
}

#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchAnswer1")]
struct Reply {
    version: u32,
    /// 0: taken; otherwise 1 + index of [`Refusal::ALL`], or [`UNKNOWN`].
    outcome: u32,
    tick: u64,
    request: u64,
    has_amount: u32,
    text_len: u32,
    text: [u8; TEXT_BYTES],
}

/// A command of another version.
const UNKNOWN: u32 = 255;

type Asked = crate::exchange::Asked<Message, Reply>;

impl From<RunCommand> for Message {
    fn from(command: RunCommand) -> Message {
        let (kind, confirmation) = match command {
            RunCommand::Look => (0, Confirmation::default()),
            RunCommand::Stop => (1, Confirmation::default()),
            RunCommand::EmergencyStop => (2, Confirmation::default()),
            RunCommand::Confirm(confirmation) => (3, confirmation),
        };
        Message {
            version: VERSION,
            kind,
            request: confirmation.request.map_or(NONE, u64::from),
            volume_ml: confirmation.volume_ml.unwrap_or(0.0),
            has_volume: u32::from(confirmation.volume_ml.is_some()),
            reserved: 0,
        }
    }
}

impl Message {
    fn command(&self) -> Option<RunCommand> {
        if self.version != VERSION {
            return None;
        }
        Some(match self.kind {
            0 => RunCommand::Look,
            1 => RunCommand::Stop,
            2 => RunCommand::EmergencyStop,
            3 => RunCommand::Confirm(Confirmation {
                request: u32::try_from(self.request).ok(),
                volume_ml: (self.has_volume != 0).then_some(self.volume_ml),
            }),
            _ => return None,
        })
    }
}

impl Reply {
    fn new(taken: Option<Result<Option<u64>, Refusal>>, open: Option<Waiting>, text: &str) -> Reply {
        let (outcome, tick) = match taken {
            None => (UNKNOWN, None),
            Some(Ok(tick)) => (0, tick),
            Some(Err(refusal)) => {
                (1 + Refusal::ALL.iter().position(|&other| other == refusal).unwrap_or(0) as u32, None)
            }
        };
        let (text, text_len) = packed(text);
        Reply {
            version: VERSION,
            outcome,
            tick: tick.unwrap_or(NONE),
            request: open.map_or(NONE, |open| u64::from(open.request)),
            has_amount: u32::from(open.is_some_and(|open| open.amount.is_some())),
            text_len,
            text,
        }
    }

    fn answer(&self) -> Option<Answer> {
        if self.version != VERSION || self.outcome == UNKNOWN {
            return None;
        }
        let taken = match self.outcome {
            0 => Ok(Some(self.tick).filter(|&tick| tick != NONE)),
            refused => Err(*Refusal::ALL.get(refused as usize - 1)?),
        };
        let open = u32::try_from(self.request).ok();
        let amount = (self.has_amount != 0).then_some(Amount::VolumeMl);
        let text = unpacked(&self.text, self.text_len)?;
        Some(Answer { taken, open: open.map(|request| Waiting { request, amount }), text })
    }
}

/// The run's end. Belongs to the thread that opened it, which is not the loop's.
#[derive(Debug)]
pub struct CommandServer {
    requests: Answering<Message, Reply>,
    /// Confirmations in their order; the first one is with the loop since then, once it could be offered.
    confirming: VecDeque<(Asked, Confirmation)>,
    offered: Option<Instant>,
    /// Commands that were passed on, and where their answers come from.
    passed: Vec<(Asked, Receiver<Answer>)>,
}

impl CommandServer {
    /// Listens for commands to `instance`.
    ///
    /// # Errors
    /// A name that is none, no shared memory.
    pub fn open(instance: &str) -> Result<Self, LinkError> {
        let requests = Answering::open(instance, KIND)?;
        Ok(CommandServer { requests, confirming: VecDeque::new(), offered: None, passed: Vec::new() })
    }

    /// Waits up to `timeout` for commands and does what they say with the switches. `text` says in words what the run asks for now.
    ///
    /// # Errors
    /// The transport failed.
    pub fn serve(
        &mut self,
        timeout: Duration,
        switches: &Switches,
        text: &dyn Fn() -> String,
    ) -> Result<(), LinkError> {
        let served = self.take_requests(timeout, switches, text);
        if served.is_err() {
            self.withdraw(switches);
        }
        served
    }

    fn take_requests(
        &mut self,
        timeout: Duration,
        switches: &Switches,
        text: &dyn Fn() -> String,
    ) -> Result<(), LinkError> {
        self.requests.wait(if self.confirming.is_empty() { timeout } else { LOOK })?;
        while let Some(asked) = self.requests.receive()? {
            let taken = match asked.payload().command() {
                None => None,
                Some(RunCommand::Look) => Some(Ok(None)),
                Some(RunCommand::Stop) => {
                    switches.stop.store(true, Ordering::Relaxed);
                    Some(Ok(None))
                }
                Some(RunCommand::EmergencyStop) => {
                    switches.emergency_stop.store(true, Ordering::Relaxed);
                    Some(Ok(None))
                }
                Some(RunCommand::Confirm(confirmation)) => {
                    self.confirming.push_back((asked, confirmation));
                    continue;
                }
            };
            answer(&asked, taken, switches, text);
        }
        self.confirm(switches, text);
        Ok(())
    }

    /// What was asked for can't be answered any more; the way to the loop must be free for who asks next.
    fn withdraw(&mut self, switches: &Switches) {
        let slot = &switches.confirmations;
        self.confirming.clear();
        let Some(since) = self.offered.take() else { return };
        // A verdict that is just being made takes less than a tick.
        while slot.verdict().is_none() && !slot.withdraw() && since.elapsed() < VERDICT_PATIENCE {
            std::thread::sleep(LOOK);
        }
    }

    /// Waits up to `timeout` for commands and hands each of them to `pass`: for a program that carries them to the machine on which the run goes
    /// on. `pass` must not wait: an emergency stop may be the next one. The answer is given when it comes; where its sender is dropped without
    /// one, the other machine can't be reached.
    ///
    /// # Errors
    /// The transport failed.
    pub fn pass_on(
        &mut self,
        timeout: Duration,
        pass: &mut dyn FnMut(RunCommand) -> Receiver<Answer>,
    ) -> Result<(), LinkError> {
        self.requests.wait(if self.passed.is_empty() { timeout } else { LOOK })?;
        while let Some(asked) = self.requests.receive()? {
            match asked.payload().command() {
                // A client that is gone needs no answer.
                None => {
                    let _ = asked.send_copy(Reply::new(None, None, ""));
                }
                Some(command) => self.passed.push((asked, pass(command))),
            }
        }
        self.passed.retain(|(asked, answer)| {
            let Answer { taken, open, text } = match answer.try_recv() {
                Ok(answer) => answer,
                Err(TryRecvError::Empty) => return asked.is_connected(),
                Err(TryRecvError::Disconnected) => {
                    Answer { taken: Err(Refusal::Unreachable), open: None, text: String::new() }
                }
            };
            let _ = asked.send_copy(Reply::new(Some(taken), open, &text));
            false
        });
        Ok(())
    }

    /// Goes on with the confirmations, without waiting for the loop.
    fn confirm(&mut self, switches: &Switches, text: &dyn Fn() -> String) {
        let slot = &switches.confirmations;
        while let Some((asked, confirmation)) = self.confirming.front() {
            let Some(since) = self.offered else {
                // Where the slot is taken, somebody at the run's own terminal was first.
                if !slot.offer(*confirmation) {
                    return;
                }
                self.offered = Some(Instant::now());
                return;
            };
            let verdict = match slot.verdict() {
                Some(verdict) => verdict.map(Some),
                None if since.elapsed() >= VERDICT_PATIENCE && slot.withdraw() => Err(Refusal::NoAnswer),
                None => return,
            };
            answer(asked, Some(verdict), switches, text);
            self.offered = None;
            self.confirming.pop_front();
        }
    }
}

/// A client that is gone needs no answer.
fn answer(asked: &Asked, taken: Option<Result<Option<u64>, Refusal>>, switches: &Switches, text: &dyn Fn() -> String) {
    let _ = asked.send_copy(Reply::new(taken, switches.confirmations.waiting(), &text()));
}

/// An open way to the run of one instance: nothing but the command itself is left to do. Belongs to the thread that opened it.
#[derive(Debug)]
pub struct CommandClient(Asking<Message, Reply>);

impl CommandClient {
    /// Opens the way.
    ///
    /// # Errors
    /// No service of this name listens.
    pub fn open(instance: &str) -> Result<Self, LinkError> {
        Asking::open(instance, KIND).map(CommandClient)
    }

    /// Whether somebody listens at the other end.
    pub fn is_heard(&self) -> bool {
        self.0.is_heard()
    }

    /// Sends a command and waits for its answer, up to `patience`.
    ///
    /// # Errors
    /// Nobody listens any more, or does not answer in time.
    pub fn send(&self, command: RunCommand, patience: Duration) -> Result<Answer, LinkError> {
        self.0.send(command.into(), patience, Reply::answer)
    }
}

/// Sends a command to the run of `instance` and waits for its answer, up to `patience`.
///
/// # Errors
/// No service of this name listens, or it does not answer in time.
pub fn send_command(instance: &str, command: RunCommand, patience: Duration) -> Result<Answer, LinkError> {
    CommandClient::open(instance)?.send(command, patience)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_and_its_answer_come_through_as_they_were() {
        let confirmation = Confirmation { request: Some(7), volume_ml: Some(-0.25) };
        for command in [
            RunCommand::Look,
            RunCommand::Stop,
            RunCommand::EmergencyStop,
            RunCommand::Confirm(confirmation),
            RunCommand::Confirm(Confirmation::default()),
        ] {
            assert_eq!(Message::from(command).command(), Some(command));
            assert_eq!(Message { version: VERSION + 1, ..command.into() }.command(), None);
        }
        assert_eq!(Message { kind: 9, ..RunCommand::Stop.into() }.command(), None);
        let open = Some(Waiting { request: 0, amount: Some(Amount::VolumeMl) });
        let refused = Refusal::ALL.map(Err);
        for taken in [Ok(None), Ok(Some(0)), Ok(Some(123))].into_iter().chain(refused) {
            let answer = Reply::new(Some(taken), open, "clamp it").answer();
            assert_eq!(answer, Some(Answer { taken, open, text: "clamp it".to_owned() }));
        }
        assert_eq!(Reply::new(None, None, "").answer(), None);
        let long = Reply::new(Some(Ok(None)), None, &"ä".repeat(300)).answer().map(|answer| answer.text);
        assert_eq!(long, Some("ä".repeat(TEXT_BYTES / 2)));
    }
}
