//! Commands over shared memory, see [`rt_core::service_channel`].

use super::board::Board;
use super::event_log::Severity;
use super::supervisor::{Answer, Message, Way};
use rt_core::{LinkError, ServiceAnswer, ServiceCommand, ServiceServer, ServiceState};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;
use tokio::sync::oneshot;

use super::state::Refusal;

/// Longest wait for a command before the thread looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);

/// Serves the channel until `over`. `ready` hears whether it could be had.
pub fn serve(
    instance: &str,
    board: &Board,
    to_supervisor: &Sender<Message>,
    over: &AtomicBool,
    ready: impl FnOnce(Result<(), LinkError>),
) {
    let mut server = match ServiceServer::open(instance) {
        Ok(server) => {
            ready(Ok(()));
            server
        }
        Err(error) => return ready(Err(error)),
    };
    while !over.load(Ordering::Relaxed) {
        let served = server.serve(LOOK, |command| {
            let answer = obey(board, to_supervisor, command);
            answered(board, answer)
        });
        if let Err(error) = served {
            board.note(Severity::Error, "service", &format!("commands by shared memory: {error}"), None);
            return;
        }
    }
}

fn obey(board: &Board, to_supervisor: &Sender<Message>, command: ServiceCommand) -> Answer {
    if command != ServiceCommand::State && !board.desk(|desk| desk.service.control) {
        return Err(read_only());
    }
    let (reply, answer) = oneshot::channel();
    let gone = || Refusal::new("the service is about to end", "start it again");
    to_supervisor.send(Message::Command(command, Way::Local, reply)).map_err(|_| gone())?;
    answer.blocking_recv().map_err(|_| gone())?
}

/// Why a service without `--control` does nothing.
pub fn read_only() -> Refusal {
    Refusal::new("this service is read-only", "start it with --control")
}

fn answered(board: &Board, answer: Answer) -> ServiceAnswer {
    let run = board
        .watched(|watched| watched.run.as_ref().filter(|run| !run.ended).map(|run| (u64::from(run.number), run.tick)));
    board.desk(|desk| {
        let service = &desk.service;
        let state = ServiceState::ALL.into_iter().find(|state| state.as_str() == service.state);
        let trip = service.trip.as_ref().map(|trip| trip.reason.clone());
        ServiceAnswer {
            done: answer.is_ok(),
            state: state.unwrap_or(ServiceState::Idle),
            control: service.control,
            run,
            armed_left_s: service.armed_left_s,
            queued: desk.queue.len() as u32,
            id: answer.as_ref().ok().copied().flatten(),
            text: answer.err().map(|refusal| refusal.to_string()).or(trip).unwrap_or_default(),
        }
    })
}
