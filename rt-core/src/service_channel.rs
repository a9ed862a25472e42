//! Commands to the long-running service that starts runs, from other programs of the same user. To a run itself speaks
//! [`crate::command_channel`].
//!
//! | service | pattern | carries |
//! |---|---|---|
//! | `rec-bench/<instance>/service` | request-response | a command; what became of it, and how the service stands |
//! | `rec-bench/<instance>/service-wake` | event | there is a command: the server sleeps until then |
//!
//! Messages have a fixed size and a version. The rights of the shared memory are those of the user: there is no token.

use std::time::Duration;

use iceoryx2::prelude::*;

use crate::exchange::{Answering, Asking, Kind, NONE, packed, unpacked};
use crate::link::LinkError;

/// Version of the messages; the other end answers nothing else.
const VERSION: u32 = 1;
/// Bytes of a profile's name.
const NAME_BYTES: usize = 120;
/// Bytes of an answer's text.
const TEXT_BYTES: usize = 480;
/// Two services on one instance would start two runs at a time.
const KIND: Kind = Kind { part: "service", nobody: |instance| LinkError::NoService { instance }, servers: 1 };

/// How the service stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceState {
    /// Nothing is started.
    Idle,
    /// What is queued is started, for a limited time.
    Armed,
    /// A run of the queue is under way.
    Running,
    /// The supervisor tripped, or somebody asked for an emergency stop; held until it is acknowledged.
    Tripped,
}

impl ServiceState {
    /// All of them, in the order of their numbers in an answer.
    pub const ALL: [ServiceState; 4] =
        [ServiceState::Idle, ServiceState::Armed, ServiceState::Running, ServiceState::Tripped];

    /// As written for people and in JSON.
    pub fn as_str(self) -> &'static str {
        ["idle", "armed", "running", "tripped"][self as usize]
    }
}

/// What another program asks of the service.
#[derive(Clone, Debug, PartialEq)]
pub enum ServiceCommand {
    /// How do you stand? Changes nothing.
    State,
    /// Start what is queued, for so many seconds.
    Arm {
        /// s
        for_s: f64,
    },
    /// Start nothing more.
    Disarm,
    /// Append a profile to the queue.
    Queue {
        /// Its name; longer than 120 bytes it is none.
        profile: String,
        /// Seed of its random steps.
        seed: u64,
    },
    /// Take this out of the queue.
    Unqueue {
        /// As the answer to [`ServiceCommand::Queue`] told it.
        id: u64,
    },
    /// End the run orderly and hold the queue.
    Stop,
    /// The supervisor is to trip.
    EmergencyStop,
    /// The trip was seen, and the rig looked after.
    Acknowledge,
}

/// What the service says to a command.
#[derive(Clone, Debug, PartialEq)]
pub struct ServiceAnswer {
    /// It was done; otherwise [`ServiceAnswer::text`] says why not.
    pub done: bool,
    /// How the service stands after it.
    pub state: ServiceState,
    /// It takes commands at all.
    pub control: bool,
    /// Number of the run under way, and its newest tick.
    pub run: Option<(u64, u64)>,
    /// For how long it stays armed, s.
    pub armed_left_s: Option<f64>,
    /// Profiles in the queue.
    pub queued: u32,
    /// Of what was queued by this command.
    pub id: Option<u64>,
    /// What was done, why not, or why it tripped; for people. At most 480 bytes of it arrive.
    pub text: String,
}

#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchServiceCommand1")]
struct Message {
    version: u32,
    /// 0: state, 1: arm, 2: disarm, 3: queue, 4: unqueue, 5: stop, 6: emergency stop, 7: acknowledge.
    kind: u32,
    /// Seed or id.
    number: u64,
    for_s: f64,
    name_len: u32,
    reserved: u32,
    name: [u8; NAME_BYTES],
}

#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchServiceAnswer1")]
struct Reply {
    version: u32,
    /// 0: done, 1: refused, [`UNKNOWN`].
    outcome: u32,
    /// Index of [`ServiceState::ALL`].
    state: u32,
    control: u32,
    run: u64,
    tick: u64,
    /// NaN: not armed.
    armed_left_s: f64,
    id: u64,
    queued: u32,
    text_len: u32,
    text: [u8; TEXT_BYTES],
}

/// A command of another version.
const UNKNOWN: u32 = 255;

impl From<&ServiceCommand> for Message {
    fn from(command: &ServiceCommand) -> Message {
        let (kind, number, for_s, name) = match command {
            ServiceCommand::State => (0, 0, 0.0, ""),
            ServiceCommand::Arm { for_s } => (1, 0, *for_s, ""),
            ServiceCommand::Disarm => (2, 0, 0.0, ""),
            ServiceCommand::Queue { profile, seed } => (3, *seed, 0.0, profile.as_str()),
            ServiceCommand::Unqueue { id } => (4, *id, 0.0, ""),
            ServiceCommand::Stop => (5, 0, 0.0, ""),
            ServiceCommand::EmergencyStop => (6, 0, 0.0, ""),
            ServiceCommand::Acknowledge => (7, 0, 0.0, ""),
        };
        let (name, name_len) = packed(name);
        Message { version: VERSION, kind, number, for_s, name_len, reserved: 0, name }
    }
}

impl Message {
    fn command(&self) -> Option<ServiceCommand> {
        if self.version != VERSION {
            return None;
        }
        Some(match self.kind {
            0 => ServiceCommand::State,
            1 => ServiceCommand::Arm { for_s: self.for_s },
            2 => ServiceCommand::Disarm,
            3 => ServiceCommand::Queue { profile: unpacked(&self.name, self.name_len)?, seed: self.number },
            4 => ServiceCommand::Unqueue { id: self.number },
            5 => ServiceCommand::Stop,
            6 => ServiceCommand::EmergencyStop,
            7 => ServiceCommand::Acknowledge,
            _ => return None,
        })
    }
}

impl Reply {
    fn new(answer: &ServiceAnswer) -> Reply {
        let (text, text_len) = packed(&answer.text);
        Reply {
            version: VERSION,
            outcome: u32::from(!answer.done),
            state: answer.state as u32,
            control: u32::from(answer.control),
            run: answer.run.map_or(NONE, |(run, _)| run),
            tick: answer.run.map_or(NONE, |(_, tick)| tick),
            armed_left_s: answer.armed_left_s.unwrap_or(f64::NAN),
            id: answer.id.unwrap_or(NONE),
            queued: answer.queued,
            text_len,
            text,
        }
    }

    /// To what was not understood.
    fn unknown() -> Reply {
        Reply {
            version: VERSION,
            outcome: UNKNOWN,
            state: 0,
            control: 0,
            run: NONE,
            tick: NONE,
            armed_left_s: f64::NAN,
            id: NONE,
            queued: 0,
            text_len: 0,
            text: [0; TEXT_BYTES],
        }
    }

    fn answer(&self) -> Option<ServiceAnswer> {
        if self.version != VERSION || self.outcome > 1 {
            return None;
        }
        Some(ServiceAnswer {
            done: self.outcome == 0,
            state: *ServiceState::ALL.get(self.state as usize)?,
            control: self.control != 0,
            run: (self.run != NONE).then_some((self.run, self.tick)),
            armed_left_s: Some(self.armed_left_s).filter(|left_s| left_s.is_finite()),
            queued: self.queued,
            id: Some(self.id).filter(|&id| id != NONE),
            text: unpacked(&self.text, self.text_len)?,
        })
    }
}

/// The service's end. Belongs to the thread that opened it.
#[derive(Debug)]
pub struct ServiceServer(Answering<Message, Reply>);

impl ServiceServer {
    /// Listens for commands to the service of `instance`.
    ///
    /// # Errors
    /// A name that is none, another service that serves it, no shared memory.
    pub fn open(instance: &str) -> Result<Self, LinkError> {
        Answering::open(instance, KIND).map(ServiceServer)
    }

    /// Waits up to `timeout` for commands, lets `handle` do them, and answers.
    ///
    /// # Errors
    /// The transport failed.
    pub fn serve(
        &mut self,
        timeout: Duration,
        mut handle: impl FnMut(ServiceCommand) -> ServiceAnswer,
    ) -> Result<(), LinkError> {
        self.0.wait(timeout)?;
        while let Some(asked) = self.0.receive()? {
            let reply = asked.payload().command().map_or_else(Reply::unknown, |command| Reply::new(&handle(command)));
            // A client that is gone needs no answer.
            let _ = asked.send_copy(reply);
        }
        Ok(())
    }
}

/// Sends a command to the service of `instance` and waits for its answer, up to `patience`.
///
/// # Errors
/// No service answers on this instance, or not in time, or it is of another build.
pub fn send_service_command(
    instance: &str,
    command: &ServiceCommand,
    patience: Duration,
) -> Result<ServiceAnswer, LinkError> {
    Asking::open(instance, KIND)?.send(Message::from(command), patience, Reply::answer)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn commands() -> Vec<ServiceCommand> {
        vec![
            ServiceCommand::State,
            ServiceCommand::Arm { for_s: 12.5 },
            ServiceCommand::Disarm,
            ServiceCommand::Queue { profile: "square_h".to_owned(), seed: u64::MAX - 1 },
            ServiceCommand::Unqueue { id: 7 },
            ServiceCommand::Stop,
            ServiceCommand::EmergencyStop,
            ServiceCommand::Acknowledge,
        ]
    }

    #[test]
    fn a_command_and_its_answer_come_through_as_they_were() {
        for command in commands() {
            assert_eq!(Message::from(&command).command(), Some(command.clone()));
            assert_eq!(Message { version: VERSION + 1, ..Message::from(&command) }.command(), None);
        }
        assert_eq!(Message { kind: 8, ..Message::from(&ServiceCommand::State) }.command(), None);
        for (done, state) in [(true, ServiceState::Armed), (false, ServiceState::Tripped)] {
            let answer = ServiceAnswer {
                done,
                state,
                control: done,
                run: done.then_some((3, 12_345)),
                armed_left_s: done.then_some(599.5),
                queued: 2,
                id: done.then_some(9),
                text: "ungültig".to_owned(),
            };
            assert_eq!(Reply::new(&answer).answer(), Some(answer.clone()));
            let long = ServiceAnswer { text: "ü".repeat(TEXT_BYTES), ..answer };
            let arrived = Reply::new(&long).answer().expect("of this version");
            assert_eq!(arrived.text, "ü".repeat(TEXT_BYTES / 2), "cut at a whole character");
        }
        assert_eq!(Reply::unknown().answer(), None);
    }

    #[test]
    fn a_message_that_claims_more_text_than_it_has_is_none() {
        let name = Message { name_len: 1000, ..Message::from(&commands()[3]) };
        assert_eq!(name.command(), None);
    }

    #[test]
    fn a_service_is_asked_and_there_is_one_of_it() {
        let instance = format!("service-channel-{}", std::process::id());
        let patience = Duration::from_secs(20);
        let state = ServiceCommand::State;
        assert_eq!(
            send_service_command(&instance, &state, patience),
            Err(LinkError::NoService { instance: instance.clone() })
        );
        let mut server = ServiceServer::open(&instance).expect("nobody serves it");
        assert_eq!(ServiceServer::open(&instance).err(), Some(LinkError::InUse { instance: instance.clone() }));
        let client = {
            let instance = instance.clone();
            std::thread::spawn(move || {
                commands().iter().map(|c| send_service_command(&instance, c, patience)).collect()
            })
        };
        let mut heard = Vec::new();
        while !client.is_finished() {
            let handle = |command: ServiceCommand| {
                heard.push(command);
                ServiceAnswer {
                    done: true,
                    state: ServiceState::Idle,
                    control: true,
                    run: None,
                    armed_left_s: None,
                    queued: heard.len() as u32,
                    id: None,
                    text: String::new(),
                }
            };
            server.serve(Duration::from_millis(20), handle).expect("the transport works");
        }
        let answers: Vec<Result<ServiceAnswer, LinkError>> = client.join().expect("the client does not panic");
        let counts: Vec<u32> = answers.into_iter().map(|answer| answer.expect("it is answered").queued).collect();
        assert_eq!(heard, commands());
        assert_eq!(counts, (1..=heard.len() as u32).collect::<Vec<_>>());
    }
}
