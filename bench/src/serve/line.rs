//! The line to a run: its command channel, kept open while a run is there, so that a stop has nothing to wait for.

use super::board::Board;
use super::supervisor::Message;
use rt_core::{CommandClient, LinkError, RunCommand};
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
                if let (Err(error), Some(number)) = (outcome, own) {
                    // A supervisor that is gone has ended its run.
                    let _ = to_supervisor.send(Message::Unheard(number, error.to_string()));
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

/// Over the open line; over a new one where that is gone.
fn send(instance: &str, open: &mut Option<CommandClient>, command: RunCommand) -> Result<(), LinkError> {
    if let Some(client) = open.take()
        && client.send(command, PATIENCE).is_ok()
    {
        *open = Some(client);
        return Ok(());
    }
    let client = CommandClient::open(instance)?;
    client.send(command, PATIENCE)?;
    *open = Some(client);
    Ok(())
}
