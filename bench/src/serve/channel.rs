//! Commands over shared memory, see [`rt_core::service_channel`].

use super::board::Board;
use super::event_log::Severity;
use super::supervisor::{Answer, Message, Way};
use crate::over::keep_open;
use rt_core::{LinkError, ServiceAnswer, ServiceCommand, ServiceServer, ServiceState};
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Sender;
use std::time::Duration;
use tokio::sync::oneshot;

use super::state::Refusal;

/// Longest wait for a command before the thread looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);

/// Serves the channel until `over`. `ready` hears whether it could be had; where it fails later it is opened anew.
pub fn serve(
    instance: &str,
    board: &Board,
    to_supervisor: &Sender<Message>,
    over: &AtomicBool,
    ready: impl FnOnce(Result<(), LinkError>),
) {
    let mut first = match ServiceServer::open(instance) {
        Ok(server) => {
            ready(Ok(()));
            Some(server)
        }
        Err(error) => return ready(Err(error)),
    };
    let open = || first.take().map_or_else(|| ServiceServer::open(instance), Ok);
    let serve = |server: &mut ServiceServer| {
        server.serve(LOOK, |command| {
            let answer = obey(board, to_supervisor, command);
            answered(board, answer)
        })
    };
    let say = |error: &LinkError| {
        let text = format!("commands by shared memory do not come, it is tried again: {error}");
        board.note(Severity::Error, "service", &text, None);
    };
    keep_open(over, open, serve, say);
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
