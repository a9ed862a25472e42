//! Signs of life for the service manager (systemd's `sd_notify`): ready, alive, stopping. Without one nothing is said.

use super::board::Board;
use sd_notify::NotifyState;
use std::time::{Duration, Instant};

/// While the end of a run is waited for, the manager is asked for so much more time.
const MORE_TIME_US: u32 = 30_000_000;
/// Between two such requests.
const EVERY: Duration = Duration::from_secs(5);

/// See the module.
#[derive(Debug)]
pub struct Notifier {
    /// Between two signs of life; `None`: nobody asks for them.
    interval: Option<Duration>,
    told: Instant,
    /// The last failure was said.
    failed: bool,
}

impl Default for Notifier {
    fn default() -> Self {
        // Half of what is asked for, as its manual says.
        let interval = sd_notify::watchdog_enabled().map(|within| within / 2);
        Notifier { interval, told: Instant::now(), failed: false }
    }
}

impl Notifier {
    fn tell(&mut self, states: &[NotifyState<'_>]) {
        self.told = Instant::now();
        match sd_notify::notify(states) {
            Ok(()) => self.failed = false,
            Err(error) => {
                // Said once: the manager will end the service if it misses its signs.
                if !std::mem::replace(&mut self.failed, true) {
                    tracing::warn!(%error, "the service manager is not told");
                }
            }
        }
    }

    /// The port is open.
    pub fn ready(&mut self, status: &str) {
        self.tell(&[NotifyState::Ready, NotifyState::Status(status)]);
    }

    /// To be called by the supervision of the runs while it works: says so, where sample thread and HTTP side work, too.
    pub fn alive(&mut self, board: &Board) {
        if self.is_due() && all_alive(board) {
            self.tell(&[NotifyState::Watchdog]);
        }
    }

    fn is_due(&self) -> bool {
        self.interval.is_some_and(|interval| self.told.elapsed() >= interval)
    }

    /// The service ends.
    pub fn stopping(&mut self) {
        self.tell(&[NotifyState::Stopping]);
    }

    /// It is still waiting for the end of its run.
    pub fn extend(&mut self) {
        if self.told.elapsed() >= EVERY.min(self.interval.unwrap_or(EVERY)) {
            self.tell(&[NotifyState::ExtendTimeoutUsec(MORE_TIME_US), NotifyState::Watchdog]);
        }
    }
}

/// The other threads that must work.
fn all_alive(board: &Board) -> bool {
    board.samples_beat.is_alive() && board.web_beat.is_alive()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::view;
    use rt_core::Limits;

    #[test]
    fn a_part_that_is_silent_is_not_spoken_for() {
        let service = view::Service {
            state: "idle",
            instance: "test".to_owned(),
            version: String::new(),
            rig: String::new(),
            device: "emulated",
            control: false,
            started_utc: String::new(),
            armed_left_s: None,
            trip: None,
            limits: (&Limits::default()).into(),
        };
        let board = Board::new(service, std::sync::Arc::default());
        assert!(!all_alive(&board), "nobody has said anything yet");
        board.samples_beat.beat();
        assert!(!all_alive(&board), "the HTTP side has not");
        board.web_beat.beat();
        assert!(all_alive(&board));
        let nobody_asks = Notifier { interval: None, told: Instant::now(), failed: false };
        assert!(!nobody_asks.is_due());
    }
}
