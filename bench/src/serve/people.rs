//! What a run asks people for: looked for while it waits, as only the run's own channel tells the words.

use super::board::Board;
use super::view::Waiting;
use rt_core::{Amount, CommandClient, RunCommand};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// Between two looks while a run waits.
const LOOK: Duration = Duration::from_millis(300);
/// A run answers within a tick.
const PATIENCE: Duration = Duration::from_secs(1);

/// Keeps the board's request up to date until `over`.
pub fn watch(instance: &str, board: &Board, over: &AtomicBool) {
    let mut open: Option<CommandClient> = None;
    while !over.load(Ordering::Relaxed) {
        let client = open.take().filter(|_| board.waits.load(Ordering::Relaxed));
        let client = client.or_else(|| {
            let waits = board.waits.load(Ordering::Relaxed);
            waits.then(|| CommandClient::open(instance).ok()).flatten()
        });
        // A run that does not answer asks for nothing yet, or no longer.
        let answer = client.as_ref().and_then(|client| client.send(RunCommand::Look, PATIENCE).ok());
        open = client.filter(|_| answer.is_some());
        board.set_waiting(answer.and_then(|answer| {
            let open = answer.open?;
            let amount = open.amount.map(|Amount::VolumeMl| "volume_ml");
            Some(Waiting { request: open.request, text: answer.text, amount })
        }));
        thread::sleep(LOOK);
    }
}
