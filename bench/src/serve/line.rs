//! The line to a run: its command channel, kept open while a run is there, so that a stop has nothing to wait for.

use super::board::Board;
use super::event_log::Severity;
use super::supervisor::Message;
use rt_core::{Answer, CommandClient, RunCommand};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

/// A stop or an emergency stop, and the number of the service's own run that it is for.
pub type Order = (RunCommand, Option<u32>);

/// Between two looks whether there is a run to be connected with.
const LOOK: Duration = Duration::from_millis(200);
/// The run hears a stop within a tick; this long its answer may take.
const PATIENCE: Duration = Duration::from_secs(3);

/// Sends what comes in until `over`. The supervisor hears of what did not reach its run.
pub fn serve(
    instance: &str,
    board: &Board,
    orders: &Receiver<Order>,
    to_supervisor: &Sender<Message>,
    over: &AtomicBool,
) {
    let mut open: Option<CommandClient> = None;
    while !over.load(Ordering::Relaxed) {
        match orders.recv_timeout(LOOK) {
            Ok((command, own)) => {
                let outcome = send(instance, &mut open, command);
                match (outcome, own) {
                    (Ok(()), _) => {}
                    (Err(why), Some(number)) => {
                        // A supervisor that is gone has ended its run.
                        let _ = to_supervisor.send(Message::Unheard(number, why));
                    }
                    (Err(why), None) => {
                        // Another process's run gets no signal from here: only people can help.
                        let name = if command == RunCommand::EmergencyStop { "emergency stop" } else { "stop" };
                        let text = format!("the {name} was NOT taken by the run, it goes on: {why}");
                        board.note(Severity::Error, "service", &text, None);
                    }
                }
            }
            Err(RecvTimeoutError::Timeout) => {
                let wanted = board.own().is_some() || board.busy.load(Ordering::Relaxed);
                if !wanted || open.as_ref().is_some_and(|client| !client.is_heard()) {
                    open = None;
                }
                if wanted && open.is_none() {
                    // A run that begins listens a moment later.
                    open = CommandClient::open(instance).ok();
                }
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Over the open line; over a new one where that is gone. A refusal is an answer: it is not asked again.
///
/// # Errors
/// Nobody listens, or answers; or the command is refused. In words, why.
fn send(instance: &str, open: &mut Option<CommandClient>, command: RunCommand) -> Result<(), String> {
    let said = |answer: Answer| answer.taken.map(drop).map_err(|refusal| refusal.to_string());
    if let Some(client) = open.take()
        && let Ok(answer) = client.send(command, PATIENCE)
    {
        *open = Some(client);
        return said(answer);
    }
    let client = CommandClient::open(instance).map_err(|error| error.to_string())?;
    let answer = client.send(command, PATIENCE).map_err(|error| error.to_string())?;
    *open = Some(client);
    said(answer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusing::refusing;
    use rt_core::Refusal;

    #[test]
    fn a_stop_that_was_refused_was_not_taken() {
        let instance = format!("test-line-refused-{}", std::process::id());
        refusing(&instance, Refusal::Unreachable, || {
            let mut open = None;
            // Over a new line, then over the open one.
            for command in [RunCommand::Stop, RunCommand::EmergencyStop] {
                assert_eq!(send(&instance, &mut open, command), Err(Refusal::Unreachable.to_string()));
                assert!(open.is_some(), "whoever refuses is there");
            }
        });
    }
}
